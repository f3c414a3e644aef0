"""The motor or gear rubs at one place."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class RoughSpot(Effect):
    """The motor or gear rubs at one place: dry friction around one angle theta; it sticks."""

    site, against, reference = Site.MOTOR, "theta", "Armstrong-Helouvry 1991 (position-dependent friction)"
    law = r"l\, e^{-((\theta - \theta_0)/w)^2} \operatorname{sgn}\dot\theta"
    params = (
        Parameter("level", "N m", "l", value=0.5, low=0.0, high=1e4),
        Parameter("position", "rad", r"\theta_0", value=0.0, low=-100.0, high=100.0, null=None),
        Parameter("width", "rad", "w", value=0.05, low=1e-4, high=100.0, null=None),
    )
    contains = ("motor_coulomb_friction",)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        distance = (s.theta - p.position) / p.width
        return p.level * ops.exp(-distance * distance)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        low, travel = float(np.min(s.theta)), float(np.ptp(s.theta))
        narrow, wide = (low + travel * np.linspace(0.0, 1.0, count) for count in (15, 6))
        return (
            *grid(self.params, position=narrow, width=(0.05 * travel,)),
            *grid(self.params, position=wide, width=(0.15 * travel + 1e-3,)),
        )
