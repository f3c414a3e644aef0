"""Every target: its table, its file, what Pinocchio reads of it, and what it refuses."""

from __future__ import annotations

import math
import runpy
import sys
import types
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from support.pages import DOCS
from support.robots.arms import PLANAR, SPATIAL, make, one_of_each

import flexjoint as fj
from flexjoint.core.errors import FlexJointError, RobotError, UnknownNameError
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.export.base import NUMBERS, UNMAPPED, Level, Target
from flexjoint.export.targets import TARGETS, export_robot, exported, page
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.draft import draft
from flexjoint.robot.robot import Robot, load, shipped_robots


# --- the table ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_every_effect_and_number_has_a_row(target: Target) -> None:
    own = [name for name, e in catalogue().items() if not e.for_rigid]  # these are springs of their joints
    assert sorted(target.effects) == sorted(own), "add the new effect to the target's effects"
    assert set(target.numbers) <= set(NUMBERS)
    for way in (*map(target.of_effect, catalogue()), *map(target.of_number, NUMBERS)):
        assert way.how and way != UNMAPPED


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_an_effect_without_a_row_is_left_out_and_said(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    mapped = {name: way for name, way in type(target).effects.items() if name != "payload"}
    monkeypatch.setattr(type(target), "effects", mapped)
    arm = make(PLANAR)
    heavy = arm.extended([effect("payload", "knee", mass=3.0, position=(0.1, 0.0, 0.0))])
    done = exported(heavy, target.name)
    assert [(row.what, row.joint, row.way) for row in done.lost if row.joint] == [
        ("payload", "knee", UNMAPPED)
    ]
    body = done.text.split("-->")[-1].split("import")[-1]
    assert body == exported(arm, target.name).text.split("-->")[-1].split("import")[-1]


def test_the_page_is_fresh() -> None:
    text = (DOCS / "reference" / "exporting.md").read_text(encoding="utf-8")
    assert text == page(text), "run: make docs"


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_the_account_stands_in_the_file(target: Target) -> None:
    """Of a robot with every effect at once, on joints with a spring and without."""
    arm = make(PLANAR, {"hip": {"stiffness": math.inf, "damping": 0.0}})
    arm = arm.extended(
        [*one_of_each("knee"), *(e for e in one_of_each("hip") if e.joint and not e.effect.needs_spring)]
    )
    done = exported(arm, target.name)
    assert {row.what for row in done.account if row.joint} == {
        name for name, e in catalogue().items() if not e.whole_robot and not e.for_rigid
    }
    for line in str(done).splitlines():
        assert line.replace("--", "- -") in done.text
    assert [row for row in done.account if row.way.level is Level.NONE] == list(done.lost)
    if target.suffixes != (".py",):
        ElementTree.fromstring(done.text)


def test_an_effect_that_sets_in_later_is_not_in_a_file() -> None:
    arm = make(PLANAR).extended([effect("payload", "knee", since=2.0, mass=3.0)])
    (row,) = (row for row in exported(arm, "mjcf").account if row.what == "payload")
    assert row.way.level is Level.NONE and "sets in later" in row.way.how


# --- what Pinocchio reads of them ---------------------------------------------------------------------------
def same_body(arm: Robot, back: pin.Model, armature: bool = False) -> None:
    """Mass matrix and gravity of the robot with its effects, by the names of its joints."""
    model = FlexibleJointModel(arm)
    names = [str(name) for name in arm.model.names[1:]]
    assert [str(name) for name in back.names[1:]] == names
    rng = np.random.default_rng(7)
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, arm.model.nq)
        other = q.copy()
        if back.nq != arm.model.nq:  # continuous joints as cosine and sine
            other = np.concatenate(
                [
                    [math.cos(x), math.sin(x)] if back.joints[back.getJointId(name)].nq == 2 else [x]
                    for name, x in zip(names, q, strict=True)
                ]
            )
        expected = np.array(model.body.mass_matrix(q))
        if armature:
            for i in set(model.rigid) - model.grouped:
                # Pinocchio does not read the tendons of MuJoCo, which carry what coupled motors have
                expected[model.joints[i].idx_v, model.joints[i].idx_v] += model.flows[i].drive.B
        mass = pin.crba(back, back.createData(), other)
        size = float(np.max(np.abs(expected)))
        assert mass == pytest.approx(expected, abs=1e-9 * size)
        gravity = model.body.gravity_torque(q)
        size = float(np.max(np.abs(gravity))) + 1e-3
        got = pin.computeGeneralizedGravity(back, back.createData(), other)
        assert got == pytest.approx(gravity, abs=1e-9 * size)


