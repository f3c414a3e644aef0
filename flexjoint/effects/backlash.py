"""Play in the transmission."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical
from flexjoint.effects._sources import DYNAMIXEL, HARMONIC_DRIVE, TWO_STAGES
from flexjoint.effects._starts import grid


class Backlash(Effect):
    """Play in the transmission: inside the gap neither spring nor damper acts."""

    site, against, reference = Site.DEFLECTION, "phi", "Nordin and Gutman 2002 (dead-zone model)"
    law = r"\phi - \operatorname{clip}(\phi, \pm g/2)"
    params = (Parameter("gap", "rad", "g", value=1e-3, low=0.0, high=0.5),)
    needs_spring = True
    typical = (
        Typical("lost motion below 1 arcmin (0.29 mrad)", HARMONIC_DRIVE),
        Typical(
            "at most 3 arcmin (0.87 mrad), 1 arcmin in the reduced version",
            Source(
                "Beckhoff, data of the TP010 planetary gear",
                "https://infosys.beckhoff.com/content/1033/ag2400_ba/8995369483.html",
            ),
        ),
        Typical("at most 8 arcmin (2.3 mrad) with one stage, 10 arcmin (2.9 mrad) with two", TWO_STAGES),
        Typical("20 arcmin (5.8 mrad)", DYNAMIXEL),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x - ops.clip(x, -0.5 * p.gap, 0.5 * p.gap)

    def slope(self, s: Signals, p: Any) -> Value:
        return ops.where(ops.absolute(s.phi) > 0.5 * p.gap, 1.0, 0.0)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        widest = 2.0 * float(np.max(np.abs(s.phi)))  # a wider one carries nothing, on whichever side
        return grid(self.params, gap=widest * np.array((0.02, 0.06, 0.15, 0.3, 0.5, 0.75)))
