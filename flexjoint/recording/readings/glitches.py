"""Single readings that failed: a few samples far from those on either side, which are as smooth as ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.recording.noise import step_of, usual_noise
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

POSITIONS = ("q", "theta")
TORQUES = ("tau_t", "tau_motor")  # of which a value of exactly 0 is no torque, but no answer
LONGEST = 3  # samples in a row: of more, a motion may be the reason
FAR = 30.0  # deviations of the noise, or steps, from where the samples beside it lead, at least
NEGLIGIBLE = 1e-5  # of a channel's range, for its noise where it has none
SMOOTH = 0.1  # of that, at most, that they are off themselves: a body that is hit moves on otherwise
MOST = 0.02  # share of the samples, beyond which these are no single readings
BESIDE = 2  # samples on either side, whose cubic polynomial leads across


def without_glitches(robot: Robot, recording: Recording) -> Recording:
    """The recording with empty cells where single readings failed, and a note for each channel; itself where
    none did."""
    columns, notes = dict(recording.columns), []
    for (channel, joint), values in recording.columns.items():
        if joint not in robot.joint_names or channel not in (*POSITIONS, *TORQUES):
            continue
        rows = np.flatnonzero(np.isfinite(values))
        failed, off = _failed(values[rows], exactly_zero=channel in TORQUES)
        if not failed.size or failed.size > MOST * rows.size:
            continue
        columns[channel, joint] = values.copy()
        columns[channel, joint][rows[failed]] = np.nan
        first = recording.time[rows[failed[0]]]
        notes.append(
            f"{channel}.{joint} is off by up to {off:.3g} in {failed.size} samples, the first at {first:.4g}"
            " s, and not beside them: readings that failed; these samples are not used"
        )
    return replace(recording, columns=columns, notes=(*recording.notes, *notes)) if notes else recording


def _failed(x: np.ndarray, exactly_zero: bool) -> tuple[np.ndarray, float]:
    """Indices of the samples (N,) that failed, of those that are 0 if `exactly_zero`, and by how much one is
    off at most."""
    if x.size < 4 * BESIDE + LONGEST:
        return np.zeros(0, dtype=int), 0.0
    least = FAR * max(usual_noise(x), step_of(x), NEGLIGIBLE * float(np.ptp(x)))
    suspect = np.abs(_beside(x)) > least
    if exactly_zero:
        suspect &= x[BESIDE:-BESIDE] == 0.0
    found: list[int] = []
    largest = 0.0
    # a sample that is off makes those beside it seem so, by two thirds at most
    for at in (np.flatnonzero(suspect) + BESIDE).tolist():
        if found and at <= found[-1]:
            continue
        for length in range(1, LONGEST + 1):
            inside = np.arange(at, at + length)
            outside = np.concatenate([np.arange(at - BESIDE, at), inside[-1] + 1 + np.arange(BESIDE)])
            if outside[0] < 0 or outside[-1] >= x.size or (exactly_zero and np.any(x[inside] != 0.0)):
                continue
            path = np.polynomial.Polynomial.fit(outside, x[outside], 3)
            apart = np.abs(x[inside] - path(inside))
            first = max(0, at - 2 * BESIDE)
            around = x[first : inside[-1] + 1 + 2 * BESIDE].copy()
            around[inside - first] = path(inside)
            rough = float(np.max(np.abs(_beside(around))))
            if np.min(apart) > least and rough < SMOOTH * np.min(apart):
                found += inside.tolist()
                largest = max(largest, float(np.max(apart)))
                break
    return np.array(found, dtype=int), largest


def _beside(x: np.ndarray) -> np.ndarray:
    """(N - 4,) by how much each sample is off the cubic polynomial through two on either side."""
    return x[2:-2] - (4.0 * (x[1:-3] + x[3:-1]) - x[:-4] - x[4:]) / 6.0
