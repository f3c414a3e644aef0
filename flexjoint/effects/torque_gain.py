"""The motor gives more or less torque than is commanded."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical
from flexjoint.effects._sources import HIWIN


class TorqueGain(Effect):
    """The motor gives more or less torque than is commanded: its torque constant or gear ratio is off."""

    site, kind, against, reference = Site.COMMAND, Kind.PARAMETER, "tau_m", "Gautier and Briot 2014"
    common = True  # of motors of one type
    law = r"\tau = (1 + e)\,\tau_m"
    # by a factor of five: torque constants differ by a tenth, a gear ratio or a current of another definition
    # (amplitude, effective value) by more; a wrong sign or unit is an error of the data
    params = (Parameter("gain", "1", "e", value=0.05, low=-0.8, high=4.0),)
    typical = (
        Typical(
            "up to 10 %, the tolerance of a motor's data, torque constant included",
            Source(
                "Beckhoff, technical data of the AM8100 motors",
                "https://infosys.beckhoff.com/content/1033/am8100/1333724939.html",
            ),
        ),
        Typical("up to 10 %, the tolerance of all data of a torque motor", HIWIN),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return (1.0 + p.gain) * x
