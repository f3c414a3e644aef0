"""Couplings of motors in robot files: what is read, written and refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.robots.robot_files import JOINT, file

from flexjoint.core.errors import RobotError
from flexjoint.recording.readings.currents import with_torques
from flexjoint.recording.table import make
from flexjoint.robot import robot

BOTH = ["elbow", "shoulder"]
STATED = {"joints": BOTH, "matrix": [[1, 0], [2, 3]]}
RIGID = {"stiffness": float("inf"), "motor_inertia": 0.1}


def test_a_coupling_is_read_and_written(tmp_path: Path) -> None:
    loaded = robot.load(file(tmp_path, couplings=[STATED]))
    (coupling,) = loaded.couplings
    assert [loaded.joint_names[i] for i in coupling.joints] == BOTH
    assert coupling.matrix == ((1.0, 0.0), (2.0, 3.0))
    np.testing.assert_allclose(coupling.inverse @ np.array(coupling.matrix), np.eye(2), atol=1e-15)
    loaded.write(tmp_path / "again.yaml")
    assert robot.load(tmp_path / "again.yaml").couplings == loaded.couplings
    assert robot.load(file(tmp_path)).couplings == ()


@pytest.mark.parametrize(
    ("couplings", "said"),
    [
        ([{**STATED, "joints": ["elbow", "knee"]}], "unknown joint 'knee'; valid: elbow, shoulder"),
        ([{**STATED, "ratio": 1}], "unknown key 'ratio'; valid: joints, matrix"),
        ([{"joints": BOTH}], "couplings.0.matrix is missing"),
        ([{**STATED, "joints": ["elbow", "elbow"]}], "joint 'elbow' is listed twice"),
        ([STATED, STATED], "joint 'elbow' is listed twice; put all joints that move together into one"),
        ([{**STATED, "matrix": [[1, 0]]}], r"square matrix.*got 2 joints and rows of \[2\]"),
        ([{"joints": ["elbow"], "matrix": [[1]]}], "expected two joints or more"),
        ([{**STATED, "matrix": [[1, 2], [2, 4]]}], "expected a matrix that has an inverse"),
        ([{**STATED, "matrix": [[1, 0], [0, float("inf")]]}], "expected a matrix that has an inverse"),
        ({"joints": BOTH}, "couplings: "),
    ],
)
def test_a_bad_coupling_is_refused_in_words(tmp_path: Path, couplings: Any, said: str) -> None:
    with pytest.raises(RobotError, match=said) as error:
        robot.load(file(tmp_path, couplings=couplings))
    assert "\n" not in str(error.value) and len(str(error.value)) < 500


def test_joints_that_share_motors_are_all_rigid_or_all_flexible(tmp_path: Path) -> None:
    joints = {"shoulder": JOINT, "elbow": RIGID}
    with pytest.raises(RobotError, match="all rigid or all flexible; give each a stiffness"):
        robot.load(file(tmp_path, joints=joints, couplings=[STATED]))
    robot.load(file(tmp_path, joints={"shoulder": RIGID, "elbow": RIGID}, couplings=[STATED]))


def test_currents_of_shared_motors_become_torques_at_the_joints(tmp_path: Path) -> None:
    drive = {**RIGID, "gear_ratio": 50, "torque_constant": 0.1}
    loaded = robot.load(file(tmp_path, joints={"shoulder": drive, "elbow": drive}, couplings=[STATED]))
    time = np.arange(60) / 100.0
    columns = {("current", "elbow"): 1.0 + time, ("current", "shoulder"): 2.0 - time}
    made = with_torques(loaded, make(time, columns))
    # matrix' times 5 N m/A times the currents, of elbow and shoulder
    np.testing.assert_allclose(made.get("tau_motor", "elbow"), 5.0 * (1.0 + time) + 2.0 * 5.0 * (2.0 - time))
    np.testing.assert_allclose(made.get("tau_motor", "shoulder"), 3.0 * 5.0 * (2.0 - time))
    part = make(time, {("current", "elbow"): 1.0 + time, ("tau_motor", "shoulder"): time})
    with pytest.raises(Exception, match="shoulder has no current beside that of elbow"):
        with_torques(loaded, part)
