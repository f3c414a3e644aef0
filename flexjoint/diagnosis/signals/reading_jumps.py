"""Jumps of a position's reading: an encoder that slips or is set anew. No body moves so."""

from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.settings import SignalSettings
from flexjoint.diagnosis.signals.jumps import half_way_apart
from flexjoint.recording.noise import step_of, usual_noise

NEGLIGIBLE = 1e-5  # of a reading's range, for its noise where it has none
BESIDE = 4  # samples on either side that a jump can disturb
FIRST = 2  # samples at either end that no three samples predict


def reading_jumps(x: np.ndarray, settings: SignalSettings) -> list[int]:
    """Indices of the samples of a position's reading (N,) after which it jumps and goes on as before."""
    if x.size < 2 * BESIDE + 2 or not np.all(np.isfinite(x)):
        return []
    least = settings.jump_noise * max(usual_noise(x), step_of(x), NEGLIGIBLE * float(np.ptp(x)))
    apart = half_way_apart(x)
    size = np.abs(apart)
    size[:FIRST] = size[-FIRST:] = 0.0
    found: list[int] = []
    for k in np.flatnonzero(size > least).tolist():
        around = slice(max(0, k - BESIDE), k + BESIDE + 1)
        if size[k] < np.max(size[around]):
            continue
        first = max(0, k - 2 * BESIDE)
        without = x[first : k + 2 * BESIDE + 2].copy()
        without[k + 1 - first :] -= apart[k]
        if np.max(np.abs(half_way_apart(without)[FIRST:-FIRST])) < settings.jump_smooth * size[k]:
            found.append(k)
    return found
