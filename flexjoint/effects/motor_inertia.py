"""The motor's inertia is not what the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class MotorInertia(Effect):
    """The motor's inertia, link-referred, is not what the model says."""

    site, kind, against, reference = Site.MOTOR, Kind.PARAMETER, "tau_m", "Spong 1987 (motor equation)"
    law = r"(1 + e)\,B"
    # by a factor of five: a data sheet may leave out the gear, the brake or the encoder; a wrong gear ratio,
    # of which the square counts, is an error of the data, and what is off by more is another cause
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.8, high=4.0),)

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(B=1.0 + p.scale)
