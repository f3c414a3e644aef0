"""CENTAURO's joints reach the speeds of its URDF within their torque."""

from __future__ import annotations

import numpy as np
import pytest

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.robot.robot import load
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.simulate import simulate

# what the motor's damping takes of the torque limit at the URDF's speed: robots/centauro/README.md
SHARES = {
    "hip_yaw_1": 0.038,
    "hip_pitch_1": 0.043,
    "knee_pitch_1": 0.043,
    "ankle_pitch_1": 0.072,
    "ankle_yaw_1": 0.050,
    "j_wheel_1": 0.050,
    "torso_yaw": 0.051,
    "j_arm1_1": 0.034,
    "j_arm1_2": 0.034,
    "j_arm1_3": 0.021,
    "j_arm1_4": 0.021,
    "j_arm1_5": 0.043,
    "j_arm1_6": 0.043,
    "velodyne_joint": 0.014,
}
ROBOT = load("centauro", grounded=True)
SPEED_UP = 0.4  # of the way from one end of the joint to the other; so much again to slow down
WAY = 6.0  # rad at most, of joints that turn round and round


def speed_limit(name: str) -> float:
    return float(ROBOT.model.velocityLimit[ROBOT.joint(name).idx_v])


@pytest.mark.parametrize("preset", ["2017", "soft"])
def test_damping_takes_a_small_share_of_the_torque(preset: str) -> None:
    robot = load("centauro", preset=preset)
    for joint in robot.joints:
        name = joint.name.replace("arm2", "arm1").replace("d435_head", "velodyne")
        name = name if name in SHARES else name[:-1] + "1"  # legs and wheels 2 to 4
        share = joint.drive.D_m * robot.model.velocityLimit[joint.idx_v] / joint.torque_limit
        assert share == pytest.approx(SHARES[name], abs=5.1e-4), joint.name


@pytest.mark.parametrize("name", SHARES)
def test_a_joint_reaches_its_speed_within_its_torque(name: str) -> None:
    """From near one end of its range to the other: up to the URDF's speed on a quintic, along at it, and
    down; gravity on, all other joints held, by the motor PD with its gains and the speed as dtheta_ref."""
    joint, model = ROBOT.joint(name), ROBOT.model
    low, high = (float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    way = min(0.9 * (high - low), WAY)
    centre = 0.5 * (low + high) if high - low < 100.0 else 0.0
    speed = speed_limit(name)
    rise, along = 2.0 * SPEED_UP * way / speed, (1.0 - 2.0 * SPEED_UP) * way / speed
    time = np.arange(0.0, 0.1 + 2.0 * rise + along + 0.1, 1e-3)
    up = np.clip((time - 0.1) / rise, 0.0, 1.0)
    down = np.clip((time - 0.1 - rise - along) / rise, 0.0, 1.0)
    share = [s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in (up, down)]
    rate = speed * (share[0] - share[1])
    table = {("q_ref", other.name): np.full(len(time), at(other.name)) for other in ROBOT.joints}
    table["q_ref", name] = centre - 0.5 * way + np.cumsum(rate) * 1e-3
    table["dtheta_ref", name] = rate
    run = simulate(FlexibleJointModel(ROBOT), recording.make(time, table), RunOptions(engine="compiled"))
    assert np.max(np.abs(run.true.get("dq", name))) > 0.98 * speed
    assert np.max(np.abs(run.true.get("tau_m", name))) < joint.torque_limit


def at(name: str) -> float:
    return float(ROBOT.configuration()[ROBOT.joint(name).idx_q])
