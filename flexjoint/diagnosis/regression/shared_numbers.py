"""Nominal numbers that several recordings of one robot share: a mass deviates in all of them by the same
amount, and this deviation is counted once. A deviation that explains one recording must fit the others, too.

With y_i + T_i (p - p_i) the white residual of recording i about its own optimum p_i, J_i the columns of the
nominal numbers and d their common deviations, the numbers p of the causes are those of

    min over p, d of  sum_i |y_i + T_i (p - p_i) - J_i d|^2 + |d|^2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexjoint.diagnosis.regression.fit import Fit, normal_equations
from flexjoint.diagnosis.regression.problem import Problem


class SharedNumbers:
    """The deviations d of some recordings. Encoder offsets that are free in each recording stay its own."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = problems
        keys: dict[object, int] = {}
        self.places = [
            np.array([keys.setdefault(key, len(keys)) for key in _keys(w, k)], dtype=int)
            for k, w in enumerate(problems)
        ]
        self.size = len(keys)
        gram = np.eye(self.size)
        for w, place in zip(problems, self.places, strict=True):
            gram[np.ix_(place, place)] += w.gram - np.eye(len(place))
        self.factor = cho_factor(gram)

    def surplus(self, residuals: Sequence[np.ndarray]) -> float:
        """Energy of residuals (samples,), one a recording, above the sum of what each has with deviations of
        its own (`Problem.energy`)."""
        pulls = [w.pull(y) for w, y in zip(self.problems, residuals, strict=True)]
        pull = self._gathered(pulls)
        own = sum(float(g @ w.deviations(y)) for g, w, y in zip(pulls, self.problems, residuals, strict=True))
        return own - float(pull @ cho_solve(self.factor, pull))

    def solve(self, fits: Sequence[Fit], own: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Common numbers (slots,) and their curvature (slots, slots), from each recording's fit and its own
        numbers."""
        slots = len(fits[0].slots)
        normal, wanted = np.zeros((slots, slots)), np.zeros(slots)
        across, pulls = np.zeros((slots, self.size)), []
        for fit, numbers, place in zip(fits, own, self.places, strict=True):
            w = fit.problem
            weighted = fit.tangents * w.squares
            at_zero = fit.y - numbers @ fit.tangents
            # without a trace, the weak priors of the numbers alone are left
            prior, slope = normal_equations(w, 0.0 * fit.tangents, fit.y, fit.slots, fit.effects)
            normal += weighted @ fit.tangents.T + prior
            wanted += prior @ numbers - slope - weighted @ at_zero
            across[:, place] += w.across(weighted)
            pulls.append(w.pull(at_zero))
        normal -= across @ cho_solve(self.factor, across.T)
        wanted += across @ cho_solve(self.factor, self._gathered(pulls))
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size)
        return np.linalg.lstsq(scaled, wanted / size, rcond=1e-12)[0] / size, normal

    def _gathered(self, pulls: Sequence[np.ndarray]) -> np.ndarray:
        out = np.zeros(self.size)
        for pull, place in zip(pulls, self.places, strict=True):
            out[place] += pull
        return out


def _keys(problem: Problem, recording: int) -> list[object]:
    """What each nominal number is: equal in two recordings where it is the same number of the robot."""
    floating = problem.robot.file.offsets == "per_recording"
    seen: dict[object, int] = {}
    out: list[object] = []
    for number in problem.nuisance:
        name = (number.name, number.joint)
        seen[name] = seen.get(name, -1) + 1
        free = (floating and number.name.endswith("_encoder_offset")) or not number.of_the_robot
        out.append((*name, seen[name], recording if free else None))
    return out
