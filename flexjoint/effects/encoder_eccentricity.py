"""An encoder's disc sits off its axis."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical, Word
from flexjoint.effects._starts import PHASES, grid


class EncoderEccentricity(Effect):
    """An encoder's disc sits off its axis: its reading errs once per turn of the angle it measures."""

    site, kind, against = Site.SENSOR, Kind.SENSOR, "q"
    reference = "geometry: first harmonic of a disc turning about an axis beside its centre"
    law = r"y = x + a \sin(x + \psi)"
    params = (
        Parameter("amplitude", "rad", "a", value=1e-3, low=0.0, high=0.5),
        Parameter("phase", "rad", r"\psi", value=0.0, low=-7.0, high=7.0, null=None, wraps=True),
    )
    words = (Word("channel", ("q", "theta"), "q"),)
    typical = (
        Typical(
            "0.18 to 0.38 deg (3.1 to 6.7 mrad), a ring 0.1 mm off its axis, read at a radius of 32 to 15 mm",
            Source(
                "Synapticon, manual of SOMANET Circulo, page 117",
                "https://manualshive.com/en/manual/synapticon/somanet-circulo-7/1420513?page=117",
            ),
        ),
    )

    def channels(self, p: Any) -> tuple[str, ...]:
        return (p.channel,)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(x + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, phase=PHASES)
