"""Arithmetic behind the plots: excerpts, envelopes and binned medians."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flexjoint.recording.table import Recording


@dataclass(frozen=True)
class Binned:
    """Median and quartiles of y in bins of x that hold equally many samples, each (bins,)."""

    x: np.ndarray
    low: np.ndarray
    median: np.ndarray
    high: np.ndarray


def on_times(recording: Recording, channel: str, joint: str, time: np.ndarray) -> np.ndarray:
    """(M,) a measured channel at the given times [s], linear in between; NaN beside missing samples."""
    values = recording.get(channel, joint)
    if np.array_equal(time, recording.time):
        return values
    return np.interp(time, recording.time, values, left=np.nan, right=np.nan)


def excerpt(time: np.ndarray, error: np.ndarray, length: float) -> tuple[float, float]:
    """Start and end [s] of the stretch of that length in which the mean square error (N,) is largest."""
    start, stop = float(time[0]), float(time[-1])
    if stop - start <= length or not np.any(np.isfinite(error)):
        return start, min(stop, start + length)
    energy = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2 * np.gradient(time))])
    ends = np.searchsorted(time, time + length, side="right")
    whole = time + length <= stop
    sums = np.where(whole, energy[ends] - energy[: time.size], -np.inf)
    first = float(time[int(np.argmax(sums))])
    return first, first + length


def thinned(time: np.ndarray, values: np.ndarray, buckets: int) -> tuple[np.ndarray, np.ndarray]:
    """Time and values (N,) with the extremes of each of so many buckets kept, so that no peak is lost."""
    if time.size <= 2 * buckets:
        return time, values
    keep: set[int] = set()
    edges = np.linspace(0, time.size, buckets + 1).astype(int)
    for low, high in pairwise(edges):
        part = values[low:high]
        finite = np.flatnonzero(np.isfinite(part))
        if finite.size == 0:
            keep.add(int(low))  # a gap stays a gap
            continue
        keep.add(int(low + finite[np.argmin(part[finite])]))
        keep.add(int(low + finite[np.argmax(part[finite])]))
    chosen = np.array(sorted(keep))
    return time[chosen], values[chosen]


def binned(x: np.ndarray, y: np.ndarray, bins: int = 24) -> Binned:
    """Medians and quartiles of y (N,) over x (N,); bins without spread in x are merged."""
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    if x.size == 0:
        empty = np.empty(0)
        return Binned(empty, empty, empty, empty)
    index = _bin_index(x, bins)
    rows = []
    for i in range(int(index.max()) + 1):
        inside = index == i
        if np.count_nonzero(inside) >= 5:
            rows.append((float(np.median(x[inside])), *np.percentile(y[inside], [25, 50, 75])))
    table = np.array(rows).reshape(-1, 4)
    return Binned(*table.T)


def dependence(x: np.ndarray, y: np.ndarray, bins: int = 24) -> float:
    """Share of the variance of y (N,) that its mean in bins of x (N,) accounts for (correlation ratio)."""
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    total = float(np.var(y)) if y.size else 0.0
    if y.size < 5 * bins or total == 0.0:
        return 0.0
    index = _bin_index(x, bins)
    counts = np.bincount(index)
    means = np.bincount(index, weights=y) / np.maximum(counts, 1)
    return float(np.sum(counts * (means - y.mean()) ** 2) / y.size / total)


def _bin_index(x: np.ndarray, bins: int) -> np.ndarray:
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(edges.size - 2, 0))
