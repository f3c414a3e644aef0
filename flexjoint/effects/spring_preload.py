"""The spring carries a torque at zero deflection."""

from typing import Any

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class SpringPreload(Effect):
    """The spring carries a torque at zero deflection: it was mounted twisted."""

    site, against, reference = Site.SPRING, "t", "formats: tau_t + torque"
    law = r"\tau_t + \tau_0"
    params = (Param("torque", "N m", r"\tau_0", 0.5, -1e5, 1e5),)
    needs_spring = True

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.torque
