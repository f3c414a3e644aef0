"""CENTAURO and the other robots on descriptions of example-robot-data: masses, sections, presets, poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import flexjoint
from flexjoint.cli.main import main
from flexjoint.core.errors import RobotError
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.robot import robot
from flexjoint.simulation.simulate import simulate

# spawned, floating, actuated joints, mass [kg]: sums of the URDF's masses, to the digits written
TABLE = [
    (["pelvis"], False, 0, 27.149),
    (["torso"], False, 3, 41.283),
    (["torso", "arms"], False, 15, 62.669),
    (["legs"], True, 20, 74.170),
    (["legs", "wheels"], True, 24, 81.598),
    (["torso", "legs"], True, 23, 88.304),
    (["torso", "arms", "legs"], True, 35, 109.690),
    (None, True, 39, 117.118),
]


@pytest.mark.parametrize(("sections", "floating", "actuated", "mass"), TABLE)
def test_the_table_of_masses(sections: list[str] | None, floating: bool, actuated: int, mass: float) -> None:
    loaded = robot.load("centauro", sections=sections)
    assert loaded.floating is floating and len(loaded.joints) == actuated
    assert loaded.model.nv == actuated + (6 if floating else 0)
    assert loaded.mass == pytest.approx(mass, abs=5.1e-4)


@pytest.mark.parametrize(
    ("asked", "spawned", "disabled"),
    [
        (["arms"], ["pelvis"], ["arms"]),
        (["wheels", "torso"], ["pelvis", "torso"], ["wheels"]),
        (["legs", "wheel_2", "left_arm"], ["pelvis", "legs", "wheel_2"], ["left_arm"]),
        (["leg_1", "wheels"], ["pelvis", "leg_1", "wheel_1"], ["wheel_2", "wheel_3", "wheel_4"]),
        (["wheel_1", "wheel_2", "wheel_3", "wheel_4", "legs"], ["pelvis", "legs", "wheels"], []),
    ],
)
def test_what_hangs_on_a_missing_section_is_missing(
    asked: list[str], spawned: list[str], disabled: list[str]
) -> None:
    loaded = robot.load("centauro", sections=asked)
    assert list(loaded.sections) == spawned and list(loaded.disabled) == disabled


def test_the_base_is_stationary_when_grounded() -> None:
    loaded = robot.load("centauro", grounded=True)
    assert not loaded.floating and loaded.model.nv == 39 and loaded.mass == pytest.approx(117.118, abs=5e-4)


def test_a_section_takes_its_mass_with_it() -> None:
    """The dynamics of the rest are those of the whole robot with massless missing bodies: exact but for the
    order of sums."""
    part = robot.load("centauro", sections=["torso", "arms"]).model
    whole = robot.load("centauro", grounded=True).model.copy()
    for index in range(1, whole.njoints):
        if not part.existJointName(whole.names[index]):
            whole.inertias[index] = pin.Inertia.Zero()
    random = np.random.default_rng(1)
    q, v, a = random.uniform(-1.0, 1.0, (3, part.nv))
    full = np.zeros((3, whole.nv))
    here = [whole.joints[whole.getJointId(name)].idx_v for name in part.names[1:]]
    full[:, here] = q, v, a
    expected = pin.rnea(whole, whole.createData(), *full)[here]
    np.testing.assert_allclose(pin.rnea(part, part.createData(), q, v, a), expected, rtol=0, atol=1e-11)


def test_presets() -> None:
    hard, soft = robot.load("centauro", preset="2017"), robot.load("centauro", preset="soft")
    assert hard.joints == robot.load("centauro").joints
    drive = soft.joint("hip_yaw_1").drive
    assert (drive.K, drive.D, drive.B) == (5000.0, 2.0, 0.645)
    assert [soft.joint(f"j_arm1_{k}").drive.K for k in (1, 4, 5)] == [3000.0, 3000.0, 1500.0]
    assert hard.joint("j_arm1_5").drive.K == 9400.0 and hard.joint("velodyne_joint").rigid
    assert soft.preset == "soft" and hard.model.njoints == soft.model.njoints


# leg angles by the vertical shank, contact height and support [m]: the table, to its digits
@pytest.mark.parametrize(
    ("pose", "height", "length", "width"),
    [("initial", -0.8108, 0.699, 0.700), ("spider", -0.75, 0.9, 0.9), ("mammal", -0.8804, 0.5, 0.445)],
)
def test_poses_stand_level_within_limits(pose: str, height: float, length: float, width: float) -> None:
    loaded = robot.load("centauro")
    model, q = loaded.model, loaded.configuration(pose)
    assert np.all(q[7:] >= model.lowerPositionLimit[7:]) and np.all(q[7:] <= model.upperPositionLimit[7:])
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    frames = [entry.frame for entry in loaded.file.contacts]
    feet = np.array([data.oMf[model.getFrameId(frame)].translation for frame in frames])
    np.testing.assert_allclose(feet[:, 2], height, atol=1e-4)
    assert np.ptp(feet[:, 2]) < 2e-6  # the SRDF's angles have six digits, and legs of 0.4 m
    np.testing.assert_allclose(np.ptp(feet[:, :2], axis=0), (length, width), atol=1e-3)
    centre = pin.centerOfMass(model, data, q)
    assert np.all(np.abs(centre[:2] - feet[:, :2].mean(axis=0)) < 0.5 * np.array([length, width]))


def test_continuous_wheels_turn_and_other_limits_stay() -> None:
    model = robot.load("centauro").model
    wheel, arm = (model.joints[model.getJointId(name)].idx_q for name in ("j_wheel_3", "j_arm1_2"))
    assert model.upperPositionLimit[wheel] > 1e3
    assert model.lowerPositionLimit[arm] == pytest.approx(0.02)


@pytest.mark.parametrize("preset", ["2017", "soft"])
def test_a_written_choice_is_the_same_robot(tmp_path: Path, preset: str) -> None:
    chosen = robot.load("centauro", sections=["torso", "right_arm"], preset=preset)
    robot.write(chosen, tmp_path / "there" / "out.yaml")
    read = robot.load(tmp_path / "there" / "out.yaml")
    assert read.joints == chosen.joints and read.sections == chosen.sections == (
        "pelvis",
        "torso",
        "right_arm",
    )
    assert read.mass == chosen.mass and read.file.urdf == chosen.file.urdf


# --- simulated ------------------------------------------------------------------------------------------
CHOICES = [
    ("ur5", None, None),
    ("panda", None, None),
    ("talos_arm", None, None),
    ("centauro", ["torso", "arms"], "soft"),
    ("centauro", None, None),
]


@pytest.mark.parametrize(("name", "sections", "preset"), CHOICES)
def test_it_holds_and_follows(name: str, sections: list[str] | None, preset: str | None) -> None:
    loaded = robot.load(name, sections=sections, preset=preset, grounded=True)
    time = np.arange(0.0, 1.5, 2e-3)
    start = loaded.configuration()
    goal = {joint.name: start[joint.idx_q] + 0.1 * (time > 0.2) for joint in loaded.joints}
    table = recording.make(time, {("q_ref", joint): values for joint, values in goal.items()})
    run = simulate(FlexibleJointModel(loaded), table).true
    for joint, values in goal.items():
        assert abs(run.get("q", joint)[10] - values[10]) < 1e-4  # theta_d and g(q_d) hold it from the start
        # 1.3 s after a step of 0.1 rad: 2 % of it, a usual settling band
        assert abs(run.get("q", joint)[-1] - values[-1]) < 2e-3


def test_limits_of_the_ready_made_arms_are_the_descriptions() -> None:
    for name in ("ur5", "panda", "talos_arm", "centauro"):
        loaded = robot.load(name)
        for joint in loaded.joints:
            assert joint.torque_limit == pytest.approx(loaded.model.upperEffortLimit[joint.idx_v]), joint.name


@pytest.mark.parametrize("name", ["ur5", "panda", "talos_arm", "centauro"])
def test_what_is_assumed_is_flagged_in_the_file(name: str) -> None:
    loaded = robot.load(name)
    assumed = [key for key, text in loaded.file.sources.items() if "ASSUMPTION" in text]
    assert "gains" in assumed and "motor_damping" in assumed
    for path in loaded.path.parent.iterdir():
        assert "/home/" not in path.read_text() and "site-packages" not in path.read_text()


# --- command line -------------------------------------------------------------------------------------
def test_the_commands_take_the_choice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    upper = robot.load("centauro", sections=["torso"])
    table = recording.make(np.linspace(0.0, 0.2, 50), {("q_ref", j): np.zeros(50) for j in upper.joint_names})
    recording.write(table, tmp_path / "ref.csv")
    where = ["--reference", str(tmp_path / "ref.csv"), "--out", str(tmp_path / "out.csv")]
    wanted = ["--robot", "centauro", "--sections", "torso, wheels", "--preset", "soft", "--grounded"]
    assert main(["simulate", *wanted, *where]) == 0
    assert "centauro without wheels: what they hang on is not there" in capsys.readouterr().err
    assert set(flexjoint.read_recording(tmp_path / "out.csv").joints) == set(upper.joint_names)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sections", "arm"], "unknown section 'arm' (did you mean 'arms'?); valid: arms, left_arm"),
        (["--sections", "arms"], "centauro with pelvis alone has no actuated joint; add sections"),
        (["--preset", "hard"], "unknown preset 'hard'; valid: 2017, soft"),
        (["--robot", "kr300", "--sections", "arms"], "the robot defines none"),
        (["--robot", "centaur"], "no robot 'centaur': give a YAML file or one of centauro"),
    ],
)
def test_a_wrong_choice_is_one_line(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    robots = [] if "--robot" in options else ["--robot", "centauro"]
    assert main(["simulate", *robots, *options, "--reference", "ref.csv", "--out", "out.csv"]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert said in error[-1] and len(error) <= 1 + ("arms" in options)


def test_the_list_says_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    said = capsys.readouterr().out
    for part in ("centauro: 39 joints, floating base, 117.1 kg", "presets: 2017, soft", "arms (left_arm,"):
        assert part in said
    assert "talos_arm" in said and "panda" in said and "assumed" in said
    assert max(map(len, said.splitlines())) <= 160


def test_an_unknown_pose_lists_the_known() -> None:
    with pytest.raises(ValueError, match="unknown pose 'sitting'; valid: initial, mammal, spider"):
        robot.load("centauro").configuration("sitting")


def test_a_section_whose_root_is_no_joint_is_refused(tmp_path: Path) -> None:
    text = (robot.shipped_robots()["centauro"]).read_text().replace("[torso_yaw]", "[torso_yawn]")
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(
        RobotError, match=r"section torso: unknown joint 'torso_yawn' \(did you mean 'torso_yaw'"
    ):
        robot.load(tmp_path / "c.yaml")
