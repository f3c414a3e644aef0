"""Friction that fades as the joint warms up."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid


class FrictionDrift(Effect):
    """Dry friction on the motor shaft that fades from the start of the recording: the joint warms up."""

    site, against, reference = Site.MOTOR, "t", "Bittencourt and Gunnarsson 2012 (friction over temperature)"
    law = r"\tau_d\, e^{-t/T} \operatorname{sgn}\dot\theta"
    params = (
        Parameter("level", "N m", r"\tau_d", value=0.2, low=0.0, high=1e4),
        Parameter("time_constant", "s", "T", value=60.0, low=1.0, high=1e5, null=None),
    )
    contains = ("motor_coulomb_friction",)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level * ops.exp(-s.t / p.time_constant)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, time_constant=float(np.ptp(s.t)) * np.array((0.1, 0.3, 1.0, 3.0)))
