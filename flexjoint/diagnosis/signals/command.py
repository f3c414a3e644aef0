"""Which torque drove a joint: the recorded command, the measured torque, or what the controller made of
its readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint, Robot


@dataclass(frozen=True)
class Source:
    """Motor torque at the recording's samples (N,), NaN where missing; `held` for 1/f_c or a sample."""

    values: np.ndarray
    held: bool
    origin: str  # tau_m | tau_motor | controller
    feedback: float = 0.0  # N m/rad, with which it was made of theta, where it holds that reading's noise


def torque_source(robot: Robot, recording: Recording, joint: Joint) -> Source | None:
    """The best source of a joint's motor torque, or None when nothing tells it."""
    if recording.has("tau_m", joint.name):
        return Source(recording.get("tau_m", joint.name), True, "tau_m", joint.kp)
    if recording.has("tau_motor", joint.name):
        return Source(recording.get("tau_motor", joint.name), False, "tau_motor")
    return _from_controller(recording, joint)


def _from_controller(recording: Recording, joint: Joint) -> Source | None:
    """The default control law on the recorded readings, which are the controller's own
    (docs/reference/formats.md)."""
    if joint.kp <= 0.0 or not recording.has("theta", joint.name):
        return None
    if not (recording.has("theta_ref", joint.name) and recording.has("tau_ff", joint.name)):
        return None
    theta = recording.get("theta", joint.name)
    if recording.has("dtheta", joint.name):
        speed = recording.get("dtheta", joint.name)
    elif joint.kd == 0.0:
        speed = np.zeros_like(theta)
    else:
        return None
    wanted = np.zeros_like(theta)
    if recording.has("dtheta_ref", joint.name):
        wanted = recording.get("dtheta_ref", joint.name)
    torque = (
        recording.get("tau_ff", joint.name)
        + joint.kp * (recording.get("theta_ref", joint.name) - theta)
        + joint.kd * (wanted - speed)
    )
    return Source(np.clip(torque, -joint.torque_limit, joint.torque_limit), True, "controller", joint.kp)
