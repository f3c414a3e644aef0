"""The base does not stand level."""

from typing import Any

from flexjoint.core import ops
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Kind, Site, Source, Typical


class BaseTilt(Effect):
    """The base does not stand level: gravity seen in the base is turned."""

    site, kind, against, reference = Site.BODY, Kind.MECHANICAL, "q", "Craig 2005, section 2.8 (roll, pitch)"
    law = r"g' = (R_x(\alpha) R_y(\beta))^T g"
    params = (
        Parameter("roll", "rad", r"\alpha", value=0.0, low=-3.2, high=3.2),
        Parameter("pitch", "rad", r"\beta", value=0.0, low=-3.2, high=3.2),
    )
    whole_robot = True
    typical = (
        Typical(
            "at most 0.5 mm/m (0.5 mrad) along and 0.1 mm/m across, under a robot's track",
            Source(
                "ABB, manual of the track IRBT 4003S, page 35",
                "https://www.easymanua.ls/abb/irbt-4003s/manual?p=35",
            ),
        ),
    )

    def edit_gravity(self, gravity: Any, p: Any) -> Any:
        gx, gy, gz = gravity
        ca, sa, cb, sb = ops.cos(p.roll), ops.sin(p.roll), ops.cos(p.pitch), ops.sin(p.pitch)
        # first Rx(roll)^T g, then Ry(pitch)^T of that
        hx, hy, hz = gx, ca * gy + sa * gz, -sa * gy + ca * gz
        return [cb * hx - sb * hz, hy, sb * hx + cb * hz]
