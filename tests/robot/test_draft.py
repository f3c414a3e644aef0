"""The first robot file of a description: what is read, what is marked, and that it loads."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.robots.robot_files import MJCF, URDF

from flexjoint.core.errors import FlexJointError, RobotError
from flexjoint.robot import robot
from flexjoint.robot.draft import CHECK, TOLERANCE, Seen, draft
from flexjoint.robot.robot import shipped_robots

DYNAMICS = '<limit lower="-2" upper="2" effort="35" velocity="9"/><dynamics damping="0.7" friction="0.3"/>'


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm2.urdf"
    path.write_text(URDF)
    return path


def test_a_urdf_becomes_a_rigid_robot_with_what_it_states(tmp_path: Path, urdf: Path) -> None:
    urdf.write_text(URDF.replace('<limit lower="-2" upper="2" effort="35" velocity="9"/>', DYNAMICS))
    out = tmp_path / "arm.yaml"
    made = draft(str(urdf), out)
    out.write_text(made.text)
    loaded = robot.load(out)
    assert loaded.joint_names == ("shoulder", "elbow", "wrist") and loaded.mass == pytest.approx(3.5)
    elbow = loaded.joint("elbow")
    assert elbow.rigid and elbow.torque_limit == 35.0 and elbow.drive.D_m == 0.7 and elbow.drive.B == 0.0
    (friction,) = loaded.effects
    assert (friction.effect.name, friction.joint, friction.nominal) == (
        "motor_coulomb_friction",
        "elbow",
        True,
    )
    assert friction.p.level == 0.3
    assert loaded.tolerance.model_dump(exclude_none=True) == {key: value for key, value, _ in TOLERANCE}
    assert math.isinf(loaded.joint("shoulder").torque_limit)  # continuous, without a limit
    assert "no torque limit of shoulder" in "\n".join(made.notes)


def test_every_number_that_is_not_known_is_marked_with_where_to_find_it(tmp_path: Path, urdf: Path) -> None:
    text = draft(str(urdf), tmp_path / "arm.yaml").text
    marked = [line for line in text.splitlines() if CHECK in line]
    for joint in ("shoulder", "elbow", "wrist"):
        own = text.split(f"\n  {joint}:\n")[1].split("\n  ")[0]
        for key in ("motor_inertia: 0", "motor_damping: 0", "# gear_ratio", "# torque_constant"):
            (line,) = (line for line in text.split(f"\n  {joint}:\n")[1].splitlines()[:6] if key in line)
            assert CHECK in line, own
    assert any("torque_limit" in line for line in marked)  # the shoulder's
    assert sum("gravity" in line or "control:" in line for line in marked) == 2
    assert all(len(line) <= 120 for line in text.splitlines())


def test_comments_tell_of_springs_unless_all_is_rigid(tmp_path: Path, urdf: Path) -> None:
    assert "series spring" in draft(str(urdf), tmp_path / "arm.yaml").text
    assert "spring" not in draft(str(urdf), tmp_path / "arm.yaml", springs=False).text.split("joints:")[1]


def test_an_mjcf_gives_its_armature_and_it_counts_once(tmp_path: Path) -> None:
    path = tmp_path / "arm2.xml"
    joint = '<joint name="elbow" type="hinge" axis="0 1 0"'
    path.write_text(
        MJCF.format(free="").replace(joint, f'{joint} armature="0.25" damping="0.7" frictionloss="0.3"')
    )
    out = tmp_path / "arm2.yaml"
    out.write_text(draft(str(path), out).text)
    loaded = robot.load(out)
    elbow = loaded.joint("elbow")
    assert (elbow.drive.B, elbow.drive.D_m) == (0.25, 0.7) and loaded.effects[0].p.level == 0.3
    assert loaded.model.armature[elbow.idx_v] == 0.0  # else the rotor would be there twice
    bare = robot.load(str(path), joints=["elbow"])
    assert bare.model.armature[bare.joint("elbow").idx_v] == 0.25  # nobody states a motor_inertia


def test_a_floating_base_and_joints_of_several_axes(tmp_path: Path) -> None:
    path = tmp_path / "arm2.xml"
    text = MJCF.format(free='<freejoint name="root"/>')
    path.write_text(text.replace('<joint name="shoulder" type="hinge" axis="0 1 0"/>', ""))
    made = draft(str(path), tmp_path / "arm2.yaml")
    assert made.robot.floating and made.robot.joint_names == ("elbow",)
    path.write_text(
        MJCF.format(free="").replace('"shoulder" type="hinge" axis="0 1 0"', '"ball" type="ball"')
    )
    made = draft(str(path), tmp_path / "arm2.yaml")
    assert "  - ball  # 3 degrees of freedom: only single-axis joints can be actuated" in made.text


def test_mimicking_joints_are_held(tmp_path: Path) -> None:
    panda = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    made = draft(panda, tmp_path / "panda.yaml")
    assert yaml.safe_load(made.text)["lock"] == ["panda_finger_joint2"]
    assert "kg, CHECK" in made.text and "N s/m" in made.text  # of the finger, which slides
    assert yaml.safe_load(made.text)["urdf"] == panda


def test_a_recording_fills_in_what_it_shows(tmp_path: Path, urdf: Path) -> None:
    seen = Seen("monday.csv", 2000.0, {"shoulder": ("q", "theta", "current"), "elbow": ("theta",)})
    made = draft(str(urdf), tmp_path / "arm.yaml", seen)
    raw = yaml.safe_load(made.text)
    assert raw["rates"] == {"physics": 2000, "control": 2000} and raw["lock"] == ["wrist"]
    assert raw["offsets"] == "per_recording" and list(raw["joints"]) == ["shoulder", "elbow"]
    assert "both encoders are recorded" in made.text and "needed for the recorded currents" in made.text
    with pytest.raises(FlexJointError, match="unknown joint 'hip'; valid: elbow, shoulder, wrist"):
        draft(str(urdf), tmp_path / "arm.yaml", Seen("m.csv", 250.0, {"hip": ("q",)}))


def test_it_resolves_from_wherever_it_is_written(tmp_path: Path, urdf: Path) -> None:
    out = tmp_path / "deep" / "er" / "arm.yaml"
    text = draft(str(urdf), out).text
    assert yaml.safe_load(text)["urdf"] == "../../arm2.urdf"
    out.parent.mkdir(parents=True)
    out.write_text(text)
    assert robot.load(out).joint_names == ("shoulder", "elbow", "wrist")


@pytest.mark.parametrize("name", ["yes", "1", "a: b", "ä#", "- x", "null", "q'\"{", "1e3"])
def test_whatever_joints_are_called_the_file_loads(tmp_path: Path, urdf: Path, name: str) -> None:
    from xml.sax.saxutils import quoteattr

    urdf.write_text(URDF.replace('"elbow"', quoteattr(name)))
    out = tmp_path / "arm.yaml"
    made = draft(str(urdf), out, Seen("m.csv", 250.0, {"shoulder": ("q",), "wrist": ("q",)}))
    assert yaml.safe_load(made.text)["lock"] == [name]
    out.write_text(draft(str(urdf), out).text)
    assert name in robot.load(out).joint_names


def test_a_body_without_inertia_is_told(tmp_path: Path, urdf: Path) -> None:
    text = URDF.replace('ixx="0.02" iyy="0.02" izz="0.02"', 'ixx="0" iyy="0" izz="0"').replace(
        "0 0 -0.05", "0 0 0"
    )
    urdf.write_text(text)
    made = draft(str(urdf), tmp_path / "arm.yaml")
    assert "nothing resists the torque of wrist" in "\n".join(made.notes)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("nowhere.urdf", "does not exist; give the path of a URDF, MJCF or SDF"),
        ("robot.yaml", "expected a URDF, MJCF or SDF"),
        ("package://nothing/x.urdf", "not found under"),
    ],
)
def test_what_is_no_description_is_refused(tmp_path: Path, source: str, said: str) -> None:
    with pytest.raises(RobotError, match=said) as error:
        draft(source, tmp_path / "arm.yaml")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", sorted(shipped_robots()))
def test_the_descriptions_of_shipped_robots_make_drafts(tmp_path: Path, name: str) -> None:
    shipped = robot.load(shipped_robots()[name])
    assert shipped.urdf is not None
    out = tmp_path / "draft.yaml"
    out.write_text(draft(str(shipped.urdf), out).text)
    loaded = robot.load(out)
    assert set(shipped.joint_names) <= set(loaded.joint_names) and all(j.rigid for j in loaded.joints)
    if name in ("kr300", "tx40"):
        assert np.array_equal(shipped.model.lowerPositionLimit, loaded.model.lowerPositionLimit)


def test_small_numbers_are_numbers_to_yaml(tmp_path: Path) -> None:
    path, out = tmp_path / "arm2.xml", tmp_path / "arm2.yaml"
    joint = '<joint name="elbow" type="hinge" axis="0 1 0"'
    path.write_text(
        MJCF.format(free="").replace(joint, f'{joint} armature="6e-05" damping="7e-6" frictionloss="3e-05"')
    )
    out.write_text(draft(str(path), out).text)
    loaded = robot.load(out)
    elbow = loaded.joint("elbow")
    assert (elbow.drive.B, elbow.drive.D_m, loaded.effects[0].p.level) == (6e-05, 7e-06, 3e-05)


EXPORTED = MJCF.format(free="").replace(
    "</worldbody>",
    """<body name="rotor.elbow"><joint name="rotor.elbow" armature="0.1" damping="2"/>
  <inertial pos="0 0 0" mass="1e-12" diaginertia="1e-12 1e-12 1e-12"/></body></worldbody>
