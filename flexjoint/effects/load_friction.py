"""Friction of the gear that grows with the torque it carries."""

from typing import Any

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class LoadFriction(Effect):
    """Dry friction of the gear that grows with the torque it carries; it sticks."""

    site, against, reference = Site.MOTOR, "tau_t", "Hamon, Gautier and Garrec 2010"
    law = r"\mu\,|\tau_t| \operatorname{sgn}\dot\theta"
    params = (Param("coefficient", "1", r"\mu", 0.1, 0.0, 20.0),)

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.coefficient * ops.absolute(s.tau_t)
