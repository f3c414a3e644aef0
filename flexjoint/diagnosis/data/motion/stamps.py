"""Time stamps of arrival: rows that were sampled on an even clock and got the time at which they came."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexjoint.diagnosis.result.values import DataFinding
from flexjoint.diagnosis.settings import DataSettings
from flexjoint.recording.clock import JITTER, taken_at
from flexjoint.recording.table import Recording

STRETCHES = 20  # of a recording: in each some row came without delay
LEAST = 25  # rows of a stretch
SAME_RATE = 1e-3  # relative difference, within which a rate is a whole number of Hz
ROUNDS = 3  # of finding them, each with the period that the last ones show


def of_arrival(recording: Recording, settings: DataSettings) -> Iterator[DataFinding]:
    """Stamps that scatter by more than jitter about an even clock on which the positions are smooth.

    No row is missing: the least delay of each stretch is that of all, within a period. A smaller scatter is
    repaired without asking (`flexjoint.recording.clock`)."""
    time, number = recording.time, np.arange(recording.time.size)
    if time.size < STRETCHES * LEAST:
        return
    period = _of_least_late(time, number)
    late = time - period * number
    late = late - np.min(late)
    least = [float(np.min(part)) for part in np.array_split(late, STRETCHES)]
    scattered = np.abs(late - np.median(late)) > JITTER * period
    if np.mean(scattered) <= settings.late_rows or max(least) > period:
        return
    if not taken_at(recording, time - late):
        return
    whole = round(1.0 / period)  # as loggers run; delays leave the rate open by about as much
    rate = whole if abs(period * whole - 1.0) < SAME_RATE else float(f"{1.0 / period:.4g}")
    text = (
        f"the time stamps are those of arrival, up to {1e3 * np.max(late):.3g} ms late: the positions were"
        f" taken on an even clock of {rate:g} Hz"
    )
    yield DataFinding(
        "stamps_of_arrival",
        None,
        text,
        robot_file=f"log when each sample was taken; or a mapping map.yaml of one line, rate: {rate:g}",
        recording=recording.name,
        command=f"flexjoint import {recording.name} --mapping map.yaml --to even.parquet",
    )


def _of_least_late(time: np.ndarray, number: np.ndarray) -> float:
    """Period of the even clock through the least delayed row of each stretch [s]."""
    period = float(time[-1] - time[0]) / (time.size - 1)
    for _ in range(ROUNDS):
        late = time - period * number
        rows = [int(part[np.argmin(late[part])]) for part in np.array_split(number, STRETCHES)]
        period = float(np.polyfit(number[rows], time[rows] - time[0], 1)[0])
    return period