<custom><text name="written_by" data="flexjoint export"/></custom>
<tendon><fixed name="spring.elbow" stiffness="260" damping="0.7"><joint joint="rotor.elbow" coef="1"/>
  <joint joint="elbow" coef="-1"/></fixed></tendon>
<actuator><general name="elbow" joint="rotor.elbow" gainprm="1.1"/></actuator>""",
)


def test_an_exported_mjcf_gives_springs_and_effects(tmp_path: Path) -> None:
    path, out = tmp_path / "arm2.xml", tmp_path / "arm2.yaml"
    path.write_text(EXPORTED)
    made = draft(str(path), out)
    out.write_text(made.text)
    loaded = robot.load(out)
    assert loaded.joint_names == ("elbow",) and loaded.model.existJointName("shoulder")  # which is passive
    drive = loaded.joint("elbow").drive
    assert (drive.K, drive.D, drive.B, drive.D_m) == (260.0, 0.7, 0.1, 2.0)
    (gain,) = loaded.effects
    assert (gain.effect.name, gain.p.gain) == ("torque_gain", pytest.approx(0.1))
    path.write_text(EXPORTED.replace("written_by", "note"))  # of any other file a gain may be anything
    assert "stiffness: .inf" in draft(str(path), out).text


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('stiffness="260"', 'stiffness="1,5"', "expected a number"),
        ('stiffness="260"', 'stiffness="0"', "stiffness"),
        ('gainprm="1.1"', 'gainprm="nan"', "expected a number"),
        ('general name="elbow"', 'general name="wrist"', "'wrist' has no joint of its name"),
        ('general name="elbow"', 'general name="rotor.elbow"', "expected at least one joint"),
        ('armature="0.1"', "", "needs its inertia"),
        ('stiffness="260"', 'range="0 1" solreflimit="-5"', "expected 2 numbers"),
    ],
)
def test_an_exported_mjcf_that_was_edited_is_refused_in_one_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = tmp_path / "arm2.xml"
    path.write_text(EXPORTED.replace(old, new))
    with pytest.raises(FlexJointError, match=said) as caught:
        draft(str(path), tmp_path / "arm2.yaml")
    assert "\n" not in str(caught.value)


ARM3 = """<mujoco>
  <default class="main">
    <general forcerange="-12 12"/>
    <default class="big">
      <general forcerange="-87 87"/>
      <joint actuatorfrcrange="-50 50"/>
      <default class="geared"><motor ctrlrange="-1.5 1.5" gear="20"/></default>
    </default>
  </default>
  <worldbody><body name="a" childclass="big"><joint name="one"/><geom size="0.1" mass="1"/>
    <body name="b"><joint name="two" class="main"/><geom size="0.1" mass="1"/>
      <body name="c"><joint name="three" class="main"/><geom size="0.1" mass="1"/>
        <body name="d"><joint name="four" class="main"/><geom size="0.1" mass="1"/>
  </body></body></body></body></worldbody>
  <actuator>
    <position joint="one" class="big" kp="100"/>
    <motor joint="two" class="geared"/>
    <position joint="three" kp="100"/>
    <velocity joint="four" forcelimited="false"/>
  </actuator>
