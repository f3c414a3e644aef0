"""Drag at the link that grows with its speed squared."""

from typing import Any

from flexjoint import ops
from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class QuadraticDrag(Effect):
    """Drag of air or water on the link, which grows with its speed squared."""

    site, against, reference = Site.LINK, "dq", "Fossen 2011, section 6.4 (quadratic drag)"
    law = r"-c\,|\dot q|\,\dot q"
    params = (Param("coefficient", "N m s^2/rad^2", "c", 0.1, 0.0, 1e5),)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -p.coefficient * ops.absolute(s.dq) * s.dq
