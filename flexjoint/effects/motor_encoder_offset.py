"""The motor encoder's zero is off."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site


class MotorEncoderOffset(Effect):
    """The motor encoder's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: measured = true + offset"
    jumps = True
    law = r"y = \theta + b"
    params = (Parameter("offset", "rad", "b", value=1e-3, low=-7.0, high=7.0),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("theta",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
