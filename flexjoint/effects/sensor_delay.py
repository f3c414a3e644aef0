"""A reading that arrives late."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import SENSOR_CHANNELS, Effect, Kind, Signals, Site, Source, Typical, Word
from flexjoint.effects._starts import grid


class SensorDelay(Effect):
    """A reading that arrives late; channel q takes dq along, theta takes dtheta, null means all."""

    site, kind, against, reference = Site.SENSOR, Kind.TIMING, "t", "Franklin, Powell and Workman 1998"
    law = r"y(t) = x(t - T)"
    params = (Parameter("delay", "s", "T", value=2e-3, low=0.0, high=0.05),)
    common = True
    words = (Word("channel", (None, "q", "theta", "tau_t"), None),)
    max_delay = 0.05
    typical = (
        Typical(
            "4 to 6 ms there and back: a command sent to a UR10e and returned with its data",
            Source(
                "Universal Robots Client Library, issue 86, a user's measurement",
                "https://github.com/UniversalRobots/Universal_Robots_Client_Library/issues/86",
            ),
        ),
    )

    def channels(self, p: Any) -> tuple[str, ...]:
        if p.channel is None:
            return SENSOR_CHANNELS
        return {"q": ("q", "dq"), "theta": ("theta", "dtheta"), "tau_t": ("tau_t",)}[p.channel]

    def delay(self, p: Any) -> Value:
        return p.delay

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        return grid(self.params, delay=(1e-3, 3e-3, 8e-3, 0.02, 0.04))
