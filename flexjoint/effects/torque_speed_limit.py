"""The faster the motor turns, the less torque it has left."""

from typing import Any

import numpy as np

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.effects._starts import grid
from flexjoint.ops import Value

LIMITED = np.array((0.65, 0.85, 0.97))  # of the largest torque that a line meets


class TorqueSpeedLimit(Effect):
    """The supply voltage limits the torque: the faster the motor turns, the less it can add to its speed."""

    site, against, reference = Site.COMMAND, "dtheta", "Hughes and Drury 2013, chapter 3 (torque-speed line)"
    law = r"\tau = \operatorname{clip}(\tau_m, -L - c\,\dot\theta, L - c\,\dot\theta)"
    params = (
        Param("stall", "N m", "L", 50.0, 0.0, 1e6, null=1e6),
        Param("drop", "N m s/rad", "c", 5.0, 0.0, 1e5),
    )
    contains = ("torque_saturation",)

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
