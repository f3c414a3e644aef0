"""Drag at the link that grows with its speed squared."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site


class QuadraticDrag(Effect):
    """Drag of air or water on the link, which grows with its speed squared."""

    site, against, reference = Site.LINK, "dq", "Fossen 2011, section 6.4 (quadratic drag)"
    law = r"-c\,|\dot q|\,\dot q"
    params = (Parameter("coefficient", "N m s^2/rad^2", "c", value=0.1, low=0.0, high=1e5),)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -p.coefficient * ops.absolute(s.dq) * s.dq
