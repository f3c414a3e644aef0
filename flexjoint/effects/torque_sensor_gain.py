"""The torque sensor's scale is off."""

from typing import Any

from flexjoint.effect import Effect, Kind, Param, Signals, Site
from flexjoint.ops import Value


class TorqueSensorGain(Effect):
    """The torque sensor's scale is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "tau_t", "formats: (1 + gain) tau_t + offset"
    law = r"y = (1 + e)\,\tau_t"
    params = (Param("gain", "1", "e", 0.05, -3.0, 1e3),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("tau_t",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return (1.0 + p.gain) * x
