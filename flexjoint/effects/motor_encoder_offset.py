"""The motor encoder's zero is off."""

from typing import Any

from flexjoint.effect import Effect, Kind, Param, Signals, Site
from flexjoint.ops import Value


class MotorEncoderOffset(Effect):
    """The motor encoder's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: measured = true + offset"
    law = r"y = \theta + b"
    params = (Param("offset", "rad", "b", 1e-3, -7.0, 7.0),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("theta",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
