"""Cables or a counterbalance pull the link towards one position."""

from typing import Any

import numpy as np

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical
from flexjoint.effects._starts import grid


class CableSpring(Effect):
    """Cables, hoses or a counterbalance spring pull the link towards one position."""

    site, against, reference = Site.LINK, "q", "formats: stiffness (rest - q)"
    law = r"k\,(q_0 - q)"
    params = (
        Parameter("stiffness", "N m/rad", "k", value=1.0, low=0.0, high=1e7),
        Parameter("rest", "rad", "q_0", value=0.0, low=-100.0, high=100.0, null=None),
    )
    typical = (
        Typical(
            "0.14 and 0.36 N m/rad at joints 1 and 2 of a da Vinci's patient-side arm",
            Source(
                "dvrk_dynamics, identified parameters",
                "https://github.com/gafontanelli/DVRK-dynamicModel/blob/90aef4bc7d4ac33290be3027a74533b2740e9565/"
                "dvrk_dynamics/include/PSM_dynamics_parameters.h",
            ),
        ),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.stiffness * (p.rest - s.q)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        centre, half = 0.5 * float(np.max(s.q) + np.min(s.q)), 0.5 * float(np.ptp(s.q))
        return grid(self.params, rest=centre + half * np.array((-4.0, -1.0, 0.0, 1.0, 4.0)))
