"""Dry friction on the motor shaft that is higher near rest."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import MANUTEC
from flexjoint.effects._starts import grid


class StribeckFriction(Effect):
    """Dry friction on the motor shaft that falls from its breakaway level as a film builds up; it sticks."""

    site, against, reference = Site.MOTOR, "dtheta", "Bo and Pavelescu 1982; Armstrong-Helouvry et al. 1994"
    law = r"\left(\tau_c + \tau_s e^{-(\dot\theta / v_s)^2}\right) \operatorname{sgn}\dot\theta"
    params = (
        Parameter("level", "N m", r"\tau_c", value=0.2, low=0.0, high=1e4),
        Parameter("static_extra", "N m", r"\tau_s", value=0.1, low=0.0, high=1e4),
        Parameter("velocity", "rad/s", "v_s", value=0.05, low=1e-5, high=10.0, null=None),
    )
    contains = ("motor_coulomb_friction",)
    typical = (
        Typical(
            "at rest 22 to 54 % more than in motion: 4.9 to 9.5 N m beside 10.9 to 30.1 N m at joints 4 to 6",
            MANUTEC,
        ),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        ratio = s.dtheta / p.velocity
        return p.level + p.static_extra * ops.exp(-ratio * ratio)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        peak = float(np.max(np.abs(s.dtheta)))
        return grid(self.params, velocity=peak * np.geomspace(0.01, 0.5, 5))
