"""The clock behind a recording's time stamps.

A logger that samples on a regular clock but stamps late leaves jitter in the time column: at 4 rad/s a
tenth of a millisecond looks like 0.4 mrad of noise. Where the samples themselves say so, the regular
clock is used instead of the stamps.
"""

from __future__ import annotations

import numpy as np

from flexjoint.recording import Recording

JITTER = 0.35  # largest share of the period by which a stamp may miss its tick
REGULAR = 1e-3  # share of the period up to which a clock counts as regular already
SMOOTHER = 0.25  # the regular clock must leave less than this share of the stamps' roughness (a variance)
POSITIONS = ("q", "theta", "q_ref", "theta_ref")
ENOUGH = 30  # samples whose neighbours are all there, for a verdict


def on_regular_clock(recording: Recording) -> Recording:
    """The recording with jittered stamps put back on their regular clock; else the recording unchanged.

    Both must hold: every stamp lies within 0.35 periods of a tick of its own, and the positions are much
    smoother over the ticks than over the stamps.
    """
    ticks = _ticks(recording.time)
    if ticks is None:
        return recording
    stamped, regular = 0.0, 0.0
    for (channel, _), values in recording.columns.items():
        if channel in POSITIONS:
            spread = float(np.nanstd(values))
            if spread > 0.0:
                stamped += _roughness(recording.time, values / spread)
                regular += _roughness(ticks, values / spread)
    if not regular < SMOOTHER * stamped:
        return recording
    # a stamp can be late but not early: the earliest ones are the clock's
    ticks = ticks + float(np.min(recording.time - ticks))
    return Recording(ticks, recording.columns, recording.name)


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


def _roughness(time: np.ndarray, values: np.ndarray) -> float:
    """Mean square by which samples miss the cubic through their two neighbours on either side."""
    x = np.lib.stride_tricks.sliding_window_view(time, 5)
    y = np.lib.stride_tricks.sliding_window_view(values, 5)
    usual = np.median(np.diff(time))
    whole = np.all(np.isfinite(y), axis=1) & (x[:, 4] - x[:, 0] < 5.0 * usual)
    if np.count_nonzero(whole) < ENOUGH:
        return 0.0
    x, y = x[whole] - x[whole][:, 2:3], y[whole]
    guess = np.zeros(len(x))
    others = (0, 1, 3, 4)
    for j in others:
        weight = np.ones(len(x))
        for k in others:
            if k != j:
                weight *= -x[:, k] / (x[:, j] - x[:, k])
        guess += weight * y[:, j]
    return float(np.mean((y[:, 2] - guess) ** 2))
