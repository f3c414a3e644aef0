"""The link encoder's zero is off."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Signals, Site, Source, Typical


class LinkEncoderOffset(Effect):
    """The link encoder's zero is off."""

    site, kind, against, reference = Site.SENSOR, Kind.SENSOR, "t", "formats: measured = true + offset"
    jumps = True
    law = r"y = q + b"
    params = (Parameter("offset", "rad", "b", value=1e-3, low=-7.0, high=7.0),)
    typical = (
        Typical(
            "0.4 to 46 mrad at joints 1 to 7 of a TIAGo's arm, found by its calibration",
            Source(
                "FIGAROH, calibration of a TIAGo",
                "https://github.com/thanhndv212/figaroh-plus/blob/927e7b1e4f83659152b6d9ece80516e42102f713/"
                "examples/tiago/data/calibration_parameters/tiago_master_calibration.yaml",
            ),
        ),
        Typical(
            "about 1 deg (17 mrad) at an iCub's arm, found by its calibration",
            Source(
                "iCub, configuration, pull request 42",
                "https://github.com/robotology/robots-configuration/pull/42",
            ),
        ),
    )

    def channels(self, p: Any) -> tuple[str, ...]:
        return ("q",)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.offset
