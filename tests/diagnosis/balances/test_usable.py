"""Recordings that close no balance, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.coupled_robots import coupled

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.balances.usable import refusal
from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as make_recording


def recorded(torque: str | None) -> Recording:
    """The angles of a rigid arm that swings, and one channel of torques."""
    robot, time = coupled(None, rigid=True), np.arange(0.0, 4.0, 0.004)
    columns = {("q", name): 0.3 * np.sin((1.0 + k) * time) for k, name in enumerate(robot.joint_names)}
    if torque is not None:
        columns |= {(torque, name): np.cos(time) for name in robot.joint_names}
    return make_recording(time, columns)


def said(torque: str | None) -> str:
    return refusal(balances_of(coupled(None, rigid=True), recorded(torque)))


def test_angles_alone_close_no_balance() -> None:
    assert said(None).endswith("neither motor torques nor both encoders of a joint are recorded")


def test_torque_sensors_of_rigid_joints_ask_for_a_stiffness() -> None:
    text = said("tau_t")
    assert "tau_t of yaw" in text
    assert "stiffness" in text
    assert "tau_motor" in text


@pytest.mark.parametrize("torque", ["tau_m", "tau_motor"])
def test_motor_torques_close_the_balance(torque: str) -> None:
    assert said(torque) == ""
