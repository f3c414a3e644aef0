"""The robot's YAML: what is read, what is refused and in which words, what is written; arbitrary input."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.robots.robot_files import JOINT, URDF, content, file

from flexjoint.core.errors import FlexJointError, RobotError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.robot import robot

examples = settings(
    max_examples=150, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


def refused(path: Path, said: str, kind: type[FlexJointError] = RobotError) -> None:
    with pytest.raises(kind, match=said) as error:
        robot.load(path)
    assert "\n" not in str(error.value)


# --- reading --------------------------------------------------------------------------------------------
def test_a_file_becomes_a_robot(tmp_path: Path) -> None:
    loaded = robot.load(file(tmp_path, rates={"control": 500}, gravity=[0, 0, -3.7]))
    assert loaded.joint_names == ("shoulder", "elbow")
    drive = loaded.joint("elbow").drive
    assert (drive.K, drive.D, drive.B, drive.D_m) == (260, 0.7, 0.09, 6)
    assert (loaded.rates.physics, loaded.rates.control) == (1000, 500)
    np.testing.assert_array_equal(loaded.gravity, [0, 0, -3.7])
    tolerance = loaded.tolerance  # defaults of the format
    assert (tolerance.inertial, tolerance.stiffness, tolerance.damping, tolerance.torque) == (
        0.02, 0.02, 0.1, 0.01,
    )  # fmt: skip


def test_an_unlisted_joint_swings_freely_and_a_locked_one_keeps_its_mass(tmp_path: Path) -> None:
    free = robot.load(file(tmp_path))
    assert free.model.existJointName("wrist") and free.model.nv == 3
    locked = robot.load(file(tmp_path, lock=["wrist"]))
    assert not locked.model.existJointName("wrist") and locked.model.nv == 2
    assert pin.computeTotalMass(locked.model) == pytest.approx(3.5)


def test_a_locked_joint_stays_where_initial_puts_it(tmp_path: Path) -> None:
    def centre(angle: float) -> np.ndarray:
        model = robot.load(file(tmp_path, lock=["wrist"], initial={"wrist": angle})).model
        return pin.centerOfMass(model, model.createData(), np.zeros(2))

    # hand of 0.5 kg at 0.05 m, turned by 0.5 rad about y, out of 3.5 kg
    assert centre(0.5)[0] - centre(0.0)[0] == pytest.approx(-0.5 * 0.05 * math.sin(0.5) / 3.5)


def test_a_continuous_joint_counts_turns(tmp_path: Path) -> None:
    loaded = robot.load(file(tmp_path))
    assert loaded.model.nq == loaded.model.nv
    assert loaded.model.upperPositionLimit[loaded.joint("shoulder").idx_q] > 1e3


def test_infinite_stiffness_is_a_rigid_joint(tmp_path: Path) -> None:
    loaded = robot.load(
        file(
            tmp_path, joints={"elbow": {"stiffness": float("inf"), "motor_inertia": 0.09}, "shoulder": JOINT}
        )
    )
    assert loaded.joint("elbow").rigid and not loaded.joint("shoulder").rigid


def test_shipped_robots_are_found_by_name() -> None:
    assert {"kr300", "rrbot", "rrbot_last_joint"} <= set(robot.shipped_robots())
    assert robot.load("kr300").name == "kr300"


def test_a_urdf_of_example_robot_data_is_found_by_package(tmp_path: Path) -> None:
    path = tmp_path / "panda.yaml"
    urdf = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    raw = {"name": "panda", "urdf": urdf, "joints": {"panda_joint1": JOINT}, "lock": ["panda_finger_joint2"]}
    path.write_text(yaml.safe_dump(raw))
    assert robot.load(path).joint_names == ("panda_joint1",)


def test_a_urdf_is_found_in_package_dirs(tmp_path: Path) -> None:
    (tmp_path / "share" / "arm").mkdir(parents=True)
    (tmp_path / "share" / "arm" / "arm2.urdf").write_text(URDF)
    loaded = robot.load(file(tmp_path, urdf="package://arm/arm2.urdf", package_dirs=["share"]))
    assert loaded.urdf == tmp_path / "share" / "arm" / "arm2.urdf"


# --- refusing -------------------------------------------------------------------------------------------
GAP = {"effect": "backlash", "joint": "elbow", "gap": 0.01}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"stiffness": 3}, "unknown key 'stiffness'; valid: base, contacts, continuous, couplings"),
        ({"stiffness": 3}, "valid: .*; 'stiffness' stands in an entry of joints$"),
        ({"joints": {"elbow": {**JOINT, "effects": [GAP]}}}, "'effects' stands at the top of the file$"),
        ({"joint": {}}, r"unknown key 'joint' \(did you mean 'joints'"),
        ({"name": None}, "name is missing; every robot needs it"),
        ({"joints": None}, "joints is missing"),
        ({"joints": {}}, "joints: .*at least 1"),
        ({"joints": {"elbow": {**JOINT, "stifness": 1}}}, "joints.elbow: unknown key 'stifness' .*stiffness"),
        ({"joints": {"elbow": {**JOINT, "stiffness": -1}}}, "elbow.stiffness: .*greater than 0, got -1"),
        ({"joints": {"elbow": {**JOINT, "stiffness": "hard"}}}, "joints.elbow.stiffness: .*got 'hard'"),
        ({"joints": {"elbow": {**JOINT, "stiffness": "rigid"}}}, "'rigid'; .inf if the joint is rigid"),
        ({"joints": {"elbow": {"motor_inertia": 1}}}, "elbow.stiffness is missing; .*; .inf if the joint is"),
        ({"joints": {"elbow": {**JOINT, "damping": float("nan")}}}, "joints.elbow.damping"),
        ({"joints": {"elbow": {"stiffness": 260}}}, "joints.elbow.motor_inertia is missing"),
        ({"joints": {"ellbow": JOINT}}, r"'ellbow' \(did you mean 'elbow'\?\); valid: elbow, shoulder"),
        ({"tolerance": {"mass": 0.1}}, "in tolerance: unknown key 'mass'; valid: com, damping, inertial"),
        ({"rates": {"physics": 0}}, "rates.physics: .*greater than or equal to 1"),
        ({"gravity": [0, -9.81]}, "gravity"),
        ({"base": "mobile"}, "base: .*'fixed' or 'floating', got 'mobile'"),
        ({"lock": ["elbow"]}, "'elbow' is both actuated and locked"),
        ({"lock": ["finger"]}, "unknown joint 'finger'"),
        ({"urdf": "none.urdf"}, "URDF .*none.urdf does not exist; `urdf` is relative to the YAML"),
        ({"urdf": "package://none/none.urdf"}, "not found under .*; add its folder to package_dirs"),
        ({"effects": [GAP, GAP]}, "backlash on elbow is listed twice; keep one entry"),
        ({"effects": [{**GAP, "effect": "backlsh"}]}, "unknown effect 'backlsh' .did you mean 'backlash'"),
        ({"effects": [{**GAP, "joint": "knee"}]}, "backlash: unknown joint 'knee'; valid: elbow, shoulder"),
        ({"effects": [{**GAP, "width": 1}]}, "unknown parameter of backlash 'width'; valid: gap"),
        ({"effects": [{**GAP, "gap": -1}]}, r"backlash.gap: expected a number in \[0, 0.5\] rad, got -1"),
        ({"effects": [{**GAP, "gap": "wide"}]}, "backlash.gap: expected a number .*got 'wide'"),
        ({"effects": [{"effect": "backlash"}]}, "backlash acts on a joint: name one"),
        ({"effects": [{"joint": "elbow"}]}, "an entry of effects has no `effect` name"),
        ({"effects": [{"effect": "base_tilt", "joint": "elbow"}]}, "base_tilt acts on the whole robot"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_in_words(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = file(tmp_path, **changes)
    refused(path, said, FlexJointError)
    refused(path, "arm2", FlexJointError)  # which file


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name: [arm2", "is not valid YAML"),
        ("name: arm2\n  urdf: x", "is not valid YAML: .*line 2"),
        ("", "expected a mapping with name, urdf and joints, got NoneType"),
        ("- a\n- b", "got list"),
        ("3", "got int"),
    ],
)
def test_broken_yaml_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "arm2.yaml"
    path.write_text(text)
    refused(path, said)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    refused(tmp_path / "none.yaml", "does not exist; give the path of a robot YAML")
    (tmp_path / "arm.yaml").mkdir()
    refused(tmp_path / "arm.yaml", "is a folder")
    with pytest.raises(RobotError, match=r"no robot 'kr3000': give a YAML file or one of centauro, kr300"):
        robot.load("kr3000")


@pytest.mark.parametrize("urdf", ["", "<robot", "<robot name='a'/>", "<sdf/>", "\x00"])
def test_a_broken_urdf_is_refused(tmp_path: Path, urdf: str) -> None:
    path = file(tmp_path)
    (tmp_path / "arm2.urdf").write_text(urdf)
    refused(path, "arm2", FlexJointError)


def test_an_unknown_joint_of_a_robot_lists_the_valid_ones(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="valid: elbow, shoulder"):
        robot.load(file(tmp_path)).joint("wrist")


# --- writing ----------------------------------------------------------------------------------------------
def plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def test_what_is_written_elsewhere_is_the_same_robot(tmp_path: Path) -> None:
    nominal = robot.load(file(tmp_path, effects=[{**GAP, "nominal": True}], offsets="per_recording"))
    added = [
        effect("payload", "elbow", since=1.0, mass=0.3, position=(0.1, 0.0, -0.2)),
        effect("base_tilt", roll=np.float64(0.01)),
        effect("sensor_delay", "elbow", delay=0.004, channel="theta"),
    ]
    path = tmp_path / "elsewhere" / "deep" / "extended.yaml"
    robot.write(nominal.extended(added), path)
    read = robot.load(path)
    assert [law.key for law in read.effects] == [
        ("backlash", "elbow"),
        *(law.key for law in added),
    ]
    for law, expected in zip(read.effects[1:], added, strict=True):
        assert list(map(plain, law.p)) == list(map(plain, expected.p))
        assert law.since is None  # it belongs to a recording
    assert [law.nominal for law in read.effects] == [True, False, False, False]
    assert read.urdf.resolve() == nominal.urdf.resolve()
    assert read.file.offsets == "per_recording" and read.joint("elbow").drive == nominal.joint("elbow").drive


def test_a_load_that_comes_and_goes_is_not_written(tmp_path: Path) -> None:
    nominal = robot.load(file(tmp_path))
    picked = effect("payload", "elbow", since=1.0, switches=(2.0,), mass=0.3)
    tilt = effect("base_tilt", roll=0.01)
    path = tmp_path / "extended.yaml"
    robot.write(nominal.extended([picked, tilt]), path)
    assert [law.key for law in robot.load(path).effects] == [tilt.key]


def test_an_effect_that_is_listed_already_is_replaced(tmp_path: Path) -> None:
    nominal = robot.load(file(tmp_path, effects=[{**GAP, "nominal": True}]))
    (law,) = nominal.extended([effect("backlash", "elbow", gap=0.03)]).effects
    assert law.p.gap == 0.03
    assert nominal.effects[0].p.gap == 0.01


# --- arbitrary input --------------------------------------------------------------------------------------
def refuses_politely(text: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm2.urdf").write_text(URDF)
        path = Path(folder) / "arm2.yaml"
        path.write_bytes(text)
        try:
            robot.load(path)
        except FlexJointError as error:
            assert "\n" not in str(error)


yaml_like = st.text(st.sampled_from("abc:-[]{}#&*!|>'\"%@` \n\t0.1e9_=~?,\x00é"), max_size=80)


@examples
@given(st.one_of(st.binary(max_size=60), st.text(max_size=60).map(str.encode), yaml_like.map(str.encode)))
def test_arbitrary_text_is_refused_politely(text: bytes) -> None:
    refuses_politely(text)


@pytest.mark.parametrize(
    "text",
    ["a: 2001-99-99", "a: !!int x", "a: !!float x", "a: !!timestamp x", "a: !!int ''", "? {a: b}\n: c"],
)
def test_values_that_yaml_itself_stumbles_over_are_refused_politely(text: str) -> None:
    refuses_politely(text.encode())


scalars = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.dates(),
    st.sampled_from(["elbow", "wrist", "universe", "base_tilt", "payload"]),
)  # fmt: skip
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.one_of(scalars, st.just("effect")), inner, max_size=3)
    ),
    max_leaves=6,
)
PLACES = """
name urdf base gravity rates rates.control lock
tolerance tolerance.torque joints joints.elbow joints.elbow.stiffness joints.elbow.resolution
joints.elbow.controller
effects sources offsets initial sensing_delay package_dirs presets
anything
"""


@examples
@given(st.sampled_from(PLACES.split()), values)
def test_arbitrary_values_in_a_whole_file_are_refused_politely(place: str, value: Any) -> None:
    raw = content(rates={}, tolerance={}, effects=[dict(GAP)])
    inside: Any = raw
    *path, last = place.split(".")
    for key in path:
        inside = inside[key]
    inside[last] = value
    refuses_politely(yaml.safe_dump(raw).encode())


@examples
@given(st.sampled_from(["effect", "joint", "gap", "nominal", "since"]), values)
def test_arbitrary_values_in_an_effect_are_refused_politely(key: str, value: Any) -> None:
    refuses_politely(yaml.safe_dump(content(effects=[{**GAP, key: value}])).encode())
