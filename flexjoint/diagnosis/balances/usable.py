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
            + _of_sensors(balances)
        )
    travel = np.ptp(motion.theta[:, used], axis=1)
    noise = np.maximum(motion.readings.noise["theta"], motion.readings.noise["q"])
    if np.all(travel < limits.still * np.maximum(noise, 1e-9)):
        return "the robot hardly moves in this recording; record a motion that uses its speed and load"
    return ""


def _of_sensors(balances: Balances) -> str:
    """What to do about torque sensors of joints that are said to be rigid; empty where there are none."""
    motion = balances.motion
    sensed = [
        joint.name
        for joint, tau_t in zip(motion.robot.joints, motion.readings.tau_t, strict=True)
        if joint.rigid and np.isfinite(tau_t[0])
    ]
    if not sensed:
        return ""
    return (
        f"; tau_t of {sensed[0]} is a torque sensor's, which lies in a spring: give the joint its stiffness"
        " in the robot file (its rough size, such as 1e4, will do where theta is not recorded), or name the"
        " column tau_motor if the torque is the motor's"
    )
