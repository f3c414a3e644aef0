"""How far a number spreads over recordings, beyond its standard errors, and which recording stands out.

With x_i the value of recording i and s_i its standard error, sum (x_i - m)^2 / s_i^2 about the weighted mean
m is chi-square with one degree of freedom fewer than recordings where they agree (Birge 1932). A recording is
odd where it is beyond chance from the weighted mean of the others. `false_discovery_control` counts the
chances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, false_discovery_control
from scipy.stats import norm as normal

from flexjoint.diagnosis.result import Repeated

FEWEST = 3  # recordings, of which one can be the odd one


@dataclass(frozen=True)
class Series:
    """A number's values (recordings,) and standard errors, infinite where one does not show it."""

    effect: str
    joint: str | None
    parameter: str
    unit: str
    values: np.ndarray
    stds: np.ndarray
    wraps: bool = False


def repeated(series: Sequence[Series], chance: float) -> tuple[Repeated, ...]:
    """Every number with its spread, and which recordings are odd where they disagree."""
    found = [_one(s) for s in series]
    tested = [r for r in found if r.freedom]
    if tested:
        apart = iter(false_discovery_control([r.chance for r in tested]) <= chance)
        found = [replace(r, disagree=bool(next(apart))) if r.freedom else r for r in found]
    return tuple(
        replace(r, odd=_odd(s, chance)) if r.disagree else r for s, r in zip(series, found, strict=True)
    )


def _unwrapped(series: Series) -> np.ndarray:
    """The values; of angles, those within half a turn of the best known one."""
    if not series.wraps:
        return series.values
    best = series.values[int(np.argmin(series.stds))]
    return np.asarray(best + np.angle(np.exp(1j * (series.values - best))))


def _one(series: Series) -> Repeated:
    values, stds = _unwrapped(series), series.stds
    known = np.isfinite(stds)
    weights = np.where(known, 1.0 / np.where(known, stds, 1.0) ** 2, 0.0)
    total = float(np.sum(weights))
    if total > 0.0:
        mean, std = float(np.sum(weights * values) / total), total**-0.5
        spread = float(np.sum(weights * (values - mean) ** 2))
    else:
        mean, std, spread = float(np.mean(values)), float("inf"), 0.0
    freedom = max(0, int(np.sum(known)) - 1)
    chance = float(chi2.sf(spread, freedom)) if freedom else 1.0
    widened = std * max(1.0, spread / freedom) ** 0.5 if freedom else std
    return Repeated(
        series.effect, series.joint, series.parameter, series.unit,
        tuple(map(float, values)), tuple(map(float, stds)), mean, widened, spread, freedom, chance, False,
    )  # fmt: skip


def _odd(series: Series, chance: float) -> tuple[int, ...]:
    """The recordings that differ from the mean of the others, the one that differs most first taken out."""
    values, stds = _unwrapped(series), series.stds
    left, odd = [int(k) for k in np.flatnonzero(np.isfinite(stds))], []
    while len(left) >= FEWEST:
        far = []
        for k in left:
            others = [j for j in left if j != k]
            weights = stds[others] ** -2.0
            mean = float(np.sum(weights * values[others]) / np.sum(weights))
            far.append(abs(values[k] - mean) / float(np.hypot(stds[k], np.sum(weights) ** -0.5)))
        worst = int(np.argmax(far))
        if 2.0 * normal.sf(far[worst]) * len(left) > chance:
            break
        rest = [k for i, k in enumerate(left) if i != worst]
        weights = stds[rest] ** -2.0
        mean = float(np.sum(weights * values[rest]) / np.sum(weights))
        agree = chi2.sf(float(np.sum(weights * (values[rest] - mean) ** 2)), len(rest) - 1) > chance
        if not agree and len(rest) < FEWEST:
            break  # of three that all differ none is odd
        odd.append(left[worst])
        left = rest
    return tuple(sorted(odd))
