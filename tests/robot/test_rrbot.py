"""RRBot: the URDF against hand-calculated figures, the two YAML files against docs/reference/formats.md."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

from flexjoint.robot.robot import load, robots_folder

FOLDER = robots_folder() / "rrbot"
GRAVITY = 9.81
NAMES = ("rrbot", "rrbot_last_joint")


def robot_file(name: str) -> dict[str, Any]:
    return yaml.safe_load((FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def model() -> pin.Model:
    """Both joints are continuous: pin stores each as (cos, sin)."""
    return pin.buildModelFromUrdf(str(FOLDER / "rrbot.urdf"))


def configuration(*angles: float) -> np.ndarray:
    return np.ravel([(np.cos(a), np.sin(a)) for a in angles])


def test_last_link_inertia_about_its_axis(model: pin.Model) -> None:
    # m (w^2 + h^2)/12 + m l^2 with m 1 kg, w 0.1 m, h 1 m, l 0.45 m
    expected = (0.1**2 + 1.0**2) / 12 + 0.45**2
    assert expected == pytest.approx(0.286667, abs=5e-7)
    mass = pin.crba(model, model.createData(), configuration(0.3, -0.7))
    assert mass[1, 1] == pytest.approx(expected, rel=1e-12)


def test_first_joint_carries_both_links(model: pin.Model) -> None:
    # Stretched: both links about themselves, link 3's centre 0.9 + 0.45 m from joint1's axis.
    expected = 2 * (0.1**2 + 1.0**2) / 12 + 0.45**2 + (0.9 + 0.45) ** 2
    mass = pin.crba(model, model.createData(), configuration(0.4, 0.0))
    assert mass[0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("q", [-2.0, -0.5, 0.0, 0.3, 1.0, 3.0])
def test_holding_torque_of_the_last_joint(model: pin.Model, q: float) -> None:
    # Upright is unstable: what holds it is -m g l sin q = -4.4145 sin q.
    gravity = pin.computeGeneralizedGravity(model, model.createData(), configuration(0.0, q))
    assert gravity[1] == pytest.approx(-4.4145 * np.sin(q), abs=1e-12)
    assert pytest.approx(4.4145) == 1.0 * GRAVITY * 0.45


def test_joint_frames(model: pin.Model) -> None:
    data = model.createData()
    pin.forwardKinematics(model, data, configuration(0.0, 0.0))
    assert data.oMi[1].translation == pytest.approx([0.0, 0.1, 1.95])
    assert data.oMi[2].translation == pytest.approx([0.0, 0.2, 2.85])


def test_limit_holds_the_arm_against_gravity(model: pin.Model) -> None:
    # Horizontal and stretched is the heaviest pose; the actuator must be able to hold it.
    gravity = pin.computeGeneralizedGravity(model, model.createData(), configuration(np.pi / 2, 0.0))
    for j, entry in enumerate(robot_file("rrbot")["joints"].values()):
        assert abs(gravity[j]) < entry["torque_limit"]


@pytest.mark.parametrize("name", NAMES)
def test_yaml_uses_only_names_of_the_format(name: str) -> None:
    file = robot_file(name)
    joint_keys = {"stiffness", "damping", "motor_inertia", "motor_damping", "torque_limit", "kp", "kd"}
    actuated = ["joint1", "joint2"] if name == "rrbot" else ["joint2"]
    assert file["name"] == name
    assert set(file) <= {
        *("name", "urdf", "base", "rates", "lock", "joints", "effects", "presets", "sources")
    }
    assert list(file["joints"]) == actuated
    assert all(set(entry) == joint_keys | {"gear_ratio"} for entry in file["joints"].values())
    assert [entry["joint"] for entry in file["effects"]] == actuated
    for entry in file["effects"]:
        assert entry == {
            "effect": "link_viscous_friction",
            "joint": entry["joint"],
            "coefficient": 0.7,
            "nominal": True,
        }
    for preset in file["presets"].values():
        assert list(preset["joints"]) == actuated
        assert all(set(entry) == {"stiffness", "damping"} for entry in preset["joints"].values())


def test_presets_hold_the_three_transmissions_of_section_5_1() -> None:
    joints = [preset["joints"]["joint2"] for preset in robot_file("rrbot_last_joint")["presets"].values()]
    assert [(j["stiffness"], j["damping"]) for j in joints] == [(100, 0.3), (188, 0.5), (500, 1.5)]


@pytest.mark.parametrize("name", NAMES)
def test_yaml_loads(name: str) -> None:
    robot = load(name)
    assert robot.joint_names == tuple(robot_file(name)["joints"])
    drive = robot.joint("joint2").drive
    assert (drive.K, drive.D, drive.B, drive.D_m) == (188, 0.5, 0.0742, 24.768)
    assert robot.model.nq == len(robot.joints)


def test_locked_joint_keeps_the_last_link_as_it_is() -> None:
    locked = load("rrbot_last_joint").model
    mass = pin.crba(locked, locked.createData(), np.array([0.4]))
    assert mass[0, 0] == pytest.approx(0.286667, abs=5e-7)
    gravity = pin.computeGeneralizedGravity(locked, locked.createData(), np.array([0.4]))
    assert gravity[0] == pytest.approx(-4.4145 * np.sin(0.4), abs=1e-12)
