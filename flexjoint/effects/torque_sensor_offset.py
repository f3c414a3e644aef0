"""The torque sensor's zero is off."""

from typing import Any

from flexjoint.effect import Effect, Kind, Param, Signals, Site
from flexjoint.ops import Value


class TorqueSensorOffset(Effect):
    """The torque sensor's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: (1 + gain) tau_t + offset"
    law = r"y = \tau_t + b"
    params = (Param("offset", "N m", "b", 0.1, -1e5, 1e5),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("tau_t",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
