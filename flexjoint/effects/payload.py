"""A mass that the nominal model does not know."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Site, Source, Typical


class Payload(Effect):
    """A point mass fixed to a link, at a position in the joint's link frame."""

    site, against, reference = Site.BODY, "q", "Khalil and Dombre 2002, section 9.2 (inertial parameters)"
    comes_and_goes = True  # picked and placed
    law = r"\Delta\pi = m\,(1, r, -[r]_\times^2)"
    params = (
        Parameter("mass", "kg", "m", value=0.1, low=-1e3, high=1e4),
        Parameter("position", "m", "r", value=0.0, low=-20.0, high=20.0, null=None, size=3),
    )
    typical = (
        Typical(
            "at most 1.1 kg at full reach and 4 kg at mid-range, held for long",
            Source(
                "Kinova, user guide of the Gen3, page 16",
                "https://manualshive.com/en/manual/kinova/gen3/1971410?page=16",
            ),
        ),
    )

    def edit_inertial(self, inertial: Any, p: Any) -> Any:
        m, (x, y, z) = p.mass, p.position
        added = (
            m,
            m * x,
            m * y,
            m * z,
            m * (y * y + z * z),
            -m * x * y,
            m * (x * x + z * z),
            -m * x * z,
            -m * y * z,
            m * (x * x + y * y),
        )
        return [have + more for have, more in zip(inertial, added, strict=True)]
