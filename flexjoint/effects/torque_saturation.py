"""The motor cannot give all the torque it was told."""

from typing import Any

import numpy as np

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class TorqueSaturation(Effect):
    """The motor cannot give all the torque it was told; absent at a limit that no command reaches."""

    site, against, reference = Site.COMMAND, "tau_m", "Khalil 2002, section 1.2.7 (saturation)"
    law = r"\tau = \operatorname{clip}(\tau_m, \pm L)"
    params = (Param("limit", "N m", "L", 20.0, 0.0, 1e6, null=1e6),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return ops.clip(x, -p.limit, p.limit)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        size = np.abs(s.tau_m)
        # quantiles for a limit met often, shares of the peak for one met by a few peaks only
        often = np.quantile(size, (0.3, 0.6, 0.8, 0.9, 0.98))
        return grid(self.params, limit=(*often, *(np.max(size) * np.array((0.5, 0.7, 0.85, 0.95)))))
