"""The clock behind a recording's time stamps.

A pause between two pieces of a recording is shortened to one that separates them, so that no work grows with
the time in which nothing was recorded.

A logger that samples on a regular clock but stamps late leaves jitter in the time column: at 4 rad/s a
tenth of a millisecond looks like 0.4 mrad of noise. Where the samples themselves say so, the regular
clock is used instead of the stamps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.core.limits import RECORDING
from flexjoint.recording.messages import refusal
from flexjoint.recording.stamps import pause_of
from flexjoint.recording.table import Recording

JITTER = 0.35  # largest share of the period by which a stamp may miss its tick
REGULAR = 1e-3  # share of the period up to which a clock counts as regular already
POSITIONS = ("q", "theta")
ENOUGH = 30  # samples whose neighbours are all there, for a verdict
REACH = 10  # samples to either side, over which a speed is taken
MOST_TICKS = RECORDING.ticks_per_row  # of an even clock for each sample
SURE = 3.0  # standard errors by which the samples must say that they were not taken at their stamps


def without_pauses(recording: Recording) -> Recording:
    """The recording with every pause shortened to 1 s, or 10 sampling periods where those are longer.

    By whole sampling periods, so that clocks keep their phase; the recording itself where no pause is longer.
    A note says how much, and that later times count so.

    Raises RecordingError where gaps are so many that an even clock takes more than ten ticks a sample.
    """
    time, period = recording.time, recording.period
    steps = np.diff(time)
    longest = pause_of(period)
    pauses = np.flatnonzero(steps > longest + 1.5 * period)
    if pauses.size:
        cut = np.zeros(time.size)
        cut[pauses + 1] = period * np.floor((steps[pauses] - longest) / period)
        note = (
            f"pauses of {np.sum(steps[pauses]):.4g} s in all ({pauses.size}, the first at"
            f" {time[pauses[0]]:.6g} s) shortened to {longest:g} s each: later times count so"
        )
        shorter = time - np.cumsum(cut)
        recording = replace(recording, time=shorter, notes=(*recording.notes, note))
    ticks = recording.duration / period
    if ticks > MOST_TICKS * time.size:
        raise refusal(
            recording.name,
            f"{time.size} samples, most of them {period:.3g} s apart, lie in {recording.duration:.4g} s with"
            " gaps between nearly all, as stamps of arrival in bursts; log when each sample was taken, import"
            " the log with a mapping that says its rate, or cut it at its pauses",
        )
    return recording


def on_regular_clock(recording: Recording) -> Recording:
    """The recording without its pauses (`without_pauses`), and with jittered stamps put back on their regular
    clock; else the recording unchanged.

    For jitter both must hold: every stamp lies within 0.35 periods of a tick of its own, and the positions
    were taken at the ticks. A moving body's sample that was taken as late as its stamp is off by speed times
    lateness from the smooth line over the ticks: of that the positions must show less than half.
    """
    recording = without_pauses(recording)
    ticks = _ticks(recording.time)
    if ticks is None:
        return recording
    if not taken_at(recording, ticks):
        return recording
    # a stamp can be late but not early: the earliest ones are the clock's
    return replace(recording, time=ticks + float(np.min(recording.time - ticks)))


def taken_at(recording: Recording, ticks: np.ndarray) -> bool:
    """Whether the samples were taken at ticks (N,) [s] rather than at their stamps: the positions show less
    than half of what the lateness of the stamps would make of them. False where they do not tell."""
    late = recording.time - ticks
    shown, weight = 0.0, 0.0
    for (channel, _), values in recording.columns.items():
        if channel in POSITIONS:
            of_channel = _shown(ticks, late, values)
            shown, weight = shown + of_channel[0], weight + of_channel[1]
    return weight > 0.0 and bool(shown / weight + SURE / np.sqrt(weight) <= 0.5)


def _ticks(time: np.ndarray) -> np.ndarray | None:
    """(N,) times of a regular clock near the stamps; None where there is none or it is they."""
    gaps = np.diff(time)
    period = float(np.mean(gaps[gaps < 1.5 * np.median(gaps)]))
    slope, begin, count = period, time[0], np.round((time - time[0]) / period)
    for length in np.unique(np.geomspace(min(100, len(time)), len(time), 10).astype(int)):
        # a period slightly off loses count over the whole length: it is made better on the way
        slope, begin = np.polyfit(count[:length], time[:length], 1)
        count = np.round((time - begin) / slope)
    if np.any(np.diff(count) < 1):
        return None
    ticks = begin + slope * count
    worst = float(np.max(np.abs(time - ticks)))
    return ticks if REGULAR * slope < worst < JITTER * slope else None


def _shown(ticks: np.ndarray, late: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """How much of its lateness a position shows: the sum of share times weight, and the weights; a share's
    variance is one over its weight. By regression of what samples miss the cubic through their two
    neighbours on either side by, on what lateness would make of that."""
    if len(ticks) <= 2 * REACH:
        return 0.0, 0.0
    speed = np.full(len(ticks), np.nan)
    speed[REACH:-REACH] = (values[2 * REACH :] - values[: -2 * REACH]) / (
        ticks[2 * REACH :] - ticks[: -2 * REACH]
    )
    x, y = (np.lib.stride_tricks.sliding_window_view(a, 5) for a in (ticks, values))
    expected = np.lib.stride_tricks.sliding_window_view(speed * late, 5)
    usual = np.median(np.diff(ticks))
    whole = np.all(np.isfinite(y) & np.isfinite(expected), axis=1) & (x[:, 4] - x[:, 0] < 5.0 * usual)
    if np.count_nonzero(whole) < ENOUGH:
        return 0.0, 0.0
    x, y, expected = x[whole] - x[whole][:, 2:3], y[whole], expected[whole]
    weights = np.zeros(x.shape)
    weights[:, 2] = 1.0
    others = (0, 1, 3, 4)
    for j in others:
        guess = np.ones(len(x))
        for k in others:
            if k != j:
                guess *= -x[:, k] / (x[:, j] - x[:, k])
        weights[:, j] = -guess
    missed, made = np.sum(weights * y, axis=1), np.sum(weights * expected, axis=1)
    power = float(made @ made)
    if power == 0.0:
        return 0.0, 0.0
    share = float(made @ missed) / power
    variance = max(float(np.mean((missed - share * made) ** 2)), 1e-300)
    return share * power / variance, power / variance
