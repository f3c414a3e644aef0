"""Something shakes the link at a rhythm of its own."""

from math import pi
from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site


class PeriodicDisturbance(Effect):
    """Something shakes the link at a rhythm of its own (a fan, a pump, a tool out of balance, a swaying
    base), whatever the robot does. The phase counts from the recording's start."""

    site, against, repeats = Site.LINK, "t", "frequency"
    reference = "Francis and Wonham 1976 (disturbances of known rhythm)"
    law = r"+\,a \sin(2 \pi f t + \psi)"
    params = (
        Parameter("amplitude", "N m", "a", value=0.2, low=0.0, high=1e4),
        Parameter("frequency", "Hz", "f", value=5.0, low=0.05, high=1e3, null=None, step=1e-3),
        Parameter("phase", "rad", r"\psi", value=0.0, low=-7.0, high=7.0, null=None, wraps=True),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.amplitude * ops.sin(2.0 * pi * p.frequency * s.t + p.phase)
