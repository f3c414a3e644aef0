"""Angles that a log wraps to one turn, continuous again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

ANGLES = ("q", "theta", "q_ref", "theta_ref")
TURN = 2.0 * np.pi  # rad
SUCCESSIVE = 4.5  # sampling periods: what changed over a longer gap is not known
USUAL = 2.0  # times the largest other step, that one is at most once its whole turns are taken away, and ...
FASTEST = 0.125  # ... of a turn, that no other step exceeds: of faster ones, or of degrees, nothing is known


def unwrapped(robot: Robot, recording: Recording) -> Recording:
    """The recording with continuous angles where a log wraps them to one turn, and a note for each; itself
    where it wraps none. Jumps that are no whole turns are left as they are."""
    columns, notes = dict(recording.columns), []
    for channel, joint in recording.columns:
        if channel not in ANGLES or joint not in robot.joint_names or joint in robot.prismatic:
            continue
        values = recording.columns[channel, joint]
        rows = np.flatnonzero(np.isfinite(values))
        steps, period = np.diff(values[rows]), np.diff(recording.time[rows])
        if not steps.size:
            continue
        near = period <= SUCCESSIVE * np.median(period)
        wraps = near & (np.abs(steps) > 0.5 * TURN)  # half a turn in a sample is no motion
        turns = np.where(wraps, np.round(steps / TURN), 0.0)
        usual = float(np.max(np.abs(steps[near & ~wraps]), initial=0.0))
        if not np.any(wraps) or usual > FASTEST * TURN:
            continue
        if np.any(np.abs(steps - TURN * turns)[wraps] > USUAL * usual):
            continue
        whole = values.copy()
        whole[rows[1:]] -= TURN * np.cumsum(turns)
        columns[channel, joint] = whole
        notes.append(
            f"{channel}.{joint} jumps by whole turns {np.count_nonzero(wraps)} times, from"
            f" {recording.time[rows[1:][wraps][0]]:.4g} s on: a log that wraps it to one turn; taken as"
            " continuous"
        )
    return replace(recording, columns=columns, notes=(*recording.notes, *notes)) if notes else recording
