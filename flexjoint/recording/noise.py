"""Noise of a sensor, predicted from its own samples."""

from __future__ import annotations

import numpy as np

COARSE = 3.0  # steps of a quantised signal that its noise spans, below which it counts as coarse
FOURTH = 1.0 + 16.0 + 36.0 + 16.0 + 1.0  # variance of the fourth difference of white noise of variance 1
JERKY = 1.3  # ratio of mean square to median, from which rare jerks are at work


def white_noise(samples: np.ndarray) -> float:
    """Standard deviation of the white part of a signal, from its fourth differences, which no smooth
    motion survives; never below what its quantisation alone makes (step / sqrt(12)).

    Robust: also from the median of absolute fourth differences, so that rare jerks do not count as noise.
    """
    x = samples[np.isfinite(samples)]
    if x.size < 16:
        return 0.0
    fourth = np.diff(x, 4)
    spread, robust = float(np.sqrt(np.mean(fourth**2) / FOURTH)), usual_noise(x)
    quantum = step_of(x)
    # the median of a coarsely quantised signal is itself a multiple of the step: then the mean square is
    # better, unless jerks blow it up
    coarse = robust < COARSE * quantum and spread < JERKY * robust
    white = spread if coarse or robust == 0.0 else min(spread, robust)
    return max(white, quantum / np.sqrt(12.0))


def usual_noise(samples: np.ndarray) -> float:
    """The same from the median of absolute fourth differences, whatever a signal's steps: it does not see
    what is rare."""
    return float(np.median(np.abs(np.diff(samples, 4))) / 0.6745 / np.sqrt(FOURTH))


def step_of(x: np.ndarray) -> float:
    """The step of a quantised signal, or 0."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 1e-12 * np.max(np.abs(x), initial=1e-300)]
    if not steps.size:
        return 0.0
    quantum = float(np.min(steps))
    multiples = steps / quantum
    return quantum if np.allclose(multiples, np.round(multiples), atol=1e-2) else 0.0
