"""Dry friction that gives way like a spring before it slips."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class DahlFriction(Effect):
    """Dry friction on the motor shaft that gives way like a spring of `scale` before it slips.

    Its state z is the friction torque, 0 at the start.
    """

    site, against, reference = Site.MOTOR, "theta", "Dahl 1976"
    law = r"z,\ \dot z = \dot\theta\,\frac{l}{s}\left(1 - \frac{z}{l}\operatorname{sgn}\dot\theta\right)"
    params = (
        Parameter("level", "N m", "l", value=0.2, low=0.0, high=1e4),
        Parameter("scale", "rad", "s", value=3e-3, low=1e-6, high=1.0, null=None),
    )
    states = (0.0,)
    contains = ("motor_coulomb_friction",)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -z

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return (s.dtheta * p.level - z * ops.absolute(s.dtheta)) / p.scale

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, scale=float(np.ptp(s.theta)) * np.array((1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1)))
