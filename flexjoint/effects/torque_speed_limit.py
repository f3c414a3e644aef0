"""The faster the motor turns, the less torque it has left."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import DYNAMIXEL
from flexjoint.effects._starts import grid

LIMITED = np.array((0.65, 0.85, 0.97))  # of the largest torque that a line meets


class TorqueSpeedLimit(Effect):
    """The supply voltage limits the torque: the faster the motor turns, the less it can add to its speed."""

    site, against, reference = Site.COMMAND, "dtheta", "Hughes and Drury 2013, chapter 3 (torque-speed line)"
    law = r"\tau = \operatorname{clip}(\tau_m, -L - c\,\dot\theta, L - c\,\dot\theta)"
    params = (
        Parameter("stall", "N m", "L", value=50.0, low=0.0, high=1e6, null=1e6),
        Parameter("drop", "N m s/rad", "c", value=5.0, low=0.0, high=1e5),
    )
    contains = ("torque_saturation",)
    typical = (
        Typical(
            "at 12 V 8.4 N m at a stall and 45 rpm (4.7 rad/s) without load: a drop of 1.8 N m s/rad",
            DYNAMIXEL,
        ),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        lost = p.drop * s.dtheta
        return ops.clip(x, -p.stall - lost, p.stall - lost)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        torque, speed = float(np.max(np.abs(s.tau_m))), float(np.max(np.abs(s.dtheta)))
        drops = np.array((0.15, 0.4, 1.0)) * (torque / speed if speed > 0.0 else 1.0)
        # of each line those that cut off the peaks of what they limit, little or more
        return tuple(
            start
            for drop in drops
            for start in grid(
                self.params, stall=np.max(np.abs(s.tau_m + drop * s.dtheta)) * LIMITED, drop=(drop,)
            )
        )
