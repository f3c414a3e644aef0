"""The spring's torque depends on where it comes from."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import HARMONIC_DRIVE
from flexjoint.effects._starts import grid


class SpringHysteresis(Effect):
    """Rate-free loop between torque and deflection (Dahl): its state z is the added torque."""

    site, against, reference = Site.SPRING, "phi", "Dahl 1976"
    law = r"z,\ \dot z = \dot\phi\,\frac{l}{s}\left(1 - \frac{z}{l}\operatorname{sgn}\dot\phi\right)"
    params = (
        Parameter("level", "N m", "l", value=0.5, low=0.0, high=1e5),
        Parameter("scale", "rad", "s", value=3e-3, low=1e-7, high=1.0, null=None),
    )
    states = (0.0,)
    needs_spring = True
    typical = (
        Typical(
            "a loop less than 1 arcmin (0.29 mrad) wide, 3 arcmin (0.87 mrad) at a ratio of 30",
            HARMONIC_DRIVE,
        ),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return z

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return (s.dphi * p.level - z * ops.absolute(s.dphi)) / p.scale

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, scale=float(np.ptp(s.phi)) * np.array((0.01, 0.03, 0.1, 0.3)))
