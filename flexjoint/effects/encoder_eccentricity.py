"""An encoder's disc sits off its axis."""

from typing import Any

from flexjoint import ops
from flexjoint.effect import Effect, Kind, Param, Signals, Site, Word
from flexjoint.effects._starts import PHASES, grid
from flexjoint.ops import Value


class EncoderEccentricity(Effect):
    """An encoder's disc sits off its axis: its reading errs once per turn of the angle it measures."""

    site, kind, against = Site.SENSOR, Kind.SENSOR, "q"
    reference = "geometry: first harmonic of a disc turning about an axis beside its centre"
    law = r"y = x + a \sin(x + \psi)"
    params = (
        Param("amplitude", "rad", "a", 1e-3, 0.0, 0.5),
        Param("phase", "rad", r"\psi", 0.0, -7.0, 7.0, null=None, wraps=True),
    )
    words = (Word("channel", ("q", "theta"), "q"),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return (p.channel,)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(x + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, phase=PHASES)
