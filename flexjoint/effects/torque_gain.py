"""The motor gives more or less torque than is commanded."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site


class TorqueGain(Effect):
    """The motor gives more or less torque than is commanded: its torque constant or gear ratio is off."""

    site, kind, against, reference = Site.COMMAND, Kind.PARAMETER, "tau_m", "Gautier and Briot 2014"
    law = r"\tau = (1 + e)\,\tau_m"
    params = (Parameter("gain", "1", "e", value=0.05, low=-3.0, high=1e3),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return (1.0 + p.gain) * x
