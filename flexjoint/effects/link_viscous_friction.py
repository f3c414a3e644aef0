"""Friction at the link that grows with its speed."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site


class LinkViscousFriction(Effect):
    """Friction at the link, beyond the spring, that grows with the link's speed."""

    site, against, reference = Site.LINK, "dq", "Armstrong-Helouvry et al. 1994"
    on_rigid = "motor_viscous_friction"
    law = r"-d_l\,\dot q"
    params = (Parameter("coefficient", "N m s/rad", "d_l", value=0.1, low=0.0, high=1e5),)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -p.coefficient * s.dq