LOADED = [
    effect("payload", "pitch", mass=0.7, position=(0.1, -0.05, 0.2)),
    effect("base_tilt", roll=0.3, pitch=-0.4),
]


@pytest.mark.parametrize("target", ["urdf", "drake"])
def test_pinocchio_reads_the_urdf_as_the_same_machine(target: str, tmp_path: Path) -> None:
    arm = make(SPATIAL, {"roll": None}).extended(LOADED)  # with a passive joint
    out = tmp_path / "arm.urdf"
    export_robot(arm, target, out)
    same_body(arm, pin.buildModelFromUrdf(str(out)))


def test_mujoco_reads_the_urdf_as_the_same_machine(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    arm = load("kr300")
    export_robot(arm, "urdf", tmp_path / "arm.urdf")
    engine = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.urdf"))
    data, model = mujoco.MjData(engine), FlexibleJointModel(arm)
    q = np.array([0.3, -0.2, 0.4, 0.1, -0.5, 0.7])
    data.qpos[:] = q
    mujoco.mj_forward(engine, data)
    mass = np.zeros((6, 6))
    mujoco.mj_fullM(engine, data, mass)
    expected = model.body.mass_matrix(q)
    assert mass == pytest.approx(expected, abs=1e-9 * float(np.max(expected)))
    gravity = model.body.gravity_torque(q)
    assert data.qfrc_bias == pytest.approx(gravity, abs=1e-9 * float(np.max(np.abs(gravity))))
    assert engine.dof_damping == pytest.approx([flow.drive.D_m for flow in model.flows])
    dry = {e.joint: e.p.level for e in arm.effects if e.effect.name == "motor_coulomb_friction"}
    assert engine.dof_frictionloss == pytest.approx([dry[name] for name in arm.joint_names])
    assert engine.jnt_actfrcrange[:, 1] == pytest.approx([joint.torque_limit for joint in arm.joints])


@pytest.mark.parametrize("name", [name for name in shipped_robots() if name != "centauro"])
def test_shipped_robots_come_back_from_urdf_and_mjcf(name: str, tmp_path: Path) -> None:
    arm = load(name)
    export_robot(arm, "urdf", tmp_path / "arm.urdf")
    same_body(arm, pin.buildModelFromUrdf(str(tmp_path / "arm.urdf")))
    export_robot(arm, "mjcf", tmp_path / "arm.xml")
    same_body(arm, pin.buildModelFromMJCF(str(tmp_path / "arm.xml")), armature=True)


# --- what init reads of them --------------------------------------------------------------------------------
def same_elements(text: str, other: str) -> None:
    """The same tags with the same words and numbers; inertias, whose axes may be others, are left to
    `same_body`, sites to Pinocchio's frames."""
    one, two = (
        [e for e in ElementTree.fromstring(xml).iter() if e.tag not in ("option", "site", "mujoco")]
        for xml in (text, other)
    )
    assert [e.tag for e in one] == [e.tag for e in two]
    for a, b in zip(one, two, strict=True):
        if a.tag == "inertial":
            continue
        assert a.attrib.keys() == b.attrib.keys()
        for key, value in a.attrib.items():
            expected = numbers(value)
            if not isinstance(expected, str):  # the last digits of what is scaled on the way may differ
                expected = pytest.approx(expected, rel=1e-9, abs=1e-12)
            assert numbers(b.attrib[key]) == expected, (a.tag, key)


def numbers(text: str) -> Any:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return text


def again(arm: Robot, folder: Path) -> Robot:
    """The robot that `flexjoint init` makes of the exported MJCF."""
    export_robot(arm, "mjcf", folder / "arm.xml")
    out = folder / "arm.yaml"
    out.write_text(draft(str(folder / "arm.xml"), out).text)
    return load(out)


@pytest.mark.parametrize("name", [*shipped_robots(), "grounded"])
def test_init_reads_the_exported_mjcf_as_the_same_robot(name: str, tmp_path: Path) -> None:
    arm = load("centauro", ["torso", "arms"]) if name == "grounded" else load(name)
    back = again(arm, tmp_path)
    assert back.joint_names == arm.joint_names and back.floating == arm.floating
    for joint, own in zip(arm.joints, back.joints, strict=True):
        assert own.torque_limit == joint.torque_limit
        for key in ("K", "D", "B", "D_m"):
            # the inverse inertia that scales the limit of a play is computed again
            assert getattr(own.drive, key) == pytest.approx(getattr(joint.drive, key), rel=1e-9)
    # what says the same with the same numbers in MuJoCo is the same machine
    same_elements(exported(back, "mjcf").text, exported(arm, "mjcf").text)


CARRIED = [name for name, way in TARGETS["mjcf"].effects.items() if way.level is Level.EXACT]


@pytest.mark.parametrize("flexible", [True, False], ids=["flexible", "rigid"])
def test_init_reads_back_every_exact_effect(flexible: bool, tmp_path: Path) -> None:
    arm = make(
        PLANAR, {} if flexible else {n: {"stiffness": math.inf, "damping": 0.0} for n in ("hip", "knee")}
    )
    merged = ("motor_inertia", "motor_viscous_friction", "spring_stiffness", "spring_damping", "base_tilt")
    merged += ("payload", "rotor_inertia", "asymmetric_friction")  # they have tests of their own
    merged += ("torque_speed_limit",)
    own = [e for e in one_of_each("knee") if e.effect.name in CARRIED and e.effect.name not in merged]
    if not flexible:
        at_motor = ("link_viscous_friction", "link_coulomb_friction")
        own = [e for e in own if not e.effect.needs_spring and e.effect.name not in at_motor]
    arm = arm.extended([*own, effect("backlash", "hip", gap=2e-3)] if flexible else own)
    found = {e.key: e for e in again(arm, tmp_path).effects}
    assert sorted(found) == sorted(e.key for e in arm.effects)
    for planned in arm.effects:
        for key, value in planned.values.items():
            got = found[planned.key].values[key]
            assert got == (value if isinstance(value, str | None) else pytest.approx(value, rel=1e-9)), (
                planned
            )


def test_init_reads_what_an_exact_effect_has_become(tmp_path: Path) -> None:
    arm = make(PLANAR).extended(
        [
            effect("motor_inertia", "hip", scale=0.5),
            effect("spring_stiffness", "hip", scale=-0.2),
            effect("motor_viscous_friction", "hip", coefficient=3.0),
            effect("base_tilt", roll=0.1, pitch=0.2),
            effect("rotor_inertia", "knee", inertia=0.25),
            effect("payload", "knee", mass=0.5, position=(0.1, 0.0, -0.1)),
            effect("asymmetric_friction", "knee", level_positive=0.5, level_negative=0.2),
            effect("torque_speed_limit", "knee", stall=9.0, drop=0.5),
        ]
    )
    back = again(arm, tmp_path)
    hip = back.joint("hip").drive
    assert (hip.K, hip.B, hip.D_m) == pytest.approx((640.0, 0.36, 15.0))
    knee, turned = (robot.joint("knee").drive for robot in (arm, back))
    assert (turned.B, turned.D_m) == pytest.approx((knee.B + 0.25, knee.D_m))
    left = {e.effect.name: e.p for e in back.effects}
    assert left.pop("asymmetric_friction") == pytest.approx((0.5, 0.2))
    assert left.pop("torque_speed_limit") == pytest.approx((9.0, 0.5)) and left == {}
    whole = FlexibleJointModel(arm).body
    q = np.array([0.4, -0.7])
    read = FlexibleJointModel(back).body
    assert read.mass_matrix(q) == pytest.approx(whole.mass_matrix(q), rel=1e-9)
    assert read.gravity_torque(q) == pytest.approx(whole.gravity_torque(q), rel=1e-9)


@pytest.mark.parametrize("name", [name for name in shipped_robots() if name != "centauro"])
def test_init_reads_the_exported_urdf_as_the_rigid_robot(name: str, tmp_path: Path) -> None:
    arm = load(name)
    export_robot(arm, "urdf", tmp_path / "arm.urdf")
    out = tmp_path / "arm.yaml"
    out.write_text(draft(str(tmp_path / "arm.urdf"), out).text)
    back = load(out)
    same_body(arm, back.model)
    model = FlexibleJointModel(arm)
    viscous = {e.joint: e.p.coefficient for e in arm.effects if e.effect.name == "link_viscous_friction"}
    dry = {e.joint: e.p.level for e in arm.effects if e.effect.name == "motor_coulomb_friction"}
    for joint, flow in zip(back.joints, model.flows, strict=True):
        expected = flow.drive.D_m + viscous.get(joint.name, 0.0)
        assert joint.rigid and joint.drive.D_m == pytest.approx(expected, rel=1e-9)
        assert joint.torque_limit == pytest.approx(flow.joint.torque_limit, rel=1e-9)
    assert {e.joint: e.p.level for e in back.effects} == pytest.approx(dry, rel=1e-9)


# --- the numbers of each file -------------------------------------------------------------------------------
RUBBING = [
    effect("motor_coulomb_friction", "hip", level=0.4),
    effect("link_coulomb_friction", "hip", level=0.1),
    effect("asymmetric_friction", "hip", level_positive=0.3, level_negative=0.1),
    effect("link_viscous_friction", "hip", coefficient=2.0),
    effect("motor_viscous_friction", "hip", coefficient=1.0),
    effect("motor_inertia", "hip", scale=0.5),
    effect("torque_saturation", "hip", limit=50.0),
    effect("torque_delay", "hip", delay=4e-3),
    effect("stribeck_friction", "knee", level=0.2, static_extra=0.1),
    effect("cable_spring", "knee", stiffness=3.0, rest=0.4),
]


def test_urdf_has_damping_friction_and_limits() -> None:
    root = ElementTree.fromstring(exported(make(PLANAR).extended(RUBBING), "urdf").text)
    hip = {joint.get("name"): joint for joint in root.iter("joint")}["hip"]
    dynamics, limit = hip.find("dynamics"), hip.find("limit")
    assert dynamics is not None and limit is not None
    assert float(dynamics.attrib["damping"]) == pytest.approx(12.0 + 2.0 + 1.0)
    assert float(dynamics.attrib["friction"]) == pytest.approx(0.4 + 0.1 + 0.2)
    assert float(limit.attrib["effort"]) == 50.0
    assert hip.get("type") == "continuous" and root[0].get("name") == "world"


def test_drake_reflects_the_rotors_inertia_by_the_gear() -> None:
    arm = make(PLANAR, {"hip": {"gear_ratio": 100.0}}).extended(RUBBING)
    text = exported(arm, "drake").text
    root = ElementTree.fromstring(text)
    found = {}
    for transmission in root.iter("transmission"):
        actuator = transmission.find("actuator")
        assert actuator is not None
        tags = {child.tag.split("}")[1]: float(child.attrib["value"]) for child in actuator}
        found[actuator.get("name")] = tags["rotor_inertia"] * tags["gear_ratio"] ** 2
    assert found == {"hip": pytest.approx(0.24 * 1.5), "knee": pytest.approx(0.13)}
    assert "<drake:gear_ratio value=" in text


def test_sdf_has_links_at_their_joints_and_springs() -> None:
    root = ElementTree.fromstring(exported(make(PLANAR).extended(RUBBING), "sdf").text)
    links = {link.get("name"): link for link in root.iter("link")}
    pose = links["knee_link"].find("pose")
    assert pose is not None and pose.get("relative_to") == "hip_link"
    assert [float(x) for x in (pose.text or "").split()] == pytest.approx([0, 0, -0.4, 0, 0, 0])
    assert float(links["knee_link"].findtext("inertial/mass", "")) == 1.5
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    knee = joints["knee"]
    assert float(knee.findtext("axis/dynamics/spring_stiffness", "")) == 3.0
    assert float(knee.findtext("axis/dynamics/spring_reference", "")) == 0.4
    assert float(joints["hip"].findtext("axis/limit/effort", "")) == 50.0
    assert joints["mounting"].findtext("parent") == "world"


def test_isaac_lab_gets_a_configuration_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for its two classes, which only keep what they are given."""
    stand_in = types.ModuleType("isaaclab.actuators")

    def config(kind: str) -> Any:
        return lambda **given: (kind, given)

    for kind in ("ImplicitActuatorCfg", "DelayedPDActuatorCfg"):
        setattr(stand_in, kind, config(kind))
    monkeypatch.setitem(sys.modules, "isaaclab", types.ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", stand_in)
    out = tmp_path / "actuators.py"
    export_robot(make(PLANAR).extended(RUBBING), "isaaclab", out)
    actuators = runpy.run_path(str(out))["ACTUATORS"]
    kind, hip = actuators["hip"]
    assert kind == "DelayedPDActuatorCfg" and hip["min_delay"] == hip["max_delay"] == 4
    assert hip["joint_names_expr"] == ["hip"] and hip["effort_limit"] == 50.0
    assert (hip["stiffness"], hip["damping"]) == (2600.0, 30.0)  # kp and kd
    assert hip["armature"] == pytest.approx(0.36) and hip["viscous_friction"] == pytest.approx(15.0)
    assert hip["friction"] == hip["dynamic_friction"] == pytest.approx(0.7)
    kind, knee = actuators["knee"]
    assert kind == "ImplicitActuatorCfg" and knee["friction"] - knee["dynamic_friction"] == pytest.approx(0.1)


def test_ros2_control_has_interfaces_limits_and_says_delays() -> None:
    text = exported(make(PLANAR, sensing_delay=2e-3).extended(RUBBING), "ros2_control").text
    root = ElementTree.fromstring(text)
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    limits = {param.get("name"): float(param.text or "") for param in joints["hip"].iter("param")}
    assert limits == {"min": -50.0, "max": 50.0}
    assert [one.get("name") for one in joints["hip"].iter("state_interface")] == [
        "position",
        "velocity",
        "effort",
    ]
    assert "the effort acts 0.004 s late" in text and "readings are 0.002 s old" in text


# --- refusals -----------------------------------------------------------------------------------------------
def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    arm = make(PLANAR)
    with pytest.raises(UnknownNameError, match=r"unknown target of an export 'mjfc' .did you mean 'mjcf'"):
        fj.export_robot(arm, "mjfc", tmp_path / "a.xml")
    with pytest.raises(FlexJointError, match=r"expected a name that ends in .xml or .mjcf, got .urdf"):
        fj.export_robot(arm, "mjcf", tmp_path / "a.urdf")
    with pytest.raises(RobotError, match=r"export_robot: expected a robot first, got the text 'arm\.yaml'"):
        fj.export_robot("arm.yaml", "mjcf", tmp_path / "a.xml")  # type: ignore[arg-type]
    light = arm.extended([effect("payload", "knee", mass=-5.0)])
    with pytest.raises(RobotError, match=r"the link of joint knee weighs -3.5 kg .* check the payload"):
        fj.export_robot(light, "urdf", tmp_path / "a.urdf")
    assert list(tmp_path.iterdir()) == []


def test_a_damping_below_zero_is_not_expressible() -> None:
    arm = make(PLANAR).extended([Planned.of("motor_viscous_friction", "knee", {"coefficient": -20.0})])
    (row,) = exported(arm, "mjcf").lost[1:]
    assert row.what == "motor_viscous_friction" and "negative" in row.way.how
