"""Roots of many increasing functions at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

ROUNDS = 100  # of safeguarded Newton; each at least halves the bracket
WIDENINGS = 60  # doublings of the bracket until it holds the root


def increasing_roots(
    missing: Callable[[np.ndarray], np.ndarray], start: np.ndarray, reach: np.ndarray, steepness: float
) -> tuple[np.ndarray, np.ndarray]:
    """x (N,) with missing(x) = 0, and (N,) whether there is one; elementwise, by Newton's method kept inside
    a bracket that shrinks.

    `missing` may have flat stretches and kinks but must not decrease. `start` (N,) is a first guess, `reach`
    (N,) > 0 how far from it to look first; `steepness` is a typical slope.
    """
    low, high, found = _brackets(missing, start, reach)
    x = np.clip(start, low, high)
    for _ in range(ROUNDS):
        error = missing(x)
        low, high = np.where(error < 0.0, x, low), np.where(error > 0.0, x, high)
        step = 1e-7 * (1.0 + np.abs(x))
        slope = (missing(x + step) - error) / step
        safe = slope > 1e-6 * steepness
        newton = x - error / np.where(safe, slope, 1.0)
        inside = safe & (newton > low) & (newton < high)
        new = np.where(error == 0.0, x, np.where(inside, newton, 0.5 * (low + high)))
        if np.all((np.abs(new - x) <= 1e-15 * (1.0 + np.abs(x))) | ~found):
            return new, found
        x = new
    return x, found


def _brackets(
    missing: Callable[[np.ndarray], np.ndarray], start: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Below and above the roots, and whether there is one between."""
    low, high = start - reach, start + reach
    for _ in range(WIDENINGS):
        below, above = missing(low) > 0.0, missing(high) < 0.0
        if not np.any(below | above):
            break
        reach = 2.0 * reach
        low, high = np.where(below, start - reach, low), np.where(above, start + reach, high)
    return low, high, ~((missing(low) > 0.0) | (missing(high) < 0.0))
