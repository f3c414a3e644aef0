"""The link runs into something elastic."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class EndStop(Effect):
    """The link runs into something elastic: an upper stop, or at a negative position a lower one."""

    site, against, reference = Site.LINK, "q", "Gilardi and Sharf 2002 (linear contact spring)"
    law = r"-k \max(q - q_s, 0) \text{ if } q_s \geq 0,\ -k \min(q - q_s, 0) \text{ if } q_s < 0"
    params = (
        Parameter("position", "rad", "q_s", value=1.0, low=-100.0, high=100.0, null=None),
        Parameter("stiffness", "N m/rad", "k", value=100.0, low=0.0, high=1e9),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        beyond = s.q - p.position
        pressed = ops.where(p.position < 0.0, ops.minimum(beyond, 0.0), ops.maximum(beyond, 0.0))
        return -p.stiffness * pressed

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        low, high, travel = float(np.min(s.q)), float(np.max(s.q)), float(np.ptp(s.q))
        shares = (0.02, 0.1)  # of the travel: a stop met seldom; quantiles: one leant on
        upper = (*np.quantile(s.q, (0.7, 0.85, 0.95, 0.99)), *(high - travel * share for share in shares))
        lower = (*np.quantile(s.q, (0.3, 0.15, 0.05, 0.01)), *(low + travel * share for share in shares))
        found = [float(x) for x in upper if x >= 0.0] + [float(x) for x in lower if x < 0.0]
        return grid(self.params, position=found)
