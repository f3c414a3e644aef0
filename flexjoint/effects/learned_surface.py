"""A torque on the motor that was learned, of two signals: it has no name."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Word
from flexjoint.effects._spline import SIDE, SPAN, START, surface

CHOICES = ("dtheta", "theta", "tau_t", "tau_m", "tau_m_before", "tau_m_after")


class LearnedSurface(Effect):
    """A torque on the motor, or on a rigid joint, that follows two signals by no law of the catalogue: a
    product of splines through what causes leave, which holds sums of two laws as well. It is never named as a
    cause."""

    site, against, reference = Site.MOTOR, "theta", "Eilers and Marx 2003 (tensor products of P-splines)"
    law = (
        r"+\sum_{jk} c_{jk}\, b\left(\frac{x - x_0}{h_x} + 1 - j\right)"
        r" b\left(\frac{y - y_0}{h_y} + 1 - k\right)"
    )
    params = (
        Parameter("torques", "N m", "c_{jk}", value=0.1, low=-1e5, high=1e5, size=SIDE * SIDE),
        START,
        SPAN,
        Parameter("other_start", "of the other signal", "y_0", value=-1.0, low=-1e6, high=1e6, null=None),
        Parameter("other_span", "of the other signal", "w_y", value=2.0, low=1e-6, high=1e6, null=None),
    )
    words = (Word("signal", CHOICES, "dtheta"), Word("other", CHOICES, "theta"))
    is_cause = False

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return surface(getattr(s, p.signal), getattr(s, p.other), p, p.torques)
