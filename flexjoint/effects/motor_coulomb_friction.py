"""Dry friction on the motor shaft; it sticks."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site


class MotorCoulombFriction(Effect):
    """Dry friction on the motor shaft; it sticks."""

    site, against, reference = Site.MOTOR, "dtheta", "Armstrong-Helouvry et al. 1994"
    ordinary = True
    law = r"\tau_c \operatorname{sgn}\dot\theta"
    params = (Parameter("level", "N m", r"\tau_c", value=0.2, low=0.0, high=1e4),)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level
