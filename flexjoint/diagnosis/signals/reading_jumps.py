"""Jumps of a position's reading: an encoder that slips or is set anew. No body moves so."""

from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.settings import SignalSettings
from flexjoint.recording.noise import step_of, usual_noise

HALF_AHEAD = np.array(
    [1.875, -1.25, 0.375]
)  # a parabola through three samples, half a period beyond the last
NEGLIGIBLE = 1e-5  # of a reading's range, for its noise where it has none
BESIDE = 4  # samples on either side


def reading_jumps(x: np.ndarray, settings: SignalSettings) -> list[int]:
    """Indices of the samples of a position's reading (N,) after which it jumps and goes on as before."""
    if x.size < 2 * BESIDE + 2 or not np.all(np.isfinite(x)):
        return []
    least = settings.jump_noise * max(usual_noise(x), step_of(x), NEGLIGIBLE * float(np.ptp(x)))
    size = np.abs(_apart(x))
    found: list[int] = []
    for k in np.flatnonzero(size > least).tolist():
        around = slice(max(0, k - BESIDE), k + BESIDE + 1)
        if size[k] < np.max(size[around]):
            continue
        without = x[max(0, k - 2 * BESIDE) : k + 2 * BESIDE + 2].copy()
        at = k - max(0, k - 2 * BESIDE)
        without[at + 1 :] -= _apart(x)[k]
        if np.max(np.abs(_apart(without))) < settings.jump_smooth * size[k]:
            found.append(k)
    return found


def _apart(x: np.ndarray) -> np.ndarray:
    """(N - 1,) by how much parabolas from both sides differ between a sample and the next; 0 at the ends."""
    before, after = np.zeros(x.size - 1), np.zeros(x.size - 1)
    before[2:] = HALF_AHEAD @ np.array([x[2:-1], x[1:-2], x[:-3]])
    after[:-2] = HALF_AHEAD @ np.array([x[1:-2], x[2:-1], x[3:]])
    before[-2:] = after[-2:] = after[:2] = before[:2] = 0.0
    return after - before
