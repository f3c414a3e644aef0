"""The spring gives way slowly under load."""

from typing import Any

import numpy as np

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class SpringCreep(Effect):
    """The spring gives way slowly under load: beside K, its slow stiffness, acts a Maxwell branch.

    The state z is the branch's elastic deflection [rad], 0 at the start: the joint had settled.
    """

    site, against, reference = Site.SPRING, "t", "Findley, Lai and Onaran 1976 (Maxwell branch)"
    law = r"+\,k z,\ \dot z = \dot\phi - z/T"
    params = (
        Param("stiffness", "N m/rad", "k", 10.0, 0.0, 1e8),
        Param("time_constant", "s", "T", 2.0, 1e-2, 1e4, null=None),
    )
    states = (0.0,)
    needs_spring = True

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.stiffness * z

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return s.dphi - z / p.time_constant

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, time_constant=float(np.ptp(s.t)) * np.array((0.01, 0.05, 0.2, 1.0)))
