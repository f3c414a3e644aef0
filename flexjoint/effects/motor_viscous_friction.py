"""Friction of the motor and gear that grows with the motor's speed."""

from dataclasses import replace
from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class MotorViscousFriction(Effect):
    """Friction of the motor and gear that grows with the motor's speed, beside the nominal D_m."""

    site, kind, against, reference = Site.MOTOR, Kind.MECHANICAL, "dtheta", "Armstrong-Helouvry et al. 1994"
    ordinary = True
    law = r"d \, \dot\theta"
    params = (Parameter("coefficient", "N m s/rad", "d", value=1.0, low=-1e4, high=1e5),)

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return replace(drive, D_m=drive.D_m + p.coefficient)