</mujoco>"""


def test_an_mjcf_limits_its_joints_by_their_actuators_and_classes(tmp_path: Path) -> None:
    """One: 87 of the actuator's class and 50 of the joint's. Two: 1.5 of control and 87 of force, times 20.
    Three: 12 of the default of all actuators. Four: its limit is off."""
    (tmp_path / "arm3.xml").write_text(ARM3)
    made = draft(str(tmp_path / "arm3.xml"), tmp_path / "arm3.yaml")
    limits = {joint.name: joint.torque_limit for joint in made.robot.joints}
    assert limits == {"one": 50.0, "two": 30.0, "three": 12.0, "four": math.inf}
    assert "no torque limit of four" in made.notes


def test_the_limits_of_an_mjcf_are_those_that_mujoco_keeps(tmp_path: Path) -> None:
    """Full commands at rest: the torque at each joint is the limit."""
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    (tmp_path / "arm3.xml").write_text(ARM3)
    made = draft(str(tmp_path / "arm3.xml"), tmp_path / "arm3.yaml")
    model = mujoco.MjModel.from_xml_string(ARM3)
    data = mujoco.MjData(model)
    data.ctrl[:] = 1e6
    mujoco.mj_forward(model, data)
    found = [joint.torque_limit for joint in made.robot.joints]
    np.testing.assert_allclose(data.qfrc_actuator[:3], found[:3], rtol=1e-12)


def test_a_limit_of_an_mjcf_that_is_no_number_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm3.xml").write_text(ARM3.replace('"-12 12"', '"-12 much"'))
    with pytest.raises(RobotError, match="forcerange: expected a number with a decimal point, got 'much'"):
        draft(str(tmp_path / "arm3.xml"), tmp_path / "arm3.yaml")
