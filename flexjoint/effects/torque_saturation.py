"""The motor cannot give all the torque that is commanded."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical
from flexjoint.effects._starts import grid


class TorqueSaturation(Effect):
    """The motor cannot give all the torque that is commanded; absent at a limit that no command reaches."""

    site, against, reference = Site.COMMAND, "tau_m", "Khalil 2002, section 1.2.7 (saturation)"
    law = r"\tau = \operatorname{clip}(\tau_m, \pm L)"
    params = (Parameter("limit", "N m", "L", value=20.0, low=0.0, high=1e6, null=1e6),)
    typical = (
        Typical(
            "87 N m at joints 1 to 4, 12 N m at joints 5 to 7",
            Source(
                "Franka, limits of the Panda", "https://frankaemika.github.io/docs/control_parameters.html"
            ),
        ),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return ops.clip(x, -p.limit, p.limit)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        size = np.abs(s.tau_m)
        # quantiles for a limit met often, shares of the peak for one met by a few peaks only
        often = np.quantile(size, (0.3, 0.6, 0.8, 0.9, 0.98))
        return grid(self.params, limit=(*often, *(np.max(size) * np.array((0.5, 0.7, 0.85, 0.95)))))
