"""The spring carries a torque at zero deflection."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site


class SpringPreload(Effect):
    """The spring carries a torque at zero deflection: it was mounted twisted."""

    site, against, reference = Site.SPRING, "t", "formats: tau_t + torque"
    law = r"\tau_t + \tau_0"
    params = (Parameter("torque", "N m", r"\tau_0", value=0.5, low=-1e5, high=1e5),)
    needs_spring = True

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.torque
