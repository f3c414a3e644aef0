"""A torque on the motor that was learned: it has no name."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Word
from flexjoint.effects._spline import COUNT, SPAN, START, spline


class LearnedTorque(Effect):
    """A torque on the motor, or on a rigid joint, that follows one signal by no law of the catalogue: a
    spline through what causes leave. It is never named as a cause."""

    site, against, reference = Site.MOTOR, "dtheta", "Eilers and Marx 1996 (penalised B-splines)"
    law = r"+\sum_k c_k\, b\left(\frac{x - x_0}{h} + 1 - k\right)"
    params = (
        Parameter("torques", "N m", "c_k", value=0.1, low=-1e5, high=1e5, size=COUNT),
        START,
        SPAN,
    )
    words = (Word("signal", ("dtheta", "theta", "tau_t", "tau_m", "tau_m_before", "tau_m_after"), "dtheta"),)
    is_cause = False

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return spline(getattr(s, p.signal), p, p.torques)
