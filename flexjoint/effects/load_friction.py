"""Friction of the gear that grows with the torque it carries."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import BAM


class LoadFriction(Effect):
    """Dry friction of the gear that grows with the torque it carries; it sticks."""

    site, against, reference = Site.MOTOR, "tau_t", "Hamon, Gautier and Garrec 2010"
    law = r"\mu\,|\tau_t| \operatorname{sgn}\dot\theta"
    params = (Parameter("coefficient", "1", r"\mu", value=0.1, low=0.0, high=20.0),)
    typical = (
        Typical(
            "0.13 to 0.30 of the torque carried (0.06 to 0.15 of the sum of both sides of the gear)", BAM
        ),
    )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.coefficient * ops.absolute(s.tau_t)
