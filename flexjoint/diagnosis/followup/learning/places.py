"""Whether a law does harm at places where the model was right.

A law may remove most of an error and yet add one elsewhere: a spline through a sudden stop swings beside it.
Another motion may stay where it swings. So a law must hold at every place of its signal, and not on average.
"""

from __future__ import annotations

import numpy as np

PLACES = 10  # tenths of the samples, in the order of the signal: each has enough of them for an RMS


def worst_place(signal: np.ndarray, without: np.ndarray, left: np.ndarray, noise: np.ndarray) -> float:
    """How many times as large the error is with a law as without it, at the place of its signal and in the
    balance where that is most; an error below noise counts as noise.

    Args:
        signal: (N,) what the law follows.
        without: (k, N) residuals of k balances [N m] without the law.
        left: (k, N) residuals with it.
        noise: (k,) standard deviation of a sample's noise [N m].
    """
    order = np.argsort(signal, kind="stable")
    worst = 0.0
    for place in np.array_split(order, PLACES):
        if place.size:
            first, last = (np.sqrt(np.mean(r[:, place] ** 2, axis=1)) for r in (without, left))
            worst = max(worst, float(np.max(last / np.maximum(np.maximum(first, noise), 1e-300))))
    return worst
