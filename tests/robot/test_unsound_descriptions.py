"""Descriptions that lie: refused in words, or named in a warning, and never taken for another robot."""

# ruff: noqa: E501  (tables of what was changed, one case a line)
from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import yaml
from support.robots.robot_files import MJCF, URDF, content

from flexjoint.core.errors import RobotError, RobotWarning
from flexjoint.core.messages import LONGEST_LINE, one_line
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot

LIMIT = '<limit lower="-1" upper="1" effort="35" velocity="9"/>'
INERTIA = 'ixx="0.02" iyy="0.02" izz="0.02"'
ORIGIN = 'xyz="0 0 -0.4"'
UPPER = '<body name="upper">'
END = "</worldbody>"


def urdf(folder: Path, text: str) -> Path:
    (folder / "arm2.urdf").write_text(text)
    path = folder / "arm2.yaml"
    path.write_text(yaml.safe_dump(content(lock=["wrist"])))
    return path


def mjcf(folder: Path, text: str) -> Path:
    (folder / "arm2.xml").write_text(text)
    path = folder / "arm2.yaml"
    path.write_text(yaml.safe_dump(content(urdf=None, mjcf="arm2.xml")))
    return path


def refused(path: Path, said: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RobotError) as error:
        robot.load(path)
    line = one_line(error.value)
    assert said in line and len(line) <= LONGEST_LINE, line
    assert capfd.readouterr() == ("", "")  # the parser's own lines do not come before ours


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        *[
            ('mass value="2"', f'mass value="{number}"', f"link upper: mass value: expected a number with a decimal point, got '{number}'")
            for number in ("1,5", "nan", "inf", "0x10", "1_0", "one")
        ],
        ('mass value="2"', 'mass value=""', "mass value: expected 1 numbers, got ''"),
        ('mass value="2"', 'mass value="-1"', "link upper: mass -1 kg is negative"),
        ('mass value="2"', 'mass value="1e300"', "1e300 is beyond 1e+12"),
        ('<mass value="2"/>', "", "link upper: its inertial has no mass"),
        (INERTIA, 'ixx="-1" iyy="-1" izz="0.1"', "link upper: its inertia is negative"),
        (INERTIA, 'ixx="nan" iyy="1" izz="1"', "inertia ixx: expected a number"),
        (INERTIA, 'ixx="1" iyy="1"', "link upper: its inertia lacks izz"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "joint shoulder: its axis is zero"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', "axis xyz: expected 3 numbers, got '0 1'"),
        (ORIGIN, 'xyz="0 0 -1e300"', "joint elbow: origin xyz: -1e300 is beyond"),
        ('lower="-2"', 'lower="nan"', "joint elbow: limit lower: expected a number"),
        ('type="revolute"', 'type="revolut"', "joint elbow: type 'revolut', expected one of revolute"),
        ('<limit lower="-2" upper="2" effort="35" velocity="9"/>', "", "REVOLUTE but it does not specify limits"),
        ("</robot>", '<joint name="x" type="fixed"><parent link="base"/><child link="lower"/></joint></robot>', "link lower hangs on joints elbow and x: loops are not modelled"),
        ('<parent link="base"/>', '<parent link="hand"/>', "the joints form a loop; open it"),
        ('<child link="hand"/>', '<child link="hnd"/>', "joint wrist has link 'hnd', which there is not as its child"),
        ('<link name="base"/>', '<link name="base"/><link name="b2"/>', "a robot has one root"),
        ('joint name="wrist"', 'joint name="elbow"', "joint 'elbow' stands twice"),
        ('link name="hand"', 'link name="lower"', "link 'lower' stands twice"),
        ('<robot name="arm2">', '<robot name="arm2" xmlns:xacro="http://ros.org/xacro"><xacro:property name="a"/>', "of xacro; run xacro on it first"),
        ('link name="hand"', 'link name="h\x9band"', "control characters"),
        ('<robot name="arm2">', '<!DOCTYPE r [<!ENTITY a "a">]><robot name="arm2">', "may define entities"),
        ('<robot name="arm2">', "<robot " + " ".join(f'a{k}="1"' for k in range(100_000)) + ">", "more than 100 attributes of <robot>"),
        ("</robot>", "<x/>" * 200_000 + "</robot>", "more than 100000 elements"),
        ("</robot>", "<x>" * 100_000 + "</x>" * 100_000 + "</robot>", "more than 200 levels"),
        ("</robot>", "".join(f'<link name="l{k}"/>' for k in range(10_000)) + "</robot>", "10004 links, expected at most 1000"),
        ('name="arm2"', f'name="{"a" * 100_000}"', "name has 100000 characters, expected at most 10000"),
    ],
)  # fmt: skip
def test_a_urdf_that_lies_is_refused(
    tmp_path: Path, old: str, new: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert old in URDF
    refused(urdf(tmp_path, URDF.replace(old, new, 1)), said, capfd)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        *[(UPPER, f'<body name="upper" {key}="nope">', f"has {key} 'nope', which no <default> defines") for key in ("childclass", "class")],
        (UPPER, '<body name="upper" childclass="main">', "has childclass 'main', which no <default> defines; name the first one main"),
        *[
            (END, f"<{tag}><body><inertial pos='0 0 0' mass='1'/></body></{tag}>{END}", f"<{tag}> is not read, and its bodies would be missing; save it whole")
            for tag in ("include", "replicate", "frame", "attach", "composite", "flexcomp")
        ],
        (END, f"<foo/>{END}", "<foo> within a body is not read"),
        ("</mujoco>", '<equality><connect body1="upper" body2="lower" anchor="0 0 0"/></equality></mujoco>', "equality <connect> ties bodies, which is not modelled"),
        ('mass="2"', 'mass="1,5"', "inertial: mass: expected a number with a decimal point, got '1,5'"),
        ('mass="2"', 'mass="nan"', "expected a number"),
        ('mass="2"', 'mass="-2"', "mass -2 is negative"),
        ('mass="2"', "", "body upper: its inertial has no mass"),
        ('diaginertia="0.02 0.02 0.02"', 'diaginertia="-1 -1 -1"', "body upper: its inertia is negative"),
        ('axis="0 1 0"', 'axis="0 0 0"', "joint shoulder: its axis is zero"),
        ('pos="0 0 -0.4"', 'pos="0 0 -0.4" quat="0 0 0 0"', "body lower: its quat is zero"),
        ('name="elbow"', 'name="shoulder"', "joint 'shoulder' stands twice"),
        ('type="hinge"', 'type="hing"', "Unknown joint type"),
        (END, f'<geom type="box" size="0.1"/>{END}', "size '0.1': expected 3 numbers"),
        (END, f'<geom size="-1"/>{END}', "size '-1': expected 1 numbers, none below 0"),
        (END, "<body>" * 20_000 + "</body>" * 20_000 + END, "more than 200 levels"),
        (END, "<body/>" * 5_000 + END, "5002 bodies, expected at most 1000"),
        ("<worldbody>", '<compiler eulerseq="qqq"/><worldbody>', "euler sequence is wrong"),
    ],
)  # fmt: skip
def test_an_mjcf_that_lies_is_refused(
    tmp_path: Path, old: str, new: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text = MJCF.format(free="")
    assert old in text
    refused(mjcf(tmp_path, text.replace(old, new, 1)), said, capfd)


def test_an_equality_that_is_switched_off_ties_nothing(tmp_path: Path) -> None:
    tie = '<equality><joint active="false" joint1="elbow" joint2="shoulder"/></equality></mujoco>'
    assert robot.load(mjcf(tmp_path, MJCF.format(free="").replace("</mujoco>", tie))).joint_names


def loaded(path: Path) -> tuple[Robot, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return robot.load(path), [str(item.message) for item in caught if item.category is RobotWarning]


@pytest.mark.parametrize(
    ("moments", "odd"),
    [
        ("0.02 0.02 0.02", False),
        ("0.05 0.05 0.02", False),
        ("0.05 0.03 0.02", False),  # a flat body
        ("0.05 0.03 0.0199", False),  # rounded
        ("0.05 0.03 0.01", True),
        ("0.05 0.05 -0.01", True),
        ("1e-9 0 0", False),  # no motion shows it
    ],
)
def test_an_inertia_that_no_body_has_is_named(tmp_path: Path, moments: str, odd: bool) -> None:
    """As robots in use have them (Romeo, PR2): they are simulated as they stand."""
    x, y, z = moments.split()
    _, said = loaded(urdf(tmp_path, URDF.replace(INERTIA, f'ixx="{x}" iyy="{y}" izz="{z}"', 1)))
    assert bool(said) is odd
    assert all("no body has the inertia of upper" in line for line in said)


def test_a_mass_that_is_to_come_from_a_mesh_is_named(tmp_path: Path) -> None:
    text = MJCF.format(free="").replace(END, '<body name="cover"><geom type="mesh" mesh="m"/></body>' + END)
    _, said = loaded(mjcf(tmp_path, text))
    assert len(said) == 1 and "body cover has its mass from a mesh, which is not read" in said[0]


def test_a_mimic_joint_that_is_locked_is_no_matter(tmp_path: Path) -> None:
    text = URDF.replace(LIMIT, f'{LIMIT}<mimic joint="elbow"/>')
    assert loaded(urdf(tmp_path, text))[1] == []


def test_a_mimic_joint_that_the_robot_file_drives_moves_on_its_own(tmp_path: Path) -> None:
    tied = URDF.replace(
        'name="elbow" type="revolute">', 'name="elbow" type="revolute"><mimic joint="shoulder"/>'
    )
    arm, said = loaded(urdf(tmp_path, tied))
    assert "elbow" in arm.joint_names and len(said) == 1
    assert "joint elbow follows shoulder" in said[0] and "moves on its own" in said[0]


def test_a_mimic_joint_that_the_robot_file_does_not_name_is_held(tmp_path: Path) -> None:
    path = urdf(tmp_path, URDF.replace(LIMIT, f'{LIMIT}<mimic joint="elbow"/>'))
    path.write_text(yaml.safe_dump(content()))  # without its lock
    arm, said = loaded(path)
    assert arm.file.lock == ("wrist",) and not arm.model.existJointName("wrist")
    assert len(said) == 1 and "joint wrist follows elbow" in said[0] and "held at 0" in said[0]


def test_of_a_description_alone_mimic_joints_are_held(tmp_path: Path) -> None:
    """And the robot file that is written of it says so."""
    path = tmp_path / "arm2.urdf"
    path.write_text(URDF.replace(LIMIT, f'{LIMIT}<mimic joint="elbow"/>'))
    arm, said = loaded(path)
    assert len(said) == 1 and "joint wrist follows elbow" in said[0] and "held at 0, mass kept" in said[0]
    assert arm.joint_names == ("shoulder", "elbow") and arm.mass == pytest.approx(3.5)
    arm.write(tmp_path / "again.yaml")
    again, said = loaded(tmp_path / "again.yaml")
    assert again.file.lock == ("wrist",) and not said
    with pytest.raises(RobotError, match=r"joint wrist follows elbow .* do not actuate it"):
        robot.load(path, joints=["wrist"])


def test_an_inertia_that_a_joint_cannot_have_is_refused(tmp_path: Path) -> None:
    """Each link might pass alone: about the joint's axis the moment is negative."""
    text = URDF.replace(INERTIA, 'ixx="5" iyy="-3" izz="3"').replace('mass value="2"', 'mass value="0"')
    with (
        pytest.warns(RobotWarning),
        pytest.raises(RobotError, match=r"joint shoulder moves an inertia of -.*, which is negative"),
    ):
        robot.load(urdf(tmp_path, text))


def test_every_description_of_example_robot_data_is_read() -> None:
    """The limits are beyond what robots in use have."""
    share = robot.robot_description.example_robot_data()
    found = [path for path in sorted(share.rglob("*.urdf")) if path.stat().st_size > 1000]
    assert len(found) > 60
    for path in found:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotWarning)
            file = robot.schema.RobotFile.model_construct(urdf=path.name)
            description = robot.robot_description.read(file, path)
            assert robot.robot_description.model(description, False).njoints >= 1
