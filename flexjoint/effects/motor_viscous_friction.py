"""Friction of the motor and gear that grows with the motor's speed."""

from dataclasses import replace
from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site, Typical
from flexjoint.effects._sources import BAM, MANUTEC, WALKMAN_B11


class MotorViscousFriction(Effect):
    """Friction of the motor and gear that grows with the motor's speed, beside the nominal D_m."""

    site, kind, against, reference = Site.MOTOR, Kind.MECHANICAL, "dtheta", "Armstrong-Helouvry et al. 1994"
    ordinary = True
    law = r"d \, \dot\theta"
    params = (Parameter("coefficient", "N m s/rad", "d", value=1.0, low=-1e4, high=1e5),)
    typical = (
        Typical("0.035 N m s/rad (MX-106), 1.3 and 8.4 N m s/rad (eRob80 with ratios of 50 and 100)", BAM),
        Typical("0.03 to 9.8 N m s/rad at joints 4 to 6", MANUTEC),
        Typical("12 N m s/rad", WALKMAN_B11),
    )

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return replace(drive, D_m=drive.D_m + p.coefficient)
