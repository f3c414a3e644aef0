"""The motor's inertia is not what the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class MotorInertia(Effect):
    """The motor's inertia, link-referred, is not what the model says."""

    site, kind, against, reference = Site.MOTOR, Kind.PARAMETER, "tau_m", "Spong 1987 (motor equation)"
    law = r"(1 + e)\,B"
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.99, high=1e5),)

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(B=1.0 + p.scale)
