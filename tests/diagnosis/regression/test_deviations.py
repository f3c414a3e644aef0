"""Deviations of nominal numbers beside causes that multiply them."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.effects import effect

HEAVIER = Planted("motor_inertia", "elbow", {"scale": 2.0})
STICKS = Planted("motor_coulomb_friction", "shoulder", {"level": 12.0})  # with it numbers are relinearised


@pytest.fixture(scope="module")
def problem() -> Problem:
    recording = as_recording(Case("crane", "rich", 31, inexact=0.03).with_causes(HEAVIER, STICKS))
    return Problem(balances_of(nominal("crane"), recording))


def test_an_inertia_three_times_the_nominal_one_is_found_beside_its_own_tolerance(problem: Problem) -> None:
    """Its column is that of the nominal inertia: a step of its deviation does three times too much."""
    start = [
        effect("motor_inertia", "elbow", scale=2.0),
        effect("motor_coulomb_friction", "shoulder", level=12.0),
    ]

    found = at_own_level(fit(problem, start))

    (scale,) = [e.values["scale"] for e in found.effects if e.effect.name == "motor_inertia"]
    assert scale == pytest.approx(2.0, abs=0.25)  # the nominal number is off, too: 5 % of 3


def test_converged_deviations_explain_no_less_than_none(problem: Problem) -> None:
    effects = [
        effect("motor_inertia", "elbow", scale=2.0),
        effect("motor_coulomb_friction", "shoulder", level=12.0),
    ]
    problem = problem.at(problem.plausible_level(problem.residual(effects)))

    def energy(numbers: np.ndarray) -> float:
        left = problem.residual([*effects, *deviation_effects(problem, numbers)])
        linear = np.array([not n.becomes_effect for n in problem.nuisance])
        left = (left - problem.along(np.where(linear, numbers, 0.0))) * problem.weights
        return float(left @ left) + float(numbers @ numbers)

    numbers = converged_deviations(problem, effects, problem.residual(effects))

    assert energy(numbers) <= energy(np.zeros(len(problem.nuisance)))
    assert np.max(np.abs(numbers)) < 4.0
