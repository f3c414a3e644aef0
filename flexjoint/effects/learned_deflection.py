"""A deflection of the transmission that was learned: it has no name."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Word
from flexjoint.effects._spline import COUNT, SPAN, START, spline, spline_slope


class LearnedDeflection(Effect):
    """A deflection of the transmission that follows one signal by no law of the catalogue: a spline through
    what causes leave, of the motor's angle or of the deflection itself. It is never named as a cause."""

    site, against, reference = Site.DEFLECTION, "theta", "Eilers and Marx 1996 (penalised B-splines)"
    law = r"\phi + \sum_k c_k\, b\left(\frac{x - x_0}{h} + 1 - k\right)"
    params = (
        Parameter("angles", "rad", "c_k", value=1e-3, low=-0.5, high=0.5, size=COUNT),
        START,
        SPAN,
    )
    words = (Word("signal", ("theta", "phi"), "theta"),)
    needs_spring = True
    is_cause = False

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + spline(x if p.signal == "phi" else s.theta, p, p.angles)

    def slope(self, s: Signals, p: Any) -> Value:
        return 1.0 + spline_slope(s.phi, p, p.angles) if p.signal == "phi" else 1.0
