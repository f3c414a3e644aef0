"""The commanded torque acts late."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical
from flexjoint.effects._starts import grid


class TorqueDelay(Effect):
    """The commanded torque acts late; a short first-order lag of the current loop looks the same."""

    site, kind, against, reference = Site.COMMAND, Kind.TIMING, "t", "Franklin, Powell and Workman 1998"
    common = True
    law = r"\tau(t) = \tau_m(t - T)"
    params = (Parameter("delay", "s", "T", value=2e-3, low=0.0, high=0.05),)
    max_delay = 0.05
    typical = (
        Typical(
            "less than 1 ms from the robot's data to the torque that answers it: a later one is dropped",
            Source(
                "Franka, requirements of the control interface",
                "https://github.com/frankaemika/docs/blob/4672efa2d41557f15369340f0277c6787b8af6ea/_sources/requirements.rst.txt",
            ),
        ),
    )

    def delay(self, p: Any) -> Value:
        return p.delay

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, delay=(1e-3, 3e-3, 8e-3, 0.02, 0.04))
