"""An encoder's lines are not even."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical, Word
from flexjoint.effects._starts import PHASES, few_periods, grid


class EncoderRipple(Effect):
    """An encoder's reading ripples with the angle it measures: its lines, or what divides them, are uneven,
    or it is driven through a wheel of its own that runs out of true."""

    site, kind, against, repeats = Site.SENSOR, Kind.SENSOR, "q", "cycles"
    reference = "Kavanagh 2001 (errors of encoders within a line)"
    law = r"y = x + a \sin(n x + \psi)"
    params = (
        Parameter("amplitude", "rad", "a", value=1e-4, low=0.0, high=0.5),
        Parameter("cycles", "1", "n", value=1024.0, low=1.5, high=1e6, null=None, step=0.01),
        Parameter("phase", "rad", r"\psi", value=0.0, low=-7.0, high=7.0, null=None, wraps=True),
    )
    words = (Word("channel", ("q", "theta"), "q"),)
    typical = (
        Typical(
            "4 deg of a period, twice in each: sine and cosine are 8 deg off (7 mrad at 10 periods a turn)",
            Source(
                "VESC, firmware, pull request 569, a user's motor with Hall sensors",
                "https://github.com/vedderb/bldc/pull/569",
            ),
        ),
    )

    def channels(self, p: Any) -> tuple[str, ...]:
        return (p.channel,)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(p.cycles * x + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        cycles = few_periods(s.q) or (self.params[1].value,)
        return grid(self.params, cycles=cycles, phase=PHASES)
