"""Dry friction on the motor shaft; it sticks."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import BAM, MANUTEC, WALKMAN_B11


class MotorCoulombFriction(Effect):
    """Dry friction on the motor shaft; it sticks."""

    site, against, reference = Site.MOTOR, "dtheta", "Armstrong-Helouvry et al. 1994"
    ordinary = True
    law = r"\tau_c \operatorname{sgn}\dot\theta"
    params = (Parameter("level", "N m", r"\tau_c", value=0.2, low=0.0, high=1e4),)
    typical = (
        Typical("0.10 N m (MX-106), 4.1 and 5.6 N m (eRob80 with ratios of 50 and 100)", BAM),
        Typical("10.9 to 30.1 N m at joints 4 to 6", MANUTEC),
        Typical("3.4 to 3.6 N m", WALKMAN_B11),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level
