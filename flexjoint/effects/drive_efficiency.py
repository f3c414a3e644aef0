"""The gear loses more torque one way than the other."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical
from flexjoint.effects._sources import TWO_STAGES


class DriveEfficiency(Effect):
    """Gear friction that differs between driving the load and being driven by it; it sticks.

    The efficiencies are 1/(1 + loss_driving) and 1 - loss_backdriving: from 1 on, the gear locks itself.
    At rest the case is that of the direction in which the net torque pushes.
    """

    site, against, reference = Site.MOTOR, "tau_t", "Giberti, Cinquemani and Legnani 2010 (direct, inverse)"
    law = (
        r"\mu\,|\tau_t| \operatorname{sgn}\dot\theta,\ "
        r"\mu = \mu_d \text{ if } \tau_t\dot\theta \geq 0,\ \mu_b \text{ if } \tau_t\dot\theta < 0"
    )
    params = (
        # an efficiency of a fifth: that of the worst worm gears
        Parameter("loss_driving", "1", r"\mu_d", value=0.1, low=0.0, high=4.0),
        Parameter("loss_backdriving", "1", r"\mu_b", value=0.2, low=0.0, high=4.0),
    )
    contains = ("load_friction",)
    alike = ("loss_driving", "loss_backdriving")
    typical = (
        Typical("efficiency 97 % with one stage, 95 % with two: loss_driving 0.03 and 0.05", TWO_STAGES),
        Typical(
            "efficiency 94 % with two stages, 92 % with three: loss_driving 0.06 and 0.09",
            Source(
                "Beckhoff, data of the TP050 planetary gear",
                "https://infosys.beckhoff.com/content/1033/ag2400_ba/9001045515.html",
            ),
        ),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        direction = ops.where(s.dtheta == 0.0, s.tau_m - s.tau_t, s.dtheta)
        loss = ops.where(s.tau_t * direction >= 0.0, p.loss_driving, p.loss_backdriving)
        return loss * ops.absolute(s.tau_t)
