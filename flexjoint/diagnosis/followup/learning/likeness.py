"""Which laws of the catalogue a learned law resembles, as the recording shows both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Likeness
from flexjoint.diagnosis.search.candidates import enumerate_candidates, traces
from flexjoint.effects import Planned


def likenesses(problem: Problem, base: Sequence[Planned], law: Planned) -> tuple[Likeness, ...]:
    """The correlation of a law's whitened trace in the balances with the trace of every effect that the
    joint, or the robot, could have, each at the start that resembles it most; the closest first."""
    effect = problem.denoised_moved_band(base, [*base, law])
    target = problem.whitening.white(effect).ravel() * problem.weights
    found: dict[str, float] = {}
    listed = {e.key for e in base}
    for candidate in enumerate_candidates(problem):
        if candidate.joint not in (law.joint, None) or candidate.key in listed:
            continue
        for trace in traces(problem, candidate, base, -target):
            r = _correlation(trace.columns * problem.weights, target)
            found[candidate.effect.name] = max(found.get(candidate.effect.name, 0.0), r)
    ordered = sorted(found.items(), key=lambda item: (-item[1], item[0]))
    return tuple(Likeness(name, round(r, 4)) for name, r in ordered)


def _correlation(columns: np.ndarray, target: np.ndarray) -> float:
    """Multiple correlation of a target (N,) with columns (k, N), about zero: a trace of none is zero."""
    whole = float(target @ target)
    if not whole > 0.0:
        return 0.0
    size = np.sqrt(np.sum(columns**2, axis=1))
    columns = columns[size > 0.0] / size[size > 0.0, None]
    if not len(columns):
        return 0.0
    slope = columns @ target
    explained = float(slope @ np.linalg.lstsq(columns @ columns.T, slope, rcond=1e-9)[0])
    return float(np.sqrt(np.clip(explained / whole, 0.0, 1.0)))
