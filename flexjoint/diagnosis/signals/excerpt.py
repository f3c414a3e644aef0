"""The part of a recording that is examined, where the whole is too large for a search.

Time and memory grow with samples times joints, and of many joints faster. So of a large recording fewer
samples a second are taken, as long as the balances' filter smooths away what lies between them, and then the
stretch in which most moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnosis.data.torques.lag import advanced, torque_lag
from flexjoint.recording.clock import without_pauses
from flexjoint.recording.readings.channels import inspected
from flexjoint.recording.table import Recording, was_measured
from flexjoint.robot.robot import Robot

LARGEST = 240_000  # samples times joints: 1.8 gigabytes with two workers, and some minutes ...
MANY = 7  # ... for so many joints; of more, the tolerances of each on the samples of all count
ENOUGH = 500.0  # Hz, at which the filter is as narrow as it ever is
WHOLE = 0.9  # of a channel's share of samples: below it every k-th row misses a channel of a rate of its own
SEEN = 0.05  # s, over which a joint's speed is averaged
PLACES = 50  # at which a stretch may begin
SECONDS = 7e-4  # of processor time for each sample of a joint: of 43 machines with few joints 3e-4 to 4e-3;
FEW = 3  # joints; of six (KR300, TX40, a UR10) it is 3e-3 to 1.2e-2, as each joint has causes of its own
LEAST = 8_000  # samples times joints that are looked at, however little time is allowed


def _seconds_each(robot: Robot) -> float:
    """[s] of processor time for each sample of a joint; of more joints than were tried as of the most."""
    return SECONDS * (1.0 + (min(len(robot.joints), MANY) / FEW) ** 3)


def expected_seconds(robot: Robot, recordings: Sequence[Recording], workers: int) -> float:
    """About how long a diagnosis takes, by what it will look at: within a factor of three as a rule, of six
    in what was tried."""
    size = sum(recording.time.size for recording in recordings) * len(robot.joints)
    return _seconds_each(robot) * min(size, most_samples(robot)) / workers


def most_samples(robot: Robot, seconds: float = math.inf, largest: int | None = None) -> int:
    """Samples times joints that a search can take, in a time [s] on one processor."""
    joints = len(robot.joints)
    largest = LARGEST if largest is None else largest
    return int(min(largest / max(1.0, joints / MANY), max(LEAST, seconds / _seconds_each(robot))))


def excerpts(
    robot: Robot,
    recordings: Sequence[Recording],
    seconds: float = math.inf,
    largest: int | None = None,
    work: str = "one search",
) -> tuple[list[Recording], tuple[str, ...]]:
    """The recordings as they are examined, and notes about what was repaired, left out or cut. Together they
    are no larger than the work can take (`largest` samples times joints, LARGEST by default), and than a
    search takes in the `seconds` that are allowed for it.

    Raises RecordingError for one that no diagnosis can use (`flexjoint.recording.readings.channels`)."""
    recordings = [_repaired(robot, recording) for recording in recordings]
    repairs = tuple(f"{recording.name}: {note}" for recording in recordings for note in recording.notes)
    joints = len(robot.joints)
    most = most_samples(robot, seconds, largest) // joints // len(recordings)
    kept = [_excerpt(robot, recording, most) for recording in recordings]
    search = work if math.isinf(seconds) else f"a search in {seconds:g} s"
    notes = tuple(
        f"{old.name} is too large for {search} ({old.time.size} samples of {joints} joints): only"
        f" {new.time[0]:.4g} to {new.time[-1]:.4g} s were examined, at {1.0 / new.period:.4g} Hz; to examine"
        " another part, cut the file to it"
        for old, new in zip(recordings, kept, strict=True)
        if new is not old
    )
    return kept, (*repairs, *notes)


def _repaired(robot: Robot, recording: Recording) -> Recording:
    """The recording without pauses, without what is no measurement, and with the torques that act where their
    readings are filtered; notes say what was done."""
    recording = inspected(robot, without_pauses(recording))
    lag = torque_lag(robot, recording)
    if lag is None:
        return recording
    moved = advanced(recording, lag)
    return replace(moved, notes=(*moved.notes, str(lag)))


def _excerpt(robot: Robot, recording: Recording, most: int) -> Recording:
    if recording.time.size <= most:
        return recording
    stride = min(int(1.0 / (recording.period * ENOUGH) + 1e-6), -(-recording.time.size // most))
    thin = _every(recording, stride) if stride > 1 else recording
    return thin if thin.time.size <= most else _busiest(robot, thin, most)


def _every(recording: Recording, stride: int) -> Recording:
    """One sample of each `stride`; the recording itself where a channel has its samples in other rows."""
    columns = {key: values[::stride].copy() for key, values in recording.columns.items()}
    for key, values in columns.items():
        if np.mean(np.isfinite(values)) < WHOLE * np.mean(np.isfinite(recording.columns[key])):
            return recording
    return replace(recording, time=recording.time[::stride].copy(), columns=columns)


def _busiest(robot: Robot, recording: Recording, most: int) -> Recording:
    """The stretch of `most` samples in which the joints' squared speeds, each over its own mean, add up to
    most; the first of several equal ones."""
    starts = np.unique(np.linspace(0, recording.time.size - most, PLACES).astype(int))
    moved = np.zeros(starts.size)
    for joint in robot.joint_names:
        channel = next((c for c in ("q", "theta") if recording.has(c, joint)), None)
        if channel is not None:
            done = _travelled(recording, recording.get(channel, joint))
            moved += np.round(done[starts + most - 1] - done[starts], 3)
    start = starts[int(np.argmax(moved))]
    # copies, so that the rest of a large recording need not stay in memory
    columns = {key: values[start : start + most].copy() for key, values in recording.columns.items()}
    there = {key: values for key, values in columns.items() if was_measured(values)}
    return replace(recording, time=recording.time[start : start + most].copy(), columns=there)


def _travelled(recording: Recording, position: np.ndarray) -> np.ndarray:
    """(N,) share of the sum of squared speeds that a joint has by then."""
    present = np.isfinite(position)
    ticks = np.arange(recording.time[0], recording.time[-1] + SEEN, SEEN)
    steps = np.diff(np.interp(ticks, recording.time[present], position[present]))
    total = np.concatenate([[0.0], np.cumsum(steps**2)])
    return np.asarray(np.interp(recording.time, ticks, total / max(float(total[-1]), 1e-300)))
