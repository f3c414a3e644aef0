"""Dry friction at the link; it sticks."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical


class LinkCoulombFriction(Effect):
    """Dry friction at the link, beyond the spring: bearing or seal; it sticks."""

    site, against, reference = Site.LINK, "dq", "Armstrong-Helouvry et al. 1994"
    on_rigid = "motor_coulomb_friction"
    law = r"\tau_l \operatorname{sgn}\dot q"
    params = (Parameter("level", "N m", r"\tau_l", value=0.1, low=0.0, high=1e4),)
    typical = (
        Typical(
            "0.15 to 0.64 N m at a Panda's joints, whose torque sensors are at the links",
            Source(
                "Gaz et al. 2019, model of the Panda",
                "https://github.com/marcocognetti/FrankaEmikaPandaDynModel/blob/"
                "371fa13e0521b38dd810a069100b65b5fb9630c7/matlab/dyn_model_panda/get_FrictionTorque.m",
            ),
        ),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level
