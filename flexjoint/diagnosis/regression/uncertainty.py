"""How well the numbers of a fit are known: standard errors, and how many of them an effect is from none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, covariance
from flexjoint.effects import Parameter, Planned

Errors = dict[str, list[float]]  # standard errors of the components of each parameter


def number_covariance(best: Fit) -> np.ndarray:
    """(slots, slots) covariance of a fit's numbers, with scores of blocks of time; of those that are at no
    bound of what they may be, beside those that are (`beside_bounds`)."""
    rows, time = len(best.problem.balances.rows), best.problem.time
    blocks = np.tile(((time - time[0]) / best.settings.regression.time_block).astype(int), rows)
    return beside_bounds(covariance(best, blocks), bounds_reached(best) != 0)


def bounds_reached(best: Fit) -> np.ndarray:
    """(slots,) -1 where a fit's number is at its lower bound, 1 at its upper one, 0 between."""
    numbers = np.array([slot.get(best.effects) for slot in best.slots])
    low, high = (np.array([getattr(slot.param, side) for slot in best.slots]) for side in ("low", "high"))
    return np.where(numbers <= low, -1, np.where(numbers >= high, 1, 0))


def beside_bounds(spread: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The covariance of numbers of which some are `at` (k,) a bound: the constraint holds those there, and
    the others do not move with them. Each one at a bound has the variance that it would have if it alone
    could leave. Two laws of one friction, one of them at zero, would otherwise both be uncertain by all of
    it (Nocedal and Wright, Numerical Optimization, 2006, ch. 16: the active set)."""
    if not np.any(at):
        return spread
    out = np.zeros_like(spread)
    free = np.flatnonzero(~at)
    out[np.ix_(free, free)] = _conditional(spread, free, np.flatnonzero(at))
    for k in np.flatnonzero(at):
        others = np.array([j for j in np.flatnonzero(at) if j != k], int)
        out[k, k] = _conditional(spread, np.array([k]), others)[0, 0]
    return out


def _conditional(spread: np.ndarray, asked: np.ndarray, given: np.ndarray) -> np.ndarray:
    """The covariance of some numbers where others are given (normal distributions)."""
    size = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    scaled = spread / np.outer(size, size)
    across = scaled[np.ix_(asked, given)]
    known = across @ np.linalg.pinv(scaled[np.ix_(given, given)], rcond=1e-12, hermitian=True) @ across.T
    left = scaled[np.ix_(asked, asked)] - known
    return np.asarray(left * np.outer(size[asked], size[asked]))


def standard_errors(best: Fit) -> list[Errors]:
    """Per effect: standard errors of each parameter's components."""
    deviation = np.sqrt(np.maximum(np.diag(number_covariance(best)), 0.0))
    out: list[Errors] = [{} for _ in best.effects]
    for slot, std in zip(best.slots, deviation, strict=True):
        out[slot.effect].setdefault(slot.param.name, []).append(float(std))
    return out


def certainty(
    best: Fit, planned: Planned, spread: dict[str, list[float]], params: Sequence[Parameter] | None = None
) -> float:
    """Distance of an effect, or of some of its numbers, from its absence, in standard errors of the number
    that is furthest from it."""
    params = planned.effect.nulls if params is None else params
    return max([_distance(best, planned, param, spread) for param in params], default=0.0)


def _distance(best: Fit, planned: Planned, param: Parameter, spread: dict[str, list[float]]) -> float:
    """Distance of a number from its absence, in standard errors."""
    listed = next((e for e in best.problem.nominal if e.key == planned.key), None)
    value = np.ravel(planned.values[param.name])
    null = param.null if listed is None else np.ravel(listed.values[param.name])
    std = np.array(spread.get(param.name, [0.0]))
    return float(np.max(np.abs(value - null) / np.maximum(std, 1e-300)))
