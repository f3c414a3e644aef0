"""`flexjoint theta-d`: what it writes and prints, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow.csv
import pyarrow.parquet
import pytest
import yaml
from support import fake_diagnosis
from support.cli_runs import complaint, run
from support.robots import standing

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.recording import table as recording
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import simulate

NAMES = fake_diagnosis.JOINTS


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """Two links of 1 kg, centres 0.1 m from their axes, both joints at the same place, K = 260 N m/rad."""
    return fake_diagnosis.arm(tmp_path)


def poses(path: Path, **columns: object) -> Path:
    """A CSV of these columns, `__` for the dot."""
    given = {name.replace("__", "."): np.atleast_1d(values) for name, values in columns.items()}
    rows = [",".join(given), *(",".join(map(str, row)) for row in zip(*given.values(), strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return path


def columns_of(path: Path) -> dict[str, np.ndarray]:
    table = pyarrow.parquet.read_table(path) if path.suffix == ".parquet" else pyarrow.csv.read_csv(path)
    return {name: table.column(name).to_numpy() for name in table.column_names}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_of_poses_becomes_a_table_of_motors(
    tmp_path: Path, arm: Robot, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shoulder, elbow = np.array([0.0, 0.4, 1.2]), np.array([0.3, -1.0, 0.0])
    table = poses(tmp_path / "poses.csv", q__elbow=elbow, q__shoulder=shoulder)
    out = tmp_path / f"out{suffix}"
    assert run("theta-d", table, "--robot", arm.path, "--out", out, "--details") == 0
    got = columns_of(out)
    assert list(got) == [
        f"{c}.{j}" for c in ("q_ref", "theta_ref", "tau_ff", "tau_t", "g", "phi") for j in NAMES
    ]
    far = -0.981 * np.sin(shoulder + elbow)  # gravity pulls a link that stands up further over
    near = far - 0.981 * np.sin(shoulder)
    for joint, q, load in (("shoulder", shoulder, near), ("elbow", elbow, far)):
        np.testing.assert_array_equal(got[f"q_ref.{joint}"], q)
        for channel in ("tau_ff", "tau_t", "g"):
            np.testing.assert_allclose(got[f"{channel}.{joint}"], load, atol=1e-12)
        np.testing.assert_allclose(got[f"phi.{joint}"], load / 260, atol=1e-14)
        np.testing.assert_allclose(got[f"theta_ref.{joint}"], q + load / 260, atol=1e-14)
    printed = capsys.readouterr().out
    assert f"wrote {out}: 3 poses of 2 joints; largest deflection" in printed
    assert "(shoulder, pose 2)" in printed and "beyond" not in printed


def test_with_time_the_table_is_a_reference(tmp_path: Path, arm: Robot) -> None:
    """Simulated along it, the robot follows as along q_ref alone, for which the same is made by itself."""
    time = np.arange(60) / 100
    table = poses(tmp_path / "way.csv", time=time, q_ref__shoulder=np.sin(time), q_ref__elbow=0.2 * time)
    assert run("theta-d", table, "--robot", arm.path, "--out", tmp_path / "out.csv") == 0
    model = FlexibleJointModel(arm)
    ours = simulate(model, recording.read(tmp_path / "out.csv")).true
    bare = simulate(model, recording.read(table)).true
    for joint in NAMES:
        # between samples theta_ref is interpolated here and computed there: (10 ms)^2 / 8 of its curvature
        np.testing.assert_allclose(ours.get("q", joint), bare.get("q", joint), atol=1e-6)


def test_limits_are_printed_and_no_error(
    tmp_path: Path, arm: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    file = yaml.safe_load(arm.path.read_text())
    file["joints"]["elbow"]["torque_limit"] = 0.5
    arm.path.write_text(yaml.safe_dump(file))
    table = poses(tmp_path / "poses.csv", q__shoulder=[0.0, 0.5], q__elbow=[0.0, 1.0])
    words = ("theta-d", table, "--robot", arm.path, "--out", tmp_path / "out.csv", "--max-deflection", 0.004)
    assert run(*words) == 0
    printed = capsys.readouterr().out
    load = 0.981 * np.sin(1.5)
    assert f"beyond limits: motor torque of elbow: pose 1 needs -{load:.5g} N m" in printed
    assert "beyond limits: deflection of shoulder: pose 1" in printed


def test_effects_of_the_robot_file_count(tmp_path: Path, arm: Robot) -> None:
    """The motor gives 4/5 of what it is told, so it is told 5/4."""
    file = yaml.safe_load(arm.path.read_text())
    file["effects"] = [{"effect": "torque_gain", "joint": "elbow", "gain": -0.2}]
    arm.path.write_text(yaml.safe_dump(file))
    table = poses(tmp_path / "poses.csv", q__shoulder=0.3, q__elbow=0.9)
    assert run("theta-d", table, "--robot", arm.path, "--out", tmp_path / "out.csv") == 0
    got = columns_of(tmp_path / "out.csv")
    load = -0.981 * np.sin(1.2)
    assert got["tau_ff.elbow"][0] == pytest.approx(load / 0.8, rel=1e-12)
    assert got["tau_t.elbow"][0] == pytest.approx(load, rel=1e-12)


def test_a_robot_on_its_feet(tmp_path: Path) -> None:
    loaded = standing.centauro()
    path = tmp_path / "centauro.yaml"
    robot.write(loaded, path)
    pose = standing.spider(FlexibleJointModel(loaded))
    angles = {f"q__{joint.name}": pose[joint.idx_q] for joint in loaded.joints}
    table = poses(tmp_path / "poses.csv", base__pitch=0.05, base__roll=-0.02, **angles)
    feet = [word for foot in standing.FEET for word in ("--contact", foot.frame)]
    out = tmp_path / "out.csv"
    assert run("theta-d", table, "--robot", path, "--out", out, *feet) == 0
    tilted = pose.copy()
    tilted[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(-0.02, 0.05, 0.0)).coeffs()
    expected = equilibrium(FlexibleJointModel(loaded), tilted, standing.FEET)
    got = columns_of(out)
    for i, joint in enumerate(loaded.joint_names):
        np.testing.assert_allclose(got[f"theta_ref.{joint}"], expected.theta[:, i], atol=1e-12)


@pytest.mark.parametrize(
    ("columns", "words", "message"),
    [
        ({"q__shoulder": 0.1}, (), "no column q.elbow"),
        ({"q__shoulder": 0.1, "q__ellbow": 0.2}, (), "joint 'ellbow' (did you mean 'elbow'?)"),
        ({"q__shoulder": 0.1, "q__elbow": 0.2, "w__elbow": 0.1}, (), "column 'w.elbow'"),
        (
            {"q__shoulder": 0.1, "q__elbow": 0.2, "q_ref__elbow": 0.1},
            (),
            "appears in q.elbow and in q_ref.elbow",
        ),
        ({"q__shoulder": [0.1, 0.2], "q__elbow": [0.2, ""]}, (), "q.elbow has no number in row 2"),
        ({"q__shoulder": 0.1, "q__elbow": "bent"}, (), "q.elbow holds string"),
        ({"time": [1, 0], "q__shoulder": [0, 0], "q__elbow": [0, 0]}, (), "time must increase"),
        ({"q__shoulder": [], "q__elbow": []}, (), "holds"),
        ({"q__shoulder": 0.1, "q__elbow": 0.2}, ("--contact", "hand"), "frame 'hand'"),
        ({"q__shoulder": 0.1, "q__elbow": 0.2}, ("--max-deflection", "-1"), "max_deflection of shoulder"),
        ({"q__shoulder": 0.1, "q__elbow": 0.2, "base__roll": 0.1}, (), "column 'base.roll'"),
    ],
)
def test_unusable_tables_are_refused(
    tmp_path: Path,
    arm: Robot,
    capsys: pytest.CaptureFixture[str],
    columns: dict[str, object],
    words: tuple[str, ...],
    message: str,
) -> None:
    table = poses(tmp_path / "poses.csv", **columns)
    out = tmp_path / "out.csv"
    assert message in complaint(capsys, "theta-d", table, "--robot", arm.path, "--out", out, *words)
    assert not out.exists()


def test_unusable_places_are_refused(tmp_path: Path, arm: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    table = poses(tmp_path / "poses.csv", q__shoulder=0.1, q__elbow=0.2)
    words = ("theta-d", table, "--robot", arm.path, "--out")
    assert "it is an input" in complaint(capsys, *words, table)
    assert "ends in .csv or .parquet" in complaint(capsys, *words, tmp_path / "out.txt")
    away = ("theta-d", tmp_path / "none.csv", "--robot", arm.path, "--out", tmp_path / "out.csv")
    assert "does not exist" in complaint(capsys, *away)


def test_a_floating_base_needs_ground(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "centauro.yaml"
    robot.write(standing.centauro(), path)
    table = poses(tmp_path / "poses.csv", q__torso_yaw=0.0)
    words = ("theta-d", table, "--robot", path, "--out", tmp_path / "out.csv")
    assert "floating base: name what it stands on" in complaint(capsys, *words)
