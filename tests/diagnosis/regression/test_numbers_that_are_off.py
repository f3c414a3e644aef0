"""What nominal numbers that are off change of the balances is what their columns say, whatever sensors there
are: what is left of it is told as a cause of a machine with nothing wrong."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from planting.robots import deviating, read_robot
from support.diagnose_cases import ROBOTS, Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import about_likely_links
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.robot.robot import Robot

OFF = 0.02  # of every number, as those of the robot files are known
MOTORS = ("theta", "dtheta", "tau_m", "tau_cmd")
SENSORS = {
    "full": ("q", "dq", *MOTORS, "tau_t"),
    "both encoders": ("q", "dq", *MOTORS),
    "motors and springs": (*MOTORS, "tau_t"),
    "motors": MOTORS,
    "links and springs": ("q", "dq", "tau_m", "tau_cmd", "tau_t"),
}


def recorded_machine(case: Case) -> Robot:
    """The machine that a case was recorded of: the nominal robot with the real one's numbers."""
    robot = nominal(case.robot)
    real = deviating(
        read_robot(ROBOTS / f"{case.robot}.yaml"), case.inexact, np.random.default_rng([case.seed, 1])
    )
    model, joints = copy.deepcopy(robot.model), []
    for i, joint in enumerate(robot.joints):
        body = real.bodies[i]
        model.inertias[joint.pin_id] = pin.Inertia(body.mass, body.com, body.inertia)
        numbers = {
            "K": real.stiffness[i],
            "D": real.damping[i],
            "B": real.motor_inertia[i],
            "D_m": real.motor_damping[i],
        }
        joints.append(replace(joint, drive=replace(joint.drive, **numbers)))
    return replace(robot, model=model, joints=tuple(joints))


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("excitation", ["rich", "steps"])
@pytest.mark.parametrize("name", ["lever", "crane", "scara", "gimbal"])
def test_columns_say_what_they_change(name: str, excitation: str, sensors: str) -> None:
    case = Case(name, excitation, 31, inexact=OFF)
    whole = as_recording(case.with_causes())
    kept = {key: x for key, x in whole.columns.items() if key[0] in SENSORS[sensors]}
    recording = replace(whole, columns=kept)
    # about links where the likely numbers put them: what is left is of second order in the distance
    problem = about_likely_links(Problem(balances_of(nominal(name), recording)))
    true = balances_of(recorded_machine(case), recording)

    # of signals without noise, whose share changes with the numbers as well
    here, there = (b.denoised.residual(problem.nominal) for b in (problem.balances, true))
    change = problem.whitening.apply(here - there).ravel()
    left = problem.rest(change)

    assert np.mean(change**2) > 1.0  # in the noise's variance
    assert np.mean(left**2) < 0.01
