"""Centres of mass are trusted in metres, also where the nominal one is zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.robots.coupled_robots import coupled, swinging

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.nuisance import inertial_directions
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Robot
from flexjoint.robot.schema import COM_AT_ORIGIN, Tolerance
from flexjoint.simulation.simulate import simulate

INERTIAL, OTHER = 0.02, 0.1


def row(mass: float, centre: tuple[float, float, float]) -> np.ndarray:
    """(10,) parameters of a ball with that centre."""
    c = np.array(centre)
    about = 0.01 * np.eye(3) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array(
        [mass, *(mass * c), *(about[a, b] for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))]
    )


def centres(nominal: np.ndarray, com: float | None) -> np.ndarray:
    """(3, 3) one-deviation moves of the centre of mass [m], by direction."""
    moved = [nominal + d for d in inertial_directions(nominal, INERTIAL, OTHER, com)[1:4]]
    return np.array([m[1:4] / m[0] for m in moved]) - nominal[1:4] / nominal[0]


def test_it_is_the_metres_that_are_stated_along_each_axis() -> None:
    for centre in ((0.0, 0.0, 0.0), (0.2, 0.0, -0.1)):
        np.testing.assert_allclose(centres(row(2.0, centre), 0.003), 0.003 * np.eye(3), atol=1e-15)


def test_without_metres_it_is_the_share_of_before_and_a_floor_at_the_origin() -> None:
    c = np.array([0.2, 0.0, -0.1])
    expected = INERTIAL * (np.abs(c) + OTHER * np.linalg.norm(c))
    np.testing.assert_allclose(centres(row(2.0, (0.2, 0.0, -0.1)), None), np.diag(expected), atol=1e-15)
    at_origin = centres(row(2.0, (0.0, 0.0, 0.0)), None)
    np.testing.assert_allclose(at_origin, COM_AT_ORIGIN * np.eye(3), atol=1e-15)


def test_masses_and_inertias_stay_relative() -> None:
    nominal = row(2.0, (0.2, 0.0, -0.1))
    with_metres, without = (inertial_directions(nominal, INERTIAL, OTHER, com) for com in (0.003, None))
    for k in (0, *range(4, 10)):
        np.testing.assert_array_equal(with_metres[k], without[k])


def healthy_with_centres_off_by(metres: float, tolerance: Tolerance) -> float:
    """Energy a sample of a machine whose last link's centre is not at the origin, where the model has it."""
    robot = centred(coupled(None, rigid=True), 0.0)
    machine = centred(robot, metres)
    noise = {"q": 2e-5, "theta": 2e-5, "tau_m": 0.01}
    run = simulate(FlexibleJointModel(machine, []), swinging(robot, 4.0), sample_rate=500.0, noise=noise)
    problem = Problem(balances_of(replace(robot, tolerance=tolerance), run.measured))
    return problem.energy(problem.residual([])) / problem.freedom


def centred(robot: Robot, metres: float) -> Robot:
    """The robot with its last link's centre of mass along x, where the model has it at the joint."""
    model = robot.model.copy()
    inertia = model.inertias[robot.joints[-1].pin_id]
    inertia.lever = np.array([metres, 0.0, 0.0])
    model.inertias[robot.joints[-1].pin_id] = inertia
    return replace(robot, model=model)


def test_a_centre_3_mm_off_the_origin_is_within_tolerance() -> None:
    exact = Tolerance(inertial=0.02, com=0.0)
    assert healthy_with_centres_off_by(0.003, exact) > 1.5
    for tolerance in (Tolerance(), Tolerance(com=0.005)):
        # 1 within the scatter of some hundred independent samples, and the prior of a move by 0.6 deviations
        assert healthy_with_centres_off_by(0.003, tolerance) == pytest.approx(1.0, abs=0.1)
