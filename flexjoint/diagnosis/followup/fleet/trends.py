"""Whether a number of a machine has changed over time, and when: steps (`ruptures`) and drifts, with the
temperature as a covariate.

Change points minimise what is left of a piecewise constant number, plus a penalty for each (Pelt; Killick,
Fearnhead and Eckley 2012), once a slope over the temperature is taken out that neighbours in time tell. How
sure one is comes from an F test of the pieces against one piece, temperature in both, with the places at
which pieces might have begun counted as chances; a drift's from a t test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from flexjoint.core.errors import MissingExtraError
from flexjoint.diagnosis.settings import FleetSettings

FEWEST_IN_PIECE = 2
WORSE = 5.0  # times the usual standard error of a number, from which a recording does not show it
DAY = 86_400.0  # [s]


@dataclass(frozen=True)
class Change:
    """A number that changed: from `was` to `now` at the temperature that was usual, first at `since` [s],
    with the probability that chance does as much. `points` are the times of all change points; `per_degree`
    is its slope over the temperature with its standard error, 0 where that is not known."""

    kind: Literal["step", "drift", "none"]
    was: float
    now: float
    since: float
    chance: float
    points: tuple[float, ...]
    per_degree: float = 0.0
    per_degree_error: float = 0.0
    warm: bool = False  # whether the temperature was known, and taken out


def change(
    time: np.ndarray, values: np.ndarray, stds: np.ndarray, temperature: np.ndarray, settings: FleetSettings
) -> Change | None:
    """What became of a number (N,) with standard errors (NaN: not stated) at temperatures (NaN: not known).
    None where too few recordings show it.

    Raises MissingExtraError without ruptures."""
    usual = float(np.nanmedian(stds)) if np.any(np.isfinite(stds)) else 0.0
    shown = np.isfinite(values) & ~(stds > WORSE * usual) & ~np.isinf(stds)
    time, values, temperature = time[shown], values[shown], temperature[shown]
    count = values.size
    if count < settings.fewest:
        return None
    warm = bool(np.all(np.isfinite(temperature)) and np.ptp(temperature) > settings.warm)
    heat = (temperature - np.median(temperature))[:, None] if warm else np.zeros((count, 0))
    plain = np.hstack([np.ones((count, 1)), heat])
    edges = _edges(values, heat, usual, settings)
    pieces = np.array([(np.arange(count) >= k) & (np.arange(count) < end) for k, end in _spans(edges, count)])
    stepped = np.hstack([pieces.T.astype(float), heat])
    drifting = np.hstack([plain, ((time - time[0]) / DAY)[:, None]])
    by_step = _chance(values, plain, stepped) * float(count - 1) ** len(edges) if edges else 1.0
    by_drift = _slope_chance(values, drifting)
    chance = min(1.0, 2.0 * min(by_step, by_drift))
    points = tuple(float(time[k]) for k in edges)
    changed = bool(edges) or by_drift <= settings.false_alarms
    design, heated = (stepped, len(edges) + 1) if edges else (drifting if changed else plain, 1)
    found, errors = _fitted(values, design)
    law = (float(found[heated]), float(errors[heated])) if warm else (0.0, 0.0)
    was = float(found[0])
    if edges:
        kind: Literal["step", "drift"] = "step" if by_step <= by_drift else "drift"
        return Change(kind, was, float(found[len(edges)]), points[0], chance, points, *law, warm)
    if changed:
        now = was + float(found[-1]) * float(time[-1] - time[0]) / DAY
        return Change("drift", was, now, float(time[0]), chance, (), *law, warm)
    return Change("none", was, was, float(time[-1]), chance, (), *law, warm)


def _spans(edges: list[int], count: int) -> list[tuple[int, int]]:
    return list(zip([0, *edges], [*edges, count], strict=True))


def _edges(values: np.ndarray, heat: np.ndarray, usual: float, settings: FleetSettings) -> list[int]:
    """Indices at which pieces begin, the first left out."""
    try:
        import ruptures
    except ImportError:
        raise MissingExtraError("ruptures", "fleet") from None
    count = values.size
    flat = values
    if heat.size:  # what neighbours in time differ by, without what their temperatures make
        flat = values - heat[:, 0] * _through_differences(values, heat[:, 0])
    # successive differences have twice the variance, and a step is in one of them only
    noise = max(1.4826 * float(np.median(np.abs(np.diff(flat)))) / np.sqrt(2.0), usual, 1e-12)
    scaled = flat / noise
    penalty = settings.penalty * float(np.log(count))
    search = ruptures.Pelt(model="l2", min_size=FEWEST_IN_PIECE, jump=1).fit(scaled[:, None])
    return [int(k) for k in search.predict(pen=penalty)[:-1]]


def _through_differences(values: np.ndarray, heat: np.ndarray) -> float:
    """The slope over the temperature (N,) that explains the differences of neighbours in time, by the
    median: a step is in one of them only (Theil 1950; Sen 1968)."""
    warmer = np.diff(heat)
    told = np.abs(warmer) > 0.1 * float(np.ptp(heat))
    return float(np.median(np.diff(values)[told] / warmer[told])) if np.any(told) else 0.0


def _left(values: np.ndarray, design: np.ndarray) -> float:
    return float(np.sum((values - design @ np.linalg.lstsq(design, values, rcond=None)[0]) ** 2))


def _chance(values: np.ndarray, small: np.ndarray, large: np.ndarray) -> float:
    """F test of a design against a smaller one that it contains."""
    freedom = values.size - large.shape[1]
    more = large.shape[1] - small.shape[1]
    if freedom < 1 or more < 1:
        return 1.0
    rest, whole = _left(values, large), _left(values, small)
    return float(fisher.sf((whole - rest) / more / max(rest / freedom, 1e-300), more, freedom))


def _fitted(values: np.ndarray, design: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (k,) of a design (N, k) by least squares, and their standard errors; infinite where as many
    values as numbers tell none."""
    found, freedom = np.linalg.lstsq(design, values, rcond=None)[0], values.size - design.shape[1]
    if freedom < 1:
        return found, np.full(found.size, np.inf)
    variance = max(_left(values, design) / freedom, 1e-300)
    return found, np.sqrt(variance * np.diag(np.linalg.pinv(design.T @ design)))


def _slope_chance(values: np.ndarray, design: np.ndarray) -> float:
    """t test of the last column."""
    found, errors = _fitted(values, design)
    if not np.isfinite(errors[-1]):
        return 1.0
    distance = abs(found[-1]) / max(float(errors[-1]), 1e-300)
    return float(2.0 * student.sf(distance, values.size - design.shape[1]))
