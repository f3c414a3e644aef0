"""Dry friction on the motor shaft; it sticks."""

from typing import Any

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class MotorCoulombFriction(Effect):
    """Dry friction on the motor shaft; it sticks."""

    site, against, reference = Site.MOTOR, "dtheta", "Armstrong-Helouvry et al. 1994"
    law = r"\tau_c \operatorname{sgn}\dot\theta"
    params = (Param("level", "N m", r"\tau_c", 0.2, 0.0, 1e4),)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level
