"""The motor adds a constant torque to the commanded one."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import TX40


class TorqueOffset(Effect):
    """The motor adds a constant torque to the commanded one: the zero of its current amplifier is off."""

    site, against = Site.COMMAND, "t"
    reference = "Khalil and Dombre 2002, chapter 12 (current offset)"
    law = r"\tau = \tau_m + b"
    params = (Parameter("offset", "N m", "b", value=0.5, low=-1e5, high=1e5),)
    typical = (Typical("0.03 to 1.4 N m at joints 1 to 6", TX40),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
