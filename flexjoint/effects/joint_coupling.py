"""The drive of a neighbouring joint acts on this one too."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Source, Typical, Word


class JointCoupling(Effect):
    """A share of what the joint before or after it is commanded acts on this joint's motor too.

    So do a differential, tendons or belts whose drives are not decoupled as the model says, and a drive that
    picks up its neighbour's signal. Before and after are in the robot's order of joints.
    """

    site, against, reference = (
        Site.COMMAND,
        "tau_m_before",
        "Siciliano et al. 2009, section 5.1 (transmissions)",
    )
    law = r"\tau = \tau_m + c\,\tau_{m,\,\mathrm{neighbour}}"
    params = (Parameter("share", "1", "c", value=0.05, low=-20.0, high=20.0),)
    words = (Word("side", ("before", "after"), "before"),)
    typical = (
        Typical(
            "a share of -0.46: a wrist's pitch motor turns yaw by so much of the pitch",
            Source(
                "da Vinci Research Kit, the instrument 400194",
                "https://github.com/jhu-dvrk/sawIntuitiveResearchKit/blob/"
                "bc6851fb79bc74ce6b62497a9c3c592e239b54f3/core/share/tool/MEGA_NEEDLE_DRIVER_400194.json",
            ),
        ),
        Typical(
            "a share of -0.82, likewise",
            Source(
                "da Vinci Research Kit, the instrument 400006",
                "https://github.com/jhu-dvrk/sawIntuitiveResearchKit/blob/"
                "00bb61b8d489925324c20bf9fd29344375e74275/share/tool/LARGE_NEEDLE_DRIVER_400006.json",
            ),
        ),
    )

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x + p.share * (s.tau_m_before if p.side == "before" else s.tau_m_after)
