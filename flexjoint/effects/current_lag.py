"""The motor's current follows its command late."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical
from flexjoint.effects._starts import grid

SHORTEST = 1e-7  # s, below which a lag is none


class CurrentLag(Effect):
    """The current loop follows its command like a first-order lag. A short one looks like a dead time.

    Its state z is the torque that the motor gives, the command once that has held for long.
    """

    site, kind, against, reference = (
        Site.COMMAND,
        Kind.TIMING,
        "t",
        "Hughes and Drury 2013, chapter 4 (current loop)",
    )
    law = r"\tau = z,\ \dot z = (\tau_m - z)/T"
    params = (Parameter("time_constant", "s", "T", value=2e-3, low=0.0, high=0.5),)
    states = (0.0,)
    common = True
    known_as = ("torque_delay",)
    typical = (
        Typical(
            "1 ms: the default bandwidth is 1000 rad/s",
            Source(
                "ODrive, firmware",
                "https://github.com/odriverobotics/ODrive/blob/2f3caed8516c92049ac3224e724edf91878b9bff/Firmware/MotorControl/motor.hpp",
            ),
        ),
    )

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return z - s.tau_m

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return (s.tau_m - z) / ops.maximum(p.time_constant, SHORTEST)

    def steady_state(self, s: Signals, p: Any) -> Value:
        return s.tau_m

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, time_constant=np.array((1e-3, 3e-3, 0.01, 0.03, 0.1)))
