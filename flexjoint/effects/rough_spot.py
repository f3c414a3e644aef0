"""The motor or gear rubs at one place."""

from typing import Any

import numpy as np

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class RoughSpot(Effect):
    """The motor or gear rubs at one place: dry friction around one angle theta; it sticks."""

    site, against, reference = Site.MOTOR, "theta", "Armstrong-Helouvry 1991 (position-dependent friction)"
    law = r"l\, e^{-((\theta - \theta_0)/w)^2} \operatorname{sgn}\dot\theta"
    params = (
        Param("level", "N m", "l", 0.5, 0.0, 1e4),
        Param("position", "rad", r"\theta_0", 0.0, -100.0, 100.0, null=None),
        Param("width", "rad", "w", 0.05, 1e-4, 100.0, null=None),
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
