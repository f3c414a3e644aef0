"""The motor's torque ripples with its angle."""

from typing import Any

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import PHASES, grid, ripple_cycles, whole_cycles
from flexjoint.ops import Value


class Cogging(Effect):
    """The motor's torque ripples with its angle, loaded or not; cycles counts per turn of theta."""

    site, against, reference = Site.COMMAND, "theta", "Hanselman 2006 (cogging torque)"
    law = r"\tau = \tau_m + a \sin(n \theta + \psi)"
    params = (
        Param("amplitude", "N m", "a", 0.2, 0.0, 1e4),
        Param("cycles", "1", "n", 12.0, 0.5, 5e3, null=None, step=0.01),
        Param("phase", "rad", r"\psi", 0.0, -7.0, 7.0, null=None, wraps=True),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(p.cycles * s.theta + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        cycles = (*whole_cycles(s.theta), *ripple_cycles(s.theta, s.tau_m, (s.tau_t, s.dtheta), s.t))
        return grid(self.params, cycles=cycles, phase=PHASES)
