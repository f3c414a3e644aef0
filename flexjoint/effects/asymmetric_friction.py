"""Dry friction on the motor shaft that differs between the two directions."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import WALKMAN_B11, WALKMAN_B12


class AsymmetricFriction(Effect):
    """Dry friction on the motor shaft that differs between the two directions; it sticks.

    At rest the level is that of the direction in which the net torque pushes.
    """

    site, against, reference = Site.MOTOR, "dtheta", "Armstrong-Helouvry 1991 (direction-dependent friction)"
    law = r"\tau_+ \text{ if } \dot\theta > 0,\ -\tau_- \text{ if } \dot\theta < 0"
    params = (
        Parameter("level_positive", "N m", r"\tau_+", value=0.3, low=0.0, high=1e4),
        Parameter("level_negative", "N m", r"\tau_-", value=0.2, low=0.0, high=1e4),
    )
    contains = ("motor_coulomb_friction",)
    alike = ("level_positive", "level_negative")
    typical = (
        Typical("3.39 N m one way, 3.56 N m the other (5 % more)", WALKMAN_B11),
        Typical("0.82 N m one way, 0.89 N m the other (9 % more)", WALKMAN_B12),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        direction = ops.where(s.dtheta == 0.0, s.tau_m - s.tau_t, s.dtheta)
        return ops.where(direction >= 0.0, p.level_positive, p.level_negative)
