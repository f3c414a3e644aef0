"""Deviations of nominal numbers beside causes that multiply them."""

from __future__ import annotations

import numpy as np
import pytest
from planting import FULL, Planted, plant, robot_file
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import _energy_at, converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.effects import effect
from flexjoint.robot.robot import load

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


def test_any_set_is_judged_beside_the_noise_that_likely_numbers_make() -> None:
    """A stiffness 5 % off makes more noise in the spring's balance. Where only sets with an effect that
    changes noise were judged beside it, a sensor's gain won over the offset that was there."""
    name, offset = "drawn_6023_loose", {"offset": 1.85}
    planted = [Planted("torque_offset", "joint_0", offset)]
    made = plant(robot_file(name), planted, "steps", 12.0, 5, FULL, rate=500.0, inexact=0.05)
    bare = fit(Problem(balances_of(load(robot_file(name)), as_recording(made))), [])
    found = at_own_level(fit(bare.problem, [effect("torque_offset", "joint_0", **offset)]))
    numbers = found.problem.deviations(found.y)
    in_full = _energy_at(found.problem, numbers, found.effects)
    assert found.energy == pytest.approx(in_full, abs=1.0)
    assert abs(found.energy - found.problem.energy(found.y)) > 50.0  # beyond any price
