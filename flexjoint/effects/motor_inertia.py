"""The motor's inertia is not what the model says."""

from typing import Any

from flexjoint.effect import Drive, Effect, Kind, Param, Site


class MotorInertia(Effect):
    """The motor's inertia, link-referred, is not what the model says."""

    site, kind, against, reference = Site.MOTOR, Kind.PARAMETER, "tau_m", "Spong 1987 (motor equation)"
    law = r"(1 + e)\,B"
    params = (Param("scale", "1", "e", 0.1, -0.99, 1e5),)

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(B=1.0 + p.scale)
