"""How well the numbers of a fit are known: standard errors, and how many of them an effect is from none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, covariance
from flexjoint.effects import Parameter, Planned

Errors = dict[str, list[float]]  # standard errors of the components of each parameter


def number_covariance(best: Fit) -> np.ndarray:
    """(slots, slots) covariance of a fit's numbers, with scores of blocks of time."""
    rows, time = len(best.problem.balances.rows), best.problem.time
    blocks = np.tile(((time - time[0]) / best.settings.regression.time_block).astype(int), rows)
    return covariance(best, blocks)


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
