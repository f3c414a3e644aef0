"""Friction at the link that grows with its speed."""

from typing import Any

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class LinkViscousFriction(Effect):
    """Friction at the link, beyond the spring, that grows with the link's speed."""

    site, against, reference = Site.LINK, "dq", "Armstrong-Helouvry et al. 1994"
    law = r"-d_l\,\dot q"
    params = (Param("coefficient", "N m s/rad", "d_l", 0.1, 0.0, 1e5),)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -p.coefficient * s.dq
