"""Whitened balances of robots without link encoders: an error of one motor is an error of its own joint, so
that the level at which other joints are judged does not rise with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned

MOTORS = ("theta", "dtheta", "tau_m", "tau_cmd")


@pytest.mark.parametrize("channels", [MOTORS, (*MOTORS, "tau_t")], ids=["motors", "motors and springs"])
@pytest.mark.parametrize("name", ["crane", "scara", "gimbal", "reach"])
def test_a_motors_friction_is_an_error_of_its_own_joint(name: str, channels: tuple[str, ...]) -> None:
    recording = as_recording(Case(name, "rich", 31).with_causes())
    kept = {key: x for key, x in recording.columns.items() if key[0] in channels}
    problem = Problem(balances_of(nominal(name), replace(recording, columns=kept)))
    joints = np.array([row.joint for row in problem.balances.rows])

    for i, joint in enumerate(problem.robot.joint_names):
        friction = Planned.of("motor_coulomb_friction", joint, {"level": 0.1})
        energy = np.sum(problem.moved([], [friction]).reshape(len(joints), -1) ** 2, axis=1)

        # the rest is what the friction moves neighbours by, through the elastic joint: 2.9 % at most here; in
        # the order in which joints are listed up to all of it is elsewhere
        assert np.sum(energy[joints == i]) > 0.95 * np.sum(energy)
