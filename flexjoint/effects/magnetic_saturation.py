"""The motor's iron saturates: its torque grows less than its current."""

from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects._starts import grid

KNEES = (0.7, 1.5, 3.0)  # times the largest torque: from half of it lost to a twentieth


class MagneticSaturation(Effect):
    """The motor's iron saturates: torque grows less than the current from which it was computed. At a torque
    of 1/saturation 71 % of it is left, at a fifth of that 98 %."""

    site, against = Site.COMMAND, "tau_m"
    reference = "Krishnan 2010, Permanent Magnet Synchronous and Brushless DC Motor Drives (saturation)"
    law = r"\tau = \tau_m / \sqrt{1 + (c\,\tau_m)^2}"
    params = (Parameter("saturation", "1/(N m)", "c", value=0.01, low=0.0, high=1e3),)

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return x / ops.sqrt(1.0 + (p.saturation * x) ** 2)

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        largest = max(float(np.max(np.abs(s.tau_m))), 1e-3)
        return grid(self.params, saturation=(1.0 / (knee * largest) for knee in KNEES))
