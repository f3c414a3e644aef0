"""Counts over the study's records: rates with intervals, reliability, parameters, times."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, binomtest

from .score import (
    OUTCOMES,
    STRUCK_OUTCOMES,
    Match,
    Record,
    deviations,
    false_names,
    is_name_of,
    main_error,
    matches,
    outcome,
    struck_outcome,
)

CONFIDENCE = 0.95
EXCESS_EDGES = (1.0, 1.02, 1.1, 1.3, 2.0, 5.0, 20.0, 100.0, np.inf)
PROBABILITY_EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.99, 1.0)
PERCENTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Rate:
    """`hits` of `cases`, with the exact binomial interval (Clopper and Pearson 1934)."""

    hits: int
    cases: int

    @property
    def share(self) -> float:
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        tail, k, n = (1 - CONFIDENCE) / 2, self.hits, self.cases
        low = float(beta.ppf(tail, k, n - k + 1)) if k > 0 else 0.0
        high = float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0
        return low, high

    @property
    def wilson(self) -> tuple[float, float]:
        """The interval of Wilson (1927)."""
        return tuple(binomtest(self.hits, self.cases).proportion_ci(CONFIDENCE, method="wilson"))


def of(records: Iterable[Record], part: str) -> list[Record]:
    return [r for r in records if r["part"] == part]


def rate(records: Sequence[Record], hit: Callable[[Record], bool]) -> Rate:
    return Rate(sum(map(hit, records)), len(records))


def named(record: Record) -> bool:
    """Exactly, or tied with its equivalents."""
    return outcome(record) in ("exact", "tied")


def alarmed(record: Record) -> bool:
    """Whether a healthy machine was called anything else."""
    return record["verdict"] != "healthy" or bool(record.get("findings"))


def outcomes(records: Sequence[Record]) -> Counter[str]:
    return Counter({name: 0 for name in OUTCOMES} | Counter(map(outcome, records)))


def struck_outcomes(records: Sequence[Record]) -> Counter[str]:
    return Counter({name: 0 for name in STRUCK_OUTCOMES} | Counter(map(struck_outcome, records)))


def by(records: Sequence[Record], group: Callable[[Record], object]) -> dict[str, list[Record]]:
    """Records by the name of their group, names sorted."""
    names = sorted({str(group(r)) for r in records})
    return {name: [r for r in records if str(group(r)) == name] for name in names}


def by_excess(records: Sequence[Record]) -> list[tuple[float, float, list[Record]]]:
    """Records by their whitened excess per sample."""
    found = [r for r in records if r["excess"] is not None]
    edges = itertools.pairwise(EXCESS_EDGES)
    return [
        (a, b, [r for r in found if (a <= r["excess"] or a == EXCESS_EDGES[0]) and r["excess"] < b])
        for a, b in edges
    ]


# --- stated probabilities ---------------------------------------------------------------------------------
def stated(records: Sequence[Record]) -> tuple[np.ndarray, np.ndarray]:
    """Stated probability of every finding, and whether its name was the truth."""
    pairs = [
        (f["probability"], any(is_name_of(f, t, r) for t in r["truth"]))
        for r in records
        for f in r.get("findings", ())
    ]
    probability, right = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(probability, dtype=float), np.array(right, dtype=bool)


def reliability(records: Sequence[Record]) -> list[tuple[float, float, int, float, Rate]]:
    """Per bin of stated probability: its edges, findings, their mean stated probability, and how many were
    right."""
    probability, right = stated(records)
    rows = []
    for a, b in itertools.pairwise(PROBABILITY_EDGES):
        inside = (probability >= a) & ((probability < b) | (b == PROBABILITY_EDGES[-1]))
        count = int(inside.sum())
        mean = float(probability[inside].mean()) if count else float("nan")
        rows.append((a, b, count, mean, Rate(int(right[inside].sum()), count)))
    return rows


def brier(records: Sequence[Record]) -> float:
    """Mean squared difference between what was stated and what was so (Brier 1950)."""
    probability, right = stated(records)
    return float(np.mean((probability - right) ** 2)) if len(probability) else float("nan")


# --- parameters -------------------------------------------------------------------------------------------
def exact_matches(records: Sequence[Record]) -> list[Match]:
    """Causes that were named, in cases without a false name beside them."""
    clean = [r for r in records if not false_names(r)]
    return [m for r in clean for m in matches(r) if m.kind == "exact"]


def relative_errors(records: Sequence[Record]) -> np.ndarray:
    """Relative errors of the main parameters of causes that were named."""
    errors = [main_error(m) for m in exact_matches(records)]
    return np.array([error / size for error, _, size in errors if size > 0])


def scaled_errors(records: Sequence[Record]) -> np.ndarray:
    """Errors of all parameters of causes that were named, in their standard errors."""
    return np.array([z for m in exact_matches(records) for _, z in deviations(m)])


def seconds(records: Sequence[Record]) -> tuple[float, float, float]:
    """5th, 50th and 95th percentile of the time that a diagnosis took."""
    taken = [r["diagnosis"] for r in records]
    low, middle, high = np.quantile(taken, PERCENTILES) if taken else (np.nan,) * 3
    return float(low), float(middle), float(high)
