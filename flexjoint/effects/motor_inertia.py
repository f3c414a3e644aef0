"""The motor's inertia is not what the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site, Source, Typical
from flexjoint.effects._sources import HIWIN


class MotorInertia(Effect):
    """The motor's inertia, link-referred, is not what the model says.

    Where the model says none, `rotor_inertia` has it."""

    site, kind, against, reference = Site.MOTOR, Kind.PARAMETER, "tau_m", "Spong 1987 (motor equation)"
    law = r"(1 + e)\,B"
    # by a factor of five: a data sheet may leave out the gear, the brake or the encoder; a wrong gear ratio,
    # of which the square counts, is an error of the data, and what is off by more is another cause
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.8, high=4.0),)
    typical = (
        Typical("up to 10 %, the tolerance of all data of a torque motor", HIWIN),
        Typical(
            "10 % more than the data of motor, shaft and gear: other parts turn with them",
            Source(
                "Compliant Joint Toolbox, CENTAURO drive, partly identified",
                "https://github.com/geez0x1/CompliantJointToolbox/blob/"
                "437b22b276ce60caae4010899938b448e6eecac8/param/CE_Med.m",
            ),
        ),
    )

    def possible(self, drive: Drive) -> bool:
        return drive.B != 0.0

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(B=1.0 + p.scale)
