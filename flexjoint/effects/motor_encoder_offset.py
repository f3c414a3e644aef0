"""The motor encoder's zero is off."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical


class MotorEncoderOffset(Effect):
    """The motor encoder's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: measured = true + offset"
    law = r"y = \theta + b"
    params = (Parameter("offset", "rad", "b", value=1e-3, low=-7.0, high=7.0),)
    typical = (
        Typical(
            "about 10 deg (0.17 rad) at joints 4 and 5 of an AR4, after its homing",
            Source(
                "AR4 driver, issue 3, a user's arm", "https://github.com/ycheng517/ar4_ros_driver/issues/3"
            ),
        ),
    )

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("theta",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
