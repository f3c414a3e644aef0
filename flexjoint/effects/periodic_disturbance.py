"""Something shakes the link at a rhythm of its own."""

from math import pi
from typing import Any

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import PHASES, grid, rhythms
from flexjoint.ops import Value


class PeriodicDisturbance(Effect):
    """Something shakes the link at a rhythm of its own (a fan, a pump, a tool out of balance, a swaying
    base), whatever the robot does. The phase counts from the recording's start."""

    site, against, reference = Site.LINK, "t", "Francis and Wonham 1976 (disturbances of known rhythm)"
    law = r"+\,a \sin(2 \pi f t + \psi)"
    params = (
        Param("amplitude", "N m", "a", 0.2, 0.0, 1e4),
        Param("frequency", "Hz", "f", 5.0, 0.05, 1e3, null=None, step=1e-3),
        Param("phase", "rad", r"\psi", 0.0, -7.0, 7.0, null=None, wraps=True),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.amplitude * ops.sin(2.0 * pi * p.frequency * s.t + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, frequency=rhythms(s), phase=PHASES)
