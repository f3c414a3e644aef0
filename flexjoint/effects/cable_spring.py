"""Cables or a counterbalance pull the link towards one position."""

from typing import Any

import numpy as np

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class CableSpring(Effect):
    """Cables, hoses or a counterbalance spring pull the link towards one position."""

    site, against, reference = Site.LINK, "q", "formats: stiffness (rest - q)"
    law = r"k\,(q_0 - q)"
    params = (
        Param("stiffness", "N m/rad", "k", 1.0, 0.0, 1e7),
        Param("rest", "rad", "q_0", 0.0, -100.0, 100.0, null=None),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.stiffness * (p.rest - s.q)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        centre, half = 0.5 * float(np.max(s.q) + np.min(s.q)), 0.5 * float(np.ptp(s.q))
        return grid(self.params, rest=centre + half * np.array((-4.0, -1.0, 0.0, 1.0, 4.0)))
