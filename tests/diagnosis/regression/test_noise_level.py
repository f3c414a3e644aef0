"""The noise level at which the nominal numbers stay plausible."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem

ROBOTS = ["gimbal", "crane", "scara"]
SENSORS = ["full", "encoders"]


@cache
def problem(robot: str, sensors: str) -> Problem:
    case = Case(robot, "rich", 5, sensors)
    return Problem(balances_of(nominal(robot), as_recording(case.with_causes())))


def off(one: Problem, k: int, deviations: float) -> np.ndarray:
    """The whitened residual where a nominal number is off by so many of its deviations."""
    return one.residual([]) - deviations * one.J[k]


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_wrong_with_one_joint_raises_no_other(robot: str, sensors: str) -> None:
    one = problem(robot, sensors)
    for k, number in enumerate(one.nuisance):
        if number.name != "motor_inertia":
            continue
        level = one.plausible_level(off(one, k, 8.0))
        raised = np.broadcast_to(level.implausibility, len(one.balances.rows)) > 1.0
        joints = {row.joint for row, up in zip(one.balances.rows, raised, strict=True) if up}
        assert joints == {one.robot.joint_names.index(number.joint)}


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_plausible_numbers_raise_nothing(robot: str, sensors: str) -> None:
    one = problem(robot, sensors)
    for k, number in enumerate(one.nuisance):
        if number.of_the_robot:
            assert one.plausible_level(off(one, k, 1.0)).implausible == 1.0


def test_a_raised_level_keeps_the_number_plausible_or_leaves_too_little_to_tell() -> None:
    one = problem("crane", "full")
    limits = one.settings.regression
    k = next(i for i, n in enumerate(one.nuisance) if n.name == "motor_inertia")
    y = off(one, k, 3.0)
    there = one.at(one.plausible_level(y))
    told = np.diagonal(one.moves.grams, axis1=1, axis2=2)[:, k]
    left = np.sum(there.rest_by_row(y) ** 2, axis=1)[told > limits.telling_share * np.max(told)]
    assert abs(there.deviations(y)[k]) <= limits.plausible or np.all(left <= limits.telling)
