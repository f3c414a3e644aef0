"""The face of the package: its verbs, robots made in memory, and what is said to wrong things."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from support.robots.arms import PLANAR, make
from support.robots.robot_files import JOINT, URDF

import flexjoint as fj
from flexjoint.core.errors import FlexJointError, ModelError, RecordingError, RobotError, UnknownNameError

REVOLUTE = URDF.replace('type="continuous"', 'type="revolute"').replace(
    '<axis xyz="0 1 0"/></joint>\n<joint name="elbow"',
    '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="35" velocity="9"/></joint>\n<joint name="elbow"',
)
DRIVE = {"stiffness": 260.0, "damping": 0.7, "motor_inertia": 0.09, "motor_damping": 6.0}


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm2.urdf"
    path.write_text(URDF)
    return path


def arm() -> pin.Model:
    return pin.buildModelFromXML(REVOLUTE)


def swing(robot: fj.Robot, seconds: float = 1.0) -> fj.Recording:
    t = np.arange(0.0, seconds, 2e-3)
    columns = {("q_ref", name): 0.3 * np.sin(2.0 * t) for name in robot.joint_names}
    return fj.make_recording(t, columns, "swing")


# --- the list of names --------------------------------------------------------------------------------------
def test_type_checkers_see_the_names_that_there_are() -> None:
    tree = ast.parse(Path(fj.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {
        name.asname or name.name: (statement.module, name.name)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }
    assert seen == {name: (f"flexjoint.{module}", own) for name, (module, own) in fj._PLACES.items()}
    assert fj.__all__ == sorted(seen)


def test_an_unknown_name_gets_the_near_ones() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'linearize'; did you mean linearise\?"):
        _ = fj.linearize  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"no attribute 'xyz'; dir\(flexjoint\) lists its names"):
        _ = fj.xyz  # type: ignore[attr-defined]


def test_importing_the_package_imports_nothing_but_the_standard_library() -> None:
    code = "import sys; before = set(sys.modules); import flexjoint; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {name for name in done.stdout.split() if name.split(".")[0] not in sys.stdlib_module_names} == {
        "flexjoint"
    }


# --- verbs --------------------------------------------------------------------------------------------------
def test_the_verbs_of_one_robot(urdf: Path) -> None:
    robot = fj.load_robot(urdf, **DRIVE, kp=100.0, kd=5.0)
    model = fj.FlexibleJointModel(robot, [fj.effect("backlash", "elbow", gap=2e-3)])
    run = fj.simulate(model, swing(robot), sample_rate=500.0)
    own, nominal = (fj.compare(which, run.measured, horizon=0.25) for which in (model, robot))
    # the recording is the model's own, but for the linear interpolation of torques between its rows
    assert own.rms["q.elbow"] < 0.1 * nominal.rms["q.elbow"]
    q = np.array([0.2, -0.4, 0.1])
    assert fj.equilibrium(model, q).theta.shape == (1, 3)
    assert len(fj.linearise(fj.FlexibleJointModel(robot), q).inputs) == 3
    page = fj.view(robot, [run.measured, run], geometry="sticks")
    assert "<html" in page.html()


def test_an_effect_takes_its_own_parameters_and_no_others() -> None:
    made = fj.effect("friction_drift", "elbow", since=2.0)
    assert (made.joint, made.since, made.nominal) == ("elbow", 2.0, False)
    with pytest.raises(UnknownNameError, match=r"parameter of backlash 'gab' \(did you mean 'gap'\?\)"):
        fj.effect("backlash", "elbow", gab=2e-3)
    with pytest.raises(ModelError, match=r"backlash.gap: expected a number in"):
        fj.effect("backlash", "elbow", gap=-1.0)


# --- robots made in memory ----------------------------------------------------------------------------------
def test_a_description_alone_is_a_rigid_robot(urdf: Path) -> None:
    robot = fj.load_robot(urdf)
    assert robot.name == "arm2" and robot.joint_names == ("shoulder", "elbow", "wrist")
    assert all(joint.rigid for joint in robot.joints) and robot.model.nq == 3  # continuous joints unwrapped
    run = fj.simulate(fj.FlexibleJointModel(robot), torques(robot)).true
    pendulum = robot.model.copy()
    data, q, v = pendulum.createData(), np.zeros(3), np.zeros(3)
    for _ in range(1000):  # semi-implicit Euler at 20 times the rate: its error is 20 times smaller, 5e-5 s
        for _ in range(20):
            v = v + 5e-5 * pin.aba(pendulum, data, q, v, np.array([1.0, 0.4, 0.1]))
            q = q + 5e-5 * v
    there = [run.get("q", name)[1000] for name in robot.joint_names]
    np.testing.assert_allclose(there, q, atol=2e-3)


def torques(robot: fj.Robot) -> fj.Recording:
    t = np.arange(1100) / 1000.0
    values = dict(zip(robot.joint_names, (1.0, 0.4, 0.1), strict=True))
    columns: dict[tuple[str, str], np.ndarray] = {
        ("tau_m", name): np.full(t.shape, value) for name, value in values.items()
    }
    columns |= {("q_ref", name): np.zeros(t.shape) for name in robot.joint_names}
    return fj.make_recording(t, {key: value for key, value in columns.items() if key[0] == "tau_m"}, "push")


def test_numbers_of_joints_are_one_for_all_by_name_or_in_order(urdf: Path) -> None:
    robot = fj.load_robot(
        urdf, stiffness={"elbow": 300.0}, motor_inertia=0.1, damping=[0.1, 0.2, 0.3], rates={"control": 500.0}
    )
    drives = [joint.drive for joint in robot.joints]
    assert [drive.K for drive in drives] == [np.inf, 300.0, np.inf]
    assert [drive.B for drive in drives] == [0.1] * 3 and [drive.D for drive in drives] == [0.1, 0.2, 0.3]
    assert (robot.rates.control, robot.rates.physics) == (500.0, 1000.0)


def test_a_robot_of_a_description_is_that_of_a_file_and_can_be_written_as_one(
    urdf: Path, tmp_path: Path
) -> None:
    names = ("shoulder", "elbow", "wrist")
    file = tmp_path / "arm2.yaml"
    file.write_text(
        yaml.safe_dump({"name": "arm2", "urdf": "arm2.urdf", "joints": {n: dict(JOINT) for n in names}})
    )
    stated = fj.load_robot(file)
    made = fj.load_robot(urdf, **JOINT)
    assert made.joints == stated.joints and made.model == stated.model
    out = tmp_path / "deep" / "written.yaml"
    made.extended([fj.effect("backlash", "elbow", gap=2e-3)]).write(out)
    read = fj.load_robot(out)
    assert read.joints == made.joints and [str(e) for e in read.effects] == ["backlash on elbow"]


def test_a_description_of_example_robot_data_needs_no_file() -> None:
    name = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    robot = fj.load_robot(name, stiffness=8000.0, motor_inertia=0.6)
    assert robot.name == "ur5_robot" and len(robot.joints) == 6 and robot.joints[0].drive.K == 8000.0


def test_an_mjcf_says_itself_whether_it_floats(tmp_path: Path) -> None:
    body = (
        '<body name="b">{free}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="c" pos="0 0 1">'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        '<joint name="hip" type="hinge" axis="0 1 0"/></body>'
        "</body>"
    )
    for free, floating in (("", False), ('<freejoint name="root"/>', True)):
        path = tmp_path / "box.xml"
        path.write_text(f'<mujoco model="box"><worldbody>{body.format(free=free)}</worldbody></mujoco>')
        robot = fj.load_robot(path)
        assert robot.floating is floating and robot.joint_names == ("hip",)


def test_a_pin_model_is_a_robot() -> None:
    model = arm()
    model.gravity.linear = np.array([0.0, 0.0, -1.62])
    robot = fj.Robot.from_model(
        model, ["elbow", "shoulder"], name="lunar", **DRIVE, tolerance={"inertial": 0.1}
    )
    assert robot.joint_names == ("shoulder", "elbow") and robot.name == "lunar"
    assert robot.model == model and robot.model is not model
    assert robot.gravity[2] == -1.62 and robot.tolerance.inertial == 0.1
    rest = fj.equilibrium(fj.FlexibleJointModel(robot), np.array([0.3, 0.2, -0.5]))
    load = pin.computeGeneralizedGravity(model, model.createData(), np.array([0.3, 0.2, -0.5]))
    np.testing.assert_allclose(260.0 * rest.deflection[0], load[:2], rtol=1e-9)
    assert "<html" in fj.view(robot).html()


def test_numbers_in_order_are_in_the_order_of_the_joints() -> None:
    robot = fj.Robot.from_model(arm(), ["elbow", "shoulder"], motor_inertia=[0.1, 0.2])
    assert (robot.joint("elbow").drive.B, robot.joint("shoulder").drive.B) == (0.1, 0.2)


# --- what is said to wrong things --------------------------------------------------------------------------
def free_flyer() -> pin.Model:
    return pin.buildModelFromXML(REVOLUTE, pin.JointModelSpherical())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"joints": ["elbw"]}, r"joints: unknown joint 'elbw' \(did you mean 'elbow'\?\)"),
        ({"joints": []}, "expected at least one joint"),
        (
            {"stiffness": 100.0},
            "a motor behind a spring of 100 N m/rad needs its inertia; give motor_inertia > 0",
        ),
        ({"stiffness": {"knee": 1.0}}, "stiffness: unknown joint 'knee'"),
        ({"damping": [1.0, 2.0]}, r"damping: expected 3 numbers, one a joint, got \(2,\)"),
        ({"kp": "high"}, "kp: expected numbers, got 'high'"),
        ({"kd": -1.0}, "kd: Input should be greater than or equal to 0"),
        ({"rates": {"phsics": 1.0}}, r"unknown key 'phsics' \(did you mean 'physics'\?\)"),
    ],
)
def test_numbers_that_make_no_robot(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(RobotError, match=said) as error:
        fj.Robot.from_model(arm(), **changes)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (pin.buildModelFromXML(URDF), r"'shoulder' is continuous.*load the URDF with load_robot"),
        (free_flyer(), r"'root_joint' has 3 degrees of freedom.*joints=\["),
        ("arm2.urdf", r"expected a pin.Model, got the text 'arm2.urdf'; read a file with load_robot\(path\)"),
    ],
)
def test_models_that_make_no_robot(model: Any, said: str) -> None:
    with pytest.raises(RobotError, match=said):
        fj.Robot.from_model(model)


def test_a_robot_without_a_description_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"was made of a pin.Model.*load its URDF or MJCF with load_robot"):
        fj.Robot.from_model(arm()).write(tmp_path / "r.yaml")
    assert not list(tmp_path.iterdir())


def robot_and_recording() -> tuple[fj.Robot, fj.Recording]:
    robot, t = make(PLANAR), np.arange(100) / 100.0
    return robot, fj.make_recording(t, {("q", name): np.sin(t) for name in robot.joint_names})


@pytest.mark.parametrize("verb", ["diagnose", "check", "compare", "plan", "view"])
def test_what_is_no_robot_is_refused_with_what_to_call(verb: str) -> None:
    robot, recording = robot_and_recording()
    call = getattr(fj, verb)
    for wrong, said in (
        (robot.model, rf"{verb}: expected a robot first, got a pin.Model; make .* Robot.from_model\(model\)"),
        (
            "kr300",
            rf"{verb}: expected a robot first, got the text 'kr300'; load it with load_robot\('kr300'\)",
        ),
        (recording, rf"{verb}: expected a robot first, got a Recording; make one with load_robot"),
    ):
        with pytest.raises(RobotError, match=said):
            call(wrong, robot if wrong is recording else recording)


@pytest.mark.parametrize("verb", ["diagnose", "check", "compare", "view"])
def test_what_is_no_recording_is_refused_with_what_to_call(verb: str) -> None:
    robot, recording = robot_and_recording()
    call = getattr(fj, verb)
    for wrong, said in (
        ("rec.csv", rf"{verb}: expected a recording, got the text 'rec.csv'; read it with read_recording"),
        (Path("rec.csv"), rf"{verb}: expected a recording, got the text 'rec.csv'"),
        (robot, rf"{verb}: expected a recording, got a Robot; read one with read_recording"),
    ):
        with pytest.raises(RecordingError, match=said):
            call(robot, wrong)
    if verb in ("diagnose", "view"):
        with pytest.raises(RecordingError, match="got a float"):
            call(robot, [recording, 1.0])


def test_what_cannot_be_loaded_says_what_to_call(urdf: Path) -> None:
    for wrong, said in (
        (arm(), r"expected a path or a name, got a pin.Model; make .* Robot.from_model\(model\)"),
        (make(PLANAR), "got a Robot; it is loaded already"),
        (3.0, "got a float"),
        (urdf.with_name("none.urdf"), r"none.urdf does not exist; give the path of a URDF, MJCF or SDF"),
    ):
        with pytest.raises(RobotError, match=said):
            fj.load_robot(wrong)
    with pytest.raises(RobotError, match="a robot file states its own stiffness"):
        fj.load_robot("kr300", stiffness=1.0)
    with pytest.raises(RobotError, match="is a description; sections, presets and grounding"):
        fj.load_robot(urdf, preset="soft")
    urdf.write_text("<html/>")
    with pytest.raises(RobotError, match=r"expected a URDF, MJCF or SDF.*got <html>"):
        fj.load_robot(urdf)


def test_a_plan_is_of_a_diagnosis(tmp_path: Path) -> None:
    with pytest.raises(FlexJointError, match=r"plan: expected a diagnosis.*got a float"):
        fj.plan(make(PLANAR), 1.0)
    with pytest.raises(FlexJointError, match="cannot be read"):
        fj.plan(make(PLANAR), tmp_path / "none.json")
