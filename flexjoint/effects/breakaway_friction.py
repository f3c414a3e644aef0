"""Dry friction after a long rest."""

from typing import Any

import numpy as np

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class BreakawayFriction(Effect):
    """Dry friction on the motor shaft that a long rest has built up: it wears off as the joint travels.

    Its state z is what is left of it, 1 at the start of a recording; standstills in between are taken as
    too short to build it up again.
    """

    site, against, reference = Site.MOTOR, "t", "Dieterich 1979 and Ruina 1983 (slip law), after a rest"
    law = r"\tau_b\, z \operatorname{sgn}\dot\theta,\ \dot z = -\frac{|\dot\theta|}{d} z,\ z(0) = 1"
    params = (
        Param("level", "N m", r"\tau_b", 0.2, 0.0, 1e4),
        Param("distance", "rad", "d", 0.01, 1e-6, 100.0, null=None),
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
