"""The gear does not turn evenly."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import HARMONIC_DRIVE
from flexjoint.effects._starts import PHASES, grid, whole_cycles


class TransmissionError(Effect):
    """The gear does not turn evenly: what reaches the spring ripples with the motor's angle.

    The damper acts on dphi as before; cycles counts per turn of theta.
    """

    site, against, repeats = Site.DEFLECTION, "theta", "cycles"
    reference = "Ghorbel, Gandhi and Alpeter 2001"
    law = r"\phi + a \sin(n \theta + \psi)"
    params = (
        Parameter("amplitude", "rad", "a", value=5e-4, low=0.0, high=0.5),
        Parameter("cycles", "1", "n", value=2.0, low=0.5, high=5e3, null=None, step=0.01),
        Parameter("phase", "rad", r"\psi", value=0.0, low=-7.0, high=7.0, null=None, wraps=True),
    )
    needs_spring = True
    typical = (
        Typical(
            "two amplitudes, highest to lowest: less than 0.5 to 2 arcmin (0.15 to 0.58 mrad)",
            HARMONIC_DRIVE,
        ),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(p.cycles * s.theta + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, cycles=whole_cycles(s.theta), phase=PHASES)
