"""Whether a recording's balances can carry a verdict at all."""

from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.balances.balances import Balances


def refusal(balances: Balances) -> str:
    """Why the data cannot carry a verdict; empty when they can."""
    limits = balances.settings.balances
    motion = balances.motion
    used = motion.readings.valid
    seconds = float(np.sum(used)) * motion.readings.period
    if seconds < limits.shortest:
        return (
            f"only {seconds:.2g} s of usable data beside gaps and edges;"
            f" record at least {limits.shortest:g} s"
        )
    if not balances.rows:
        return (
            "no torque balance can be closed: neither motor torques nor both encoders of a joint are recorded"
        )
    travel = np.ptp(motion.theta[:, used], axis=1)
    noise = np.maximum(motion.readings.noise["theta"], motion.readings.noise["q"])
    if np.all(travel < limits.still * np.maximum(noise, 1e-9)):
        return "the robot hardly moves in this recording; record a motion that uses its speed and load"
    return ""
