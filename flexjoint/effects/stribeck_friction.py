"""Dry friction on the motor shaft that is higher near rest."""

from typing import Any

import numpy as np

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value


class StribeckFriction(Effect):
    """Dry friction on the motor shaft that falls from its breakaway level as a film builds up; it sticks."""

    site, against, reference = Site.MOTOR, "dtheta", "Bo and Pavelescu 1982; Armstrong-Helouvry et al. 1994"
    law = r"\left(\tau_c + \tau_s e^{-(\dot\theta / v_s)^2}\right) \operatorname{sgn}\dot\theta"
    params = (
        Param("level", "N m", r"\tau_c", 0.2, 0.0, 1e4),
        Param("static_extra", "N m", r"\tau_s", 0.1, 0.0, 1e4),
        Param("velocity", "rad/s", "v_s", 0.05, 1e-5, 10.0, null=None),
    )
    contains = ("motor_coulomb_friction",)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        ratio = s.dtheta / p.velocity
        return p.level + p.static_extra * ops.exp(-ratio * ratio)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        peak = float(np.max(np.abs(s.dtheta)))
        return grid(self.params, velocity=peak * np.geomspace(0.01, 0.5, 5))
