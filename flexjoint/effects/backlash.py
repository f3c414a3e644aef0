"""Play in the transmission."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class Backlash(Effect):
    """Play in the transmission: inside the gap neither spring nor damper acts."""

    site, against, reference = Site.DEFLECTION, "phi", "Nordin and Gutman 2002 (dead-zone model)"
    law = r"\phi - \operatorname{clip}(\phi, \pm g/2)"
    params = (Parameter("gap", "rad", "g", value=1e-3, low=0.0, high=0.5),)
    needs_spring = True

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x - ops.clip(x, -0.5 * p.gap, 0.5 * p.gap)

    def slope(self, s: Signals, p: Any) -> Value:
        return ops.where(ops.absolute(s.phi) > 0.5 * p.gap, 1.0, 0.0)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, gap=float(np.ptp(s.phi)) * np.array((0.02, 0.06, 0.15, 0.3, 0.5, 0.75)))
