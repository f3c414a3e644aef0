"""The torque sensor's zero is off."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Typical
from flexjoint.effects._sources import TORQUE_FLANGE


class TorqueSensorOffset(Effect):
    """The torque sensor's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: (1 + gain) tau_t + offset"
    typical = (Typical("up to 0.05 % of the nominal torque for 10 K", TORQUE_FLANGE),)
    law = r"y = \tau_t + b"
    params = (Parameter("offset", "N m", "b", value=0.1, low=-1e5, high=1e5),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("tau_t",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
