"""Dry friction at the link; it sticks."""

from typing import Any

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class LinkCoulombFriction(Effect):
    """Dry friction at the link, beyond the spring: bearing or seal; it sticks."""

    site, against, reference = Site.LINK, "dq", "Armstrong-Helouvry et al. 1994"
    law = r"\tau_l \operatorname{sgn}\dot q"
    params = (Param("level", "N m", r"\tau_l", 0.1, 0.0, 1e4),)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level
