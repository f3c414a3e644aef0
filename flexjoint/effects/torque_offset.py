"""The motor adds a constant torque to what it was told."""

from typing import Any

from flexjoint.effect import Effect, Param, Signals, Site
from flexjoint.ops import Value


class TorqueOffset(Effect):
    """The motor adds a constant torque to what it was told: the zero of its current amplifier is off."""

    site, against = Site.COMMAND, "t"
    reference = "Khalil and Dombre 2002, chapter 12 (current offset)"
    law = r"\tau = \tau_m + b"
    params = (Param("offset", "N m", "b", 0.5, -1e5, 1e5),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
