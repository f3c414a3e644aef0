"""The torque sensor's scale is off."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Typical
from flexjoint.effects._sources import TORQUE_FLANGE


class TorqueSensorGain(Effect):
    """The torque sensor's scale is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "tau_t", "formats: (1 + gain) tau_t + offset"
    typical = (Typical("up to 0.1 % for 10 K", TORQUE_FLANGE),)
    law = r"y = (1 + e)\,\tau_t"
    # by a factor of five, as of a wrong calibration; a wrong sign or unit is an error of the data
    params = (Parameter("gain", "1", "e", value=0.05, low=-0.8, high=4.0),)

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("tau_t",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return (1.0 + p.gain) * x
