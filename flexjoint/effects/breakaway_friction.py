"""Dry friction after a long rest."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class BreakawayFriction(Effect):
    """Dry friction on the motor shaft that a long rest has built up: it wears off as the joint travels.

    Its state z is what is left of it, 1 at the start of a recording; standstills in between are taken as
    too short to build it up again.
    """

    site, against, reference = Site.MOTOR, "t", "Dieterich 1979 and Ruina 1983 (slip law), after a rest"
    law = r"\tau_b\, z \operatorname{sgn}\dot\theta,\ \dot z = -\frac{|\dot\theta|}{d} z,\ z(0) = 1"
    params = (
        Parameter("level", "N m", r"\tau_b", value=0.2, low=0.0, high=1e4),
        Parameter("distance", "rad", "d", value=0.01, low=1e-6, high=100.0, null=None),
    )
    states = (1.0,)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level * z

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return -ops.absolute(s.dtheta) / p.distance * z

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        travel = float(np.sum(np.abs(np.diff(s.theta))))  # many times the range of a joint that swings
        within = float(np.ptp(s.theta)) * np.geomspace(1e-3, 0.3, 6)
        return grid(self.params, distance=[*within, 0.1 * travel, 0.3 * travel])
