"""The motor's torque ripples with its angle."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical
from flexjoint.effects._sources import WALKMAN_B12
from flexjoint.effects._starts import PHASES, grid, whole_cycles


class Cogging(Effect):
    """The motor's torque ripples with its angle, loaded or not; cycles counts per turn of theta."""

    site, against, repeats = Site.COMMAND, "theta", "cycles"
    reference = "Hanselman 2006 (cogging torque)"
    law = r"\tau = \tau_m + a \sin(n \theta + \psi)"
    params = (
        Parameter("amplitude", "N m", "a", value=0.2, low=0.0, high=1e4),
        Parameter("cycles", "1", "n", value=12.0, low=0.5, high=5e3, null=None, step=0.01),
        Parameter("phase", "rad", r"\psi", value=0.0, low=-7.0, high=7.0, null=None, wraps=True),
    )
    typical = (
        Typical(
            "1.5 N m seen from the link (15 mN m at the motor, ratio 100), 13 periods per turn of the motor",
            WALKMAN_B12,
        ),
        Typical(
            "4 % of the standstill torque: 0.014 to 0.016 N m of 0.38 N m",
            Source(
                "Beckhoff, data of the AS1010 stepper motor",
                "https://infosys.beckhoff.com/content/1033/as1000_ba/1426750347.html",
            ),
        ),
        Typical(
            "3 to 4 % of the standstill torque: 0.15 to 0.22 N m of 5.0 N m",
            Source(
                "Beckhoff, data of the AS1060 stepper motor",
                "https://infosys.beckhoff.com/content/1033/as1000_ba/1426858379.html",
            ),
        ),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.amplitude * ops.sin(p.cycles * s.theta + p.phase)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, cycles=whole_cycles(s.theta, 0.5), phase=PHASES)
