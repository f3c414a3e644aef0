"""The noise level at which the nominal numbers stay plausible."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from planting import plant, robot_file
from planting.machine.sensing import SensorSet
from support.diagnose_cases import Case, as_recording, nominal
from support.robots.coupled_robots import coupled, swinging
from support.thorough import sample

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import judged_energy
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import load
from flexjoint.simulation.simulate import simulate

FLEXIBLE = ["gimbal", "crane", "scara"]


@cache
def rigid() -> Problem:
    """Three rigid joints with motor encoders and torques."""
    robot = coupled(None, rigid=True)
    noise = {"q": 2e-5, "theta": 2e-5, "tau_m": 0.01}
    run = simulate(FlexibleJointModel(robot, []), swinging(robot, 4.0), sample_rate=500.0, noise=noise)
    return Problem(balances_of(robot, run.measured))


@cache
def flexible(robot: str) -> Problem:
    return Problem(balances_of(nominal(robot), as_recording(Case(robot, "rich", 5).with_causes())))


def off(one: Problem, k: int, deviations: float) -> np.ndarray:
    """The whitened residual where a nominal number is off by so many of its deviations."""
    return one.residual([]) - deviations * one.J[k]


def of_motors(one: Problem) -> list[int]:
    return [k for k, number in enumerate(one.nuisance) if number.name == "motor_inertia"]


def raised(one: Problem, y: np.ndarray) -> set[int]:
    """The joints whose balances are raised."""
    level = one.plausible_level(y)
    factors = np.broadcast_to(level.implausibility, len(one.balances.rows))
    return {row.joint for row, factor in zip(one.balances.rows, factors, strict=True) if factor > 1.0}


def test_what_is_wrong_with_one_rigid_joint_raises_no_other() -> None:
    one = rigid()
    for k in of_motors(one):
        joint = one.nuisance[k].joint
        assert joint is not None
        assert raised(one, off(one, k, 8.0)) == {one.robot.joint_names.index(joint)}


@pytest.mark.parametrize("robot", FLEXIBLE)
def test_flexible_joints_are_raised_together(robot: str) -> None:
    one = flexible(robot)
    for k in of_motors(one):
        assert raised(one, off(one, k, 8.0)) == set(range(len(one.robot.joints)))


@pytest.mark.parametrize("robot", [None, *FLEXIBLE])
def test_plausible_numbers_raise_nothing(robot: str | None) -> None:
    one = rigid() if robot is None else flexible(robot)
    for k, number in enumerate(one.nuisance):
        if number.of_the_robot:
            assert raised(one, off(one, k, 1.0)) == set()


@pytest.mark.parametrize("robot", [None, *FLEXIBLE])
def test_a_raised_level_keeps_numbers_plausible_or_leaves_too_little_to_tell(robot: str | None) -> None:
    one = rigid() if robot is None else flexible(robot)
    limits = one.settings.regression
    for k in of_motors(one):
        y = off(one, k, 3.5)
        there = one.at(one.plausible_level(y))
        up = np.broadcast_to(there.level.implausibility, len(one.balances.rows)) > 1.0
        left = float(np.sum(there.rest_by_row(y)[up] ** 2))
        assert abs(there.deviations(y)[k]) <= limits.plausible or left <= 2.0 * limits.telling


@pytest.mark.parametrize("deviations", sample([20.0, 60.0], one_in=2))
def test_a_number_that_other_balances_hold_raises_none_without_end(deviations: float) -> None:
    """Where the balances that tell most of a number are raised, others that tell little hold it as far off:
    doubled until that is plausible, a level would overflow."""
    path = robot_file("dirty_drawn_12_of6_rigid_5")
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = as_recording(plant(path, [], "rich", 8.0, 5, sensors, rate=250.0))
    one = Problem(balances_of(load(path), recorded))
    for k, number in enumerate(one.nuisance):
        if number.name == "inertial":
            with np.errstate(over="raise"):
                level = one.plausible_level(off(one, k, deviations))
            assert np.all(np.isfinite(level.inflation))


def test_where_noise_does_not_decide_an_effect_that_does_nothing_costs_nothing() -> None:
    """A friction changes how noise enters, and is evaluated in full for that: what dry friction holds of
    loads that are off, beside any set, must not count against such effects alone."""
    robot = coupled(None, rigid=True)
    dry = [effect("motor_coulomb_friction", j.name, level=1.0, nominal=True) for j in robot.joints]
    load = effect("payload", robot.joint_names[-1], mass=-1.0, position=(0.1, 0.1, 0.1))
    claiming, noise = robot.extended(dry), {"theta": 2e-5, "tau_m": 0.01}
    run = simulate(
        FlexibleJointModel(robot, [*dry, load]), swinging(robot, 4.0), sample_rate=500.0, noise=noise
    )
    nothing = at_own_level(fit(Problem(balances_of(claiming, run.measured)), []))
    problem = nothing.problem
    assert np.max(problem.level.inflation) > problem.settings.regression.noise_decides
    none = [effect("motor_viscous_friction", j.name, coefficient=0.0) for j in robot.joints]

    bare, beside = (judged_energy(problem, nothing.y, effects) for effects in ([], none))

    assert beside == pytest.approx(bare, abs=0.1)  # chi-square; products of deviations are 1.0
