"""Descriptions beside URDF, sections and presets of a user's own robot, and what is said about wrong ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from support.robots.robot_files import JOINT, MJCF, file

from flexjoint.core.errors import FlexJointError, RobotError
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot import robot

ROOT = Path(__file__).parents[2]


def mjcf(folder: Path, free: str = "", **changes: Any) -> Path:
    text = MJCF.format(free=free)
    if free:  # MuJoCo wants a free joint alone on its body
        text = text.replace('<joint name="shoulder" type="hinge" axis="0 1 0"/>', "")
    (folder / "arm2.xml").write_text(text)
    return file(folder, urdf=None, mjcf="arm2.xml", **changes)


def test_an_mjcf_is_the_robot_of_the_same_urdf(tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "u").mkdir()
    from_mjcf = robot.load(mjcf(tmp_path / "m"))
    # the URDF's hand, 0.5 kg at (0, 0, -0.35), is in the MJCF's lower body: 1.5 kg at -0.1833 when locked
    assert from_mjcf.joint_names == ("shoulder", "elbow") and from_mjcf.mass == pytest.approx(3.5)
    urdf = robot.load(file(tmp_path / "u", lock=["wrist"]))
    q = np.array([0.3, 0.0])
    torque = [pin.computeGeneralizedGravity(r.model, r.model.createData(), q)[0] for r in (from_mjcf, urdf)]
    # by hand: 9.81 sin(0.3) (2 * 0.2 + 1.5 * 0.5) and 9.81 sin(0.3) (2 * 0.2 + 1 * 0.5 + 0.5 * 0.75)
    lever = 9.81 * np.sin(0.3)
    assert torque[0] == pytest.approx(lever * 1.15, rel=1e-9)
    assert torque[1] == pytest.approx(lever * 1.275, rel=1e-9)
    state = FlexibleJointModel(from_mjcf).rest(q)
    assert np.all(np.isfinite(FlexibleJointModel(from_mjcf).rates(state, np.zeros(2), 1e-3).acc))


def test_a_free_joint_of_an_mjcf_floats(tmp_path: Path) -> None:
    joints = {"elbow": dict(JOINT)}
    loaded = robot.load(mjcf(tmp_path, '<freejoint name="root"/>', base="floating", joints=joints))
    assert loaded.model.nv == 7 and loaded.floating
    with pytest.raises(RobotError, match="has a free joint; write base: floating"):
        robot.load(mjcf(tmp_path, '<freejoint name="root"/>', joints=joints))


def test_an_mjcf_without_a_free_joint_does_not_float(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="has no free joint; write base: fixed, or give its first body a"):
        robot.load(mjcf(tmp_path, base="floating"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"urdf": None}, "expected one of urdf, mjcf and sdf, the robot's description; got none of them"),
        ({"mjcf": "arm2.xml"}, "got urdf and mjcf"),
        ({"urdf": "arm2.xml"}, "whose root element is <mujoco>; call the key `mjcf`"),
        ({"urdf": None, "mjcf": "arm2.urdf"}, "root element is <robot>; call the key `urdf`"),
        ({"urdf": None, "mjcf": "none.xml"}, "MJCF .*none.xml does not exist; `mjcf` is relative"),
        ({"urdf": "other.txt"}, "root element is <html>; expected <robot>"),
        ({"continuous": ["ankle"]}, "continuous: unknown joint 'ankle'; valid: elbow, shoulder, wrist"),
        ({"urdf": None, "mjcf": "arm2.xml", "continuous": ["elbow"]}, "`continuous` needs a URDF"),
        (
            {"urdf": None, "mjcf": "arm2.xml", "sections": {"arm": {"roots": ["elbow"]}}},
            "sections need a URDF",
        ),
        (
            {"sections": {"arm": {"root": ["elbow"]}}},
            "in sections.arm: unknown key 'root' .did you mean 'roots'",
        ),
        ({"sections": {"a": {"roots": ["elbow"], "parts": {"b": ["wrist"]}}}}, "has both roots and parts"),
        ({"presets": {"soft": {"joint": {}}}}, "in presets.soft: unknown key 'joint' .did you mean 'joints'"),
        ({"spawn": ["legs"], "sections": {"arm": {}}}, "unknown section 'legs'; valid: arm"),
    ],
)
def test_a_wrong_description_or_choice_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    (tmp_path / "arm2.xml").write_text(MJCF.format(free=""))
    (tmp_path / "other.txt").write_text("<html/>")
    with pytest.raises(FlexJointError, match=said) as error:
        robot.load(file(tmp_path, **changes))
    assert "\n" not in str(error.value)


def test_presets_of_a_users_robot(tmp_path: Path) -> None:
    path = file(
        tmp_path, presets={"soft": {"joints": {"elbow": {"stiffness": 9}}, "rates": {"control": 500}}}
    )
    soft = robot.load(path, preset="soft")
    assert soft.joint("elbow").drive.K == 9 and soft.joint("shoulder").drive.K == 260
    assert (soft.rates.control, soft.rates.physics) == (500, 1000)
    for preset, said in (("hard", "unknown preset 'hard'; valid: soft"),):
        with pytest.raises(RobotError, match=said):
            robot.load(path, preset=preset)
    path = file(tmp_path, presets={"soft": {"joints": {"elbow": {"stiffness": -9}, "wrist": {}}}})
    with pytest.raises(RobotError, match="preset soft: unknown joint 'wrist'; valid: elbow, shoulder"):
        robot.load(path, preset="soft")


def test_spawn_leaves_sections_out_and_what_belongs_to_them(tmp_path: Path) -> None:
    sections = {"upper": {"roots": ["shoulder"]}, "lower": {"roots": ["elbow"]}}
    gap = {"effect": "backlash", "joint": "elbow", "gap": 0.01}
    path = file(
        tmp_path, sections=sections, spawn=["upper"], effects=[gap], lock=["wrist"], initial={"wrist": 1}
    )
    loaded = robot.load(path)
    assert loaded.joint_names == ("shoulder",) and loaded.effects == () and loaded.mass == 2.0
    assert robot.load(path, sections=["upper", "lower"]).mass == 3.5  # what is asked for goes first


def test_the_walker_of_the_page_is_a_robot(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "reference" / "robots.md").read_text(encoding="utf-8")
    (tmp_path / "walker.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    whole = robot.load(tmp_path / "walker.yaml")
    assert whole.floating and whole.joint_names == ("LF_HAA", "LF_HFE")
    assert whole.configuration("crouch")[whole.joint("LF_HFE").idx_q] == 1.0
    body = robot.load(tmp_path / "walker.yaml", sections=["body", "left_front"], preset="soft")
    assert body.floating and body.mass < whole.mass and body.joint("LF_HAA").drive.K == 800
    assert not robot.load(tmp_path / "walker.yaml", sections=["body"]).floating


def test_the_example_of_the_page_runs() -> None:
    text = (ROOT / "docs" / "reference" / "robots.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    blocks = [block.split("```")[0] for block in text.split("```python\n")[1:]]
    exec(next(block for block in blocks if "centauro" in block), names)
    assert len(names["upper"].joints) == 15 and names["upper"].preset == "soft"
    assert not names["standing"].floating and names["spider"].shape == (39,)


def test_no_path_of_a_machine_stands_in_a_written_file(tmp_path: Path) -> None:
    robot.write(robot.load("panda"), tmp_path / "panda.yaml")
    written = yaml.safe_load((tmp_path / "panda.yaml").read_text())
    assert written["urdf"].startswith("package://example-robot-data/robots/")
