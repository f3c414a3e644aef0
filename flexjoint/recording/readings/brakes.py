"""Spans in which a robot's motors are off: brakes hold it, and its motors' torques say nothing of its load.

Logs often begin before the drives are switched on, and end after. A joint then stands still without a torque
at a pose at which gravity pulls at it, as if a friction held it that no motion shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from flexjoint.recording.noise import step_of, white_noise
from flexjoint.recording.table import Recording
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.robot.robot import Robot

OFF = 0.02  # of a motor's RMS torque, beside three deviations of its noise, up to which it gives none
AROUND = 5  # samples, whose median it is: a single one may be off by more
SECONDS = 0.2  # at least: a torque passes through zero faster
SWITCHED = 0.3  # s beside it while the robot still stands: brakes close before motors go off, and open after
STILL = 10.0  # steps of an encoder, or deviations of its noise, by which a joint that is held may move
LOADED = 0.05  # of a motor's RMS torque, that gravity at least makes of its joint's load there
TORQUES = ("tau_m", "tau_motor")


@dataclass(frozen=True)
class Held:
    """Rows begin to end, the last one included, in which motors are off and brakes stop or hold a robot, and
    the load [N m] by gravity of the joint that is loaded most for its motor."""

    begin: int
    end: int
    joint: str
    load: float


def without_brakes(robot: Robot, recording: Recording) -> Recording:
    """The recording with empty cells for the motors' torques while brakes hold the robot, and a note about
    that; the recording itself where none do."""
    held, time = held_by_brakes(robot, recording), recording.time
    if not held:
        return recording
    columns = dict(recording.columns)
    for key in [key for key in columns if key[0] in TORQUES]:
        columns[key] = columns[key].copy()
        for span in held:
            columns[key][span.begin : span.end + 1] = np.nan
    longest = max(held, key=lambda span: time[span.end] - time[span.begin])
    more = f", and in {len(held) - 1} more spans" if len(held) > 1 else ""
    note = (
        f"all motors are without torque from {time[longest.begin]:.4g} to {time[longest.end]:.4g} s{more}"
        f" while the robot stands still and {abs(longest.load):.3g} N m pull at {longest.joint}: held by its"
        " brakes; torques there are not used"
    )
    return replace(recording, columns=columns, notes=(*recording.notes, note))


def held_by_brakes(robot: Robot, recording: Recording) -> list[Held]:
    """Where all motors whose torque is recorded give none and, at the begin or the end of that, no joint
    moves while gravity pulls at one of them by a twentieth of its motor's usual torque or more. None for a
    floating base, of unrecorded pose."""
    time, columns = recording.time, recording.columns
    torques = {
        joint: columns[channel, joint]
        for joint in robot.joint_names
        for channel in TORQUES  # a measured one rather than a command, which may go on
        if (channel, joint) in columns and np.any(np.isfinite(columns[channel, joint]))
    }
    angles = {
        joint: columns[channel, joint]
        for joint in robot.joint_names
        for channel in ("theta", "q")
        if (channel, joint) in columns and np.any(np.isfinite(columns[channel, joint]))
    }
    if robot.floating or not torques or set(angles) != set(robot.joint_names):
        return []
    usual = {joint: float(np.sqrt(np.nanmean(x**2))) for joint, x in torques.items()}
    none = {joint: OFF * usual[joint] + 3.0 * white_noise(x) for joint, x in torques.items()}
    off = np.all([~(np.abs(x) > none[joint]) for joint, x in torques.items()], axis=0)
    if np.count_nonzero(off) * recording.period < 0.5 * SECONDS:
        return []
    off[:] = True
    for joint, x in torques.items():
        # an empty cell is no torque either
        off &= np.abs(median_filter(np.nan_to_num(x), AROUND)) <= none[joint]
    slack = {joint: STILL * max(white_noise(x), step_of(x[np.isfinite(x)])) for joint, x in angles.items()}

    def stays(at: int, until: int) -> np.ndarray:
        """Whether all joints are where they are at a row, in each row from there to another, up to the first
        one in which they are not."""
        step = 1 if until >= at else -1
        rows = np.arange(at, until + step, step)
        apart = [np.abs(x[rows] - x[at]) > slack[joint] for joint, x in angles.items()]
        return np.logical_and.accumulate(~np.any(apart, axis=0))

    out = []
    for first, last in _spans(off):
        still = stays(first, last) | stays(last, first)[::-1]
        held = [_loaded(robot, time, torques, angles, usual, first + a, first + b) for a, b in _spans(still)]
        joint, load = max(filter(None, held), key=lambda one: abs(one[1]), default=("", 0.0))
        if joint:
            before, behind = np.searchsorted(time, (time[first] - SWITCHED, time[last] + SWITCHED))
            begin = first + 1 - int(np.count_nonzero(stays(first, int(before))))
            end = last - 1 + int(np.count_nonzero(stays(last, min(int(behind), time.size - 1))))
            out.append(Held(begin, end, joint, load))
    return out


def _loaded(
    robot: Robot,
    time: np.ndarray,
    torques: Mapping[str, np.ndarray],
    angles: Mapping[str, np.ndarray],
    usual: Mapping[str, float],
    begin: int,
    end: int,
) -> tuple[str, float] | None:
    """The joint that gravity loads most for its motor at the pose of some rows, and its load [N m]; None
    where they are too few, or none is loaded."""
    known = all(np.any(np.isfinite(x[begin : end + 1])) for x in (*torques.values(), *angles.values()))
    if time[end] - time[begin] < SECONDS or not known:
        return None
    loads = _gravity(robot, {j: float(np.nanmean(x[begin : end + 1])) for j, x in angles.items()})
    joint = max(torques, key=lambda j: abs(loads[j]) / max(usual[j], 1e-300))
    return (joint, loads[joint]) if abs(loads[joint]) > LOADED * usual[joint] else None


def _spans(where: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each span in which `where` (N,) holds."""
    edges = np.diff(np.concatenate([[False], where, [False]]).astype(int))
    return list(
        zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True)
    )


def _gravity(robot: Robot, angles: Mapping[str, float]) -> dict[str, float]:
    """[N m] by which gravity pulls at each joint at a pose."""
    body = PinBody(robot.model)
    pose = body.neutral.copy()
    for joint in robot.joints:
        pose[joint.idx_q] = angles[joint.name]
    torque = body.gravity_torque(pose)
    return {joint.name: float(torque[joint.idx_v]) for joint in robot.joints}
