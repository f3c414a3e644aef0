"""Arithmetic behind the plots: excerpts, envelopes and binned medians."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flexjoint.recording.table import Recording

FEWEST = 5  # samples that have a median
TWO_LEVELS = 5.0  # uniform samples have 3.5, a sine's 4.1
FEW_VALUES = 8  # up to so many values of a signal each have a bin of their own
FEW_BINS = 3  # with two values, below which that is chance
RARE = 0.1  # share of samples below which a level is a few outliers


@dataclass(frozen=True)
class Binned:
    """Median and quartiles of y in bins of x that hold equally many samples, each (bins,); NaN where a bin
    holds too few. `discrete`: x has a few values only, and each of them is a bin."""

    x: np.ndarray
    low: np.ndarray
    median: np.ndarray
    high: np.ndarray
    discrete: bool = False


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
    return _binned(x[keep], y[keep], bins, np.ones(np.count_nonzero(keep), bool))


def levels(x: np.ndarray, y: np.ndarray, bins: int = 24) -> tuple[Binned, ...]:
    """The bins of y (N,) over x (N,), or two rows of them, each with its own medians.

    Two where y has two values at one x, as forth and back: one median would jump between them. Where y jumps
    between the same two values everywhere, a row leaves out the bins that hardly visit its own; else the rows
    meet where y has one value.
    """
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    split = between_levels(y)
    if split is not None:
        return tuple(_binned(x, y, bins, part) for part in (y <= split, y > split))
    index = _bin_index(x, bins) if x.size else np.zeros(0, int)
    count = int(index.max(initial=-1)) + 1
    splits = np.array([_or_nan(between_levels(y[index == i])) for i in range(count)])
    if np.count_nonzero(np.isfinite(splits)) < FEW_BINS:
        return (binned(x, y, bins),)
    at = splits[index]  # a comparison with NaN is false, so that both rows have what is not split
    return tuple(_binned(x, y, bins, part) for part in (~(y > at), ~(y <= at)))


def between_levels(y: np.ndarray) -> float | None:
    """A value between the two that y (N,) jumps between; None where it does not.

    The split leaves the smallest variance within its two parts (Otsu 1979); y jumps when the means of the
    parts lie apart by TWO_LEVELS of their standard deviation (D of Ashman, Bird and Zepf 1994).
    """
    y = np.sort(y[np.isfinite(y)])
    if y.size < 2 or y[0] == y[-1]:
        return None
    centre = float(y.mean())
    y = y - centre
    count = np.arange(1, y.size)
    sums, squares = np.cumsum(y)[:-1], np.cumsum(y**2)[:-1]
    means = sums / count, -sums / (y.size - count)
    between = count * (y.size - count) * (means[0] - means[1]) ** 2
    k = int(np.argmax(between))
    share = count[k] / y.size
    within = squares[k] / count[k] - means[0][k] ** 2, np.mean(y[k + 1 :] ** 2) - means[1][k] ** 2
    apart = (means[1][k] - means[0][k]) ** 2 > TWO_LEVELS**2 * 0.5 * (within[0] + within[1])
    if not apart or min(share, 1.0 - share) < RARE:
        return None
    return centre + 0.5 * float(y[k] + y[k + 1])


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


def _binned(x: np.ndarray, y: np.ndarray, bins: int, part: np.ndarray) -> Binned:
    """Bins of all samples, of which a part (N,) is looked at: NaN where it holds little of a bin."""
    if x.size == 0:
        empty = np.empty(0)
        return Binned(empty, empty, empty, empty)
    index = _bin_index(x, bins)
    rows = []
    for i in range(int(index.max()) + 1):
        inside = index == i
        at = inside & part
        if np.count_nonzero(inside) >= FEWEST:
            told = np.count_nonzero(at) >= max(FEWEST, RARE * np.count_nonzero(inside))
            quartiles = np.percentile(y[at], [25, 50, 75]) if told else np.full(3, np.nan)
            rows.append((float(np.median(x[inside])), *quartiles))
    table = np.array(rows).reshape(-1, 4)
    at, low, median, high = table.T
    return Binned(at, low, median, high, np.unique(x).size <= FEW_VALUES)


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def _bin_index(x: np.ndarray, bins: int) -> np.ndarray:
    values = np.unique(x)
    if values.size <= FEW_VALUES:  # quantiles do not tell these apart
        return np.searchsorted(values, x)
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(edges.size - 2, 0))
