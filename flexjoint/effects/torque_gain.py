"""The motor gives more or less torque than it was told."""

from typing import Any

from flexjoint.effect import Effect, Kind, Param, Signals, Site
from flexjoint.ops import Value


class TorqueGain(Effect):
    """The motor gives more or less torque than it was told: its torque constant or gear ratio is off."""

    site, kind, against, reference = Site.COMMAND, Kind.PARAMETER, "tau_m", "Gautier and Briot 2014"
    law = r"\tau = (1 + e)\,\tau_m"
    params = (Param("gain", "1", "e", 0.05, -3.0, 1e3),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return (1.0 + p.gain) * x
