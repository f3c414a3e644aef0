"""A joint that the model takes as rigid bends under its load."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Signals, Site
from flexjoint.effects._starts import grid

# of the travel, deflections under the load: for the torque of an inertia, squares of the ratio of the
# motion's frequency to the resonance's
SHARES = (3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)
RELAXATION = 2e-3  # s: at a resonance of 10 Hz, a damping ratio of 6 %
# rad: no joint bends so far under the torque (RMS) of its own motor. It is ten times what the series elastic
# joints assumed of the shipped UR5 do at their limit. A link without weight resonates with softer ones.
MOST_BENT = 0.3


class JointCompliance(Effect):
    """A joint that the model takes as rigid bends under its load: its gear, its shaft or its link has a
    stiffness 1/c and a damping T/c.

    The motor goes on to turn as its encoder reads, and the link follows on the spring. A joint that has a
    stiffness already is made softer by `spring_stiffness`."""

    site, against, reference = Site.BODY, "tau_t", "Spong 1987 (elastic joint)"
    law = r"c\,\tau_t = \phi + T\,\dot\phi"
    params = (
        Parameter("compliance", "rad/(N m)", "c", value=1e-4, low=0.0, high=10.0),
        Parameter("relaxation", "s", "T", value=2e-3, low=0.0, high=1.0),
    )
    for_rigid = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        if isinstance(p.compliance, float) and p.compliance == 0.0:
            return drive
        K = 1.0 / (1.0 / drive.K + p.compliance)
        return replace(drive, K=K, D=drive.D + p.relaxation * K)

    def largest(self, s: Signals) -> Mapping[str, float]:
        return {"compliance": MOST_BENT / max(float(np.sqrt(np.mean(np.square(s.tau_m)))), 1e-9)}

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        softest = float(np.ptp(s.q)) / max(float(np.ptp(s.tau_t)), 1e-9)
        most = self.largest(s)["compliance"]
        compliances = [min(share * softest, most) for share in SHARES]
        return grid(self.params, compliance=compliances, relaxation=[RELAXATION])
