"""Local polynomials: value and derivatives of a noisy, possibly ragged signal at any time."""

from __future__ import annotations

import numpy as np

DEGREE = 3
REACH = 3.0  # half width of the window in kernel widths
SAMPLES = 9  # at least this many samples take part, however sparse
RIDGE = 1e-12  # share of the trace that keeps the equations of too few samples solvable
SUREST = (
    1e4  # weight of a rate against that of a value over a kernel's width: a hundred times as sure; beyond
)
# it (rates without noise, or smoothed ones) the values would drown in rounding
FAR = 30.0  # [kernel widths] weights beyond it are 0 for any use, and would underflow


def local_polynomial(
    time: np.ndarray,
    values: np.ndarray,
    at: np.ndarray,
    width: float,
    rate_time: np.ndarray | None = None,
    rates: np.ndarray | None = None,
    rate_weight: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, first and second derivative, each (M,), of a signal at times (M,) [s].

    Weighted least squares of a cubic to the samples around each time (Gaussian kernel of standard deviation
    `width` [s]; Fan and Gijbels 1996, chapter 3), together with samples of the derivative where given.

    Args:
        time, values: (N,) increasing, without gaps marked as NaN.
        rate_time, rates: (L,) samples of the derivative.
        rate_weight: (sd of values / sd of rates)^2 [s^2].
    """
    reach = _widths(time, at, width)
    matrix, right = _moments(time, values, at, reach, 0)
    if rates is not None and rate_time is not None and len(rates) >= 2:
        more, on_right = _moments(rate_time, rates, at, reach, 1)
        # a derivative by x = (t - at)/reach is reach times a rate
        scale = np.minimum(rate_weight / reach**2, SUREST)
        matrix = matrix + scale[:, None, None] * more
        right = right + (scale * reach)[:, None] * on_right
    ridge = RIDGE * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(DEGREE + 1)
    found = np.linalg.solve(matrix + ridge, right[..., None])[..., 0]
    return found[:, 0], found[:, 1] / reach, 2.0 * found[:, 2] / reach**2


def _rows(time: np.ndarray, at: np.ndarray, width: float) -> np.ndarray:
    """(M, m) places of the samples around each time."""
    period = float(np.median(np.diff(time)))
    half = max(int(np.ceil(REACH * width / period)), SAMPLES // 2)
    count = min(2 * half + 1, len(time))
    first = np.clip(np.searchsorted(time, at) - half, 0, len(time) - count)
    return first[:, None] + np.arange(count)


def _widths(time: np.ndarray, at: np.ndarray, width: float) -> np.ndarray:
    """(M,) kernel widths: in a gap and at an end they grow so that enough samples count."""
    distance = np.sort(np.abs(time[_rows(time, at, width)] - at[:, None]), axis=1)
    return np.maximum(width, 0.5 * distance[:, min(SAMPLES, distance.shape[1]) - 1])


def _moments(
    time: np.ndarray, values: np.ndarray, at: np.ndarray, reach: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (M, 4, 4), (M, 4) of a cubic in x = (t - at)/reach to samples of its derivative by x
    of the given order (0 or 1)."""
    rows = _rows(time, at, float(np.max(reach)))
    x = (time[rows] - at[:, None]) / reach[:, None]
    one, square = np.ones_like(x), x * x
    powers = np.stack([one, x, square, square * x], axis=1)
    if order:
        powers = np.stack([np.zeros_like(x), one, 2.0 * x, 3.0 * square], axis=1)
    weighted = powers * np.exp(-0.5 * np.minimum(np.abs(x), FAR) ** 2)[:, None]
    return weighted @ powers.transpose(0, 2, 1), (weighted @ values[rows][..., None])[..., 0]


def noise(values: np.ndarray) -> float:
    """Standard deviation of white noise on evenly spaced samples, from fourth differences (missing samples
    left out); robust against jumps."""
    differences = np.diff(values, 4)
    differences = differences[np.isfinite(differences)]
    if len(differences) < SAMPLES:
        return 0.0
    # white noise of standard deviation 1 has fourth differences of variance 1 + 16 + 36 + 16 + 1
    return float(1.4826 * np.median(np.abs(differences)) / np.sqrt(70.0))
