"""The spring gives way slowly under load."""

from typing import Any

import numpy as np

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class SpringCreep(Effect):
    """The spring gives way slowly under load: beside K, its slow stiffness, acts a Maxwell branch.

    The state z is the branch's elastic deflection [rad], 0 at the start: the joint was at rest for long.
    """

    site, against, reference = Site.SPRING, "t", "Findley, Lai and Onaran 1976 (Maxwell branch)"
    law = r"+\,k z,\ \dot z = \dot\phi - z/T"
    params = (
        Parameter("stiffness", "N m/rad", "k", value=10.0, low=0.0, high=1e8),
        Parameter("time_constant", "s", "T", value=2.0, low=1e-2, high=1e4, null=None),
    )
    states = (0.0,)
    needs_spring = True

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.stiffness * z

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return s.dphi - z / p.time_constant

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, time_constant=float(np.ptp(s.t)) * np.array((0.01, 0.05, 0.2, 1.0)))
