"""`flexjoint export` as a user runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from support.cli_runs import complaint, run
from support.folders import locked
from support.robots.robot_files import file
from support.thorough import thorough

import flexjoint as fj
from flexjoint.cli.robots.export import differences
from flexjoint.diagnosis.comparison.compare import compare, compared
from flexjoint.effects import effect
from flexjoint.export.mujoco_run import MujocoRun
from flexjoint.export.targets import TARGETS, exported
from flexjoint.model.dynamics import FlexibleJointModel

KR300 = fj.shipped_robots()["kr300"].parent / "recordings"


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    effects = [
        {"effect": "backlash", "joint": "elbow", "gap": 1e-3},
        {"effect": "load_friction", "joint": "elbow", "coefficient": 0.1},
    ]
    return file(tmp_path, effects=effects, lock=["wrist"])


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_writes_and_says_what_is_lost(
    target: str, robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / f"out{TARGETS[target].suffixes[0]}"
    assert run("export", robot, "--to", target, "--out", out) == 0
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == f"wrote {out}: arm2 for {TARGETS[target].title}"
    assert "not expressible:" in said and "load_friction on elbow: " in said
    assert "load_friction on elbow: " in out.read_text()


def test_wrong_use_is_one_line_and_writes_nothing(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.xml"
    before = sorted(tmp_path.iterdir())
    wrong = [
        (
            ("export", robot, "--to", "mujoco", "--out", out),
            "valid: drake, isaaclab, mjcf, ros2_control, sdf, urdf",
        ),
        (("export", robot, "--to", "mjcf"), "required: --out"),
        (("export", robot, "--to", "mjcf", "--out", tmp_path / "arm.urdf"), "ends in .xml or .mjcf"),
        (("export", tmp_path / "none.yaml", "--to", "mjcf", "--out", out), "does not exist"),
        (("export", "nobody", "--to", "mjcf", "--out", out), "no robot 'nobody'"),
        (("export", tmp_path / "arm2.urdf", "--to", "mjcf", "--out", out), "flexjoint init"),
        (
            ("export", robot, "--to", "urdf", "--out", tmp_path / "arm2.urdf"),
            "it is the robot's own description",
        ),
        (("export", robot, "--to", "mjcf", "--out", tmp_path), "no suffix"),
        (
            ("export", robot, "--to", "urdf", "--out", tmp_path / "a.urdf", "--measure", robot),
            "use --to mjcf",
        ),
        (("export", robot, "--to", "mjcf", "--out", out, "--measure", tmp_path / "no.csv"), "no.csv"),
        (("export", robot, "--to", "mjcf", "--out", out, "--horizon", "nan"), "expected seconds above 0"),
    ]
    for words, said in wrong:
        assert said in complaint(capsys, *words), words
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_that_takes_no_file(robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("export", robot, "--to", "mjcf", "--out", locked(tmp_path / "locked") / "arm.xml")
    assert "no file can be made in" in complaint(capsys, *words)


def test_the_output_is_no_input(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = robot.with_suffix(".xml")
    other.write_text(robot.read_text())
    assert "it is an input" in complaint(capsys, "export", other, "--to", "mjcf", "--out", other)
    assert yaml.safe_load(other.read_text())["name"] == "arm2"


# --- the measured loss --------------------------------------------------------------------------------------
@thorough
def test_the_loss_on_a_real_machines_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.setenv("COLUMNS", "160")  # a narrow terminal breaks the table's heads
    rec, out = KR300 / "rec_B.parquet", tmp_path / "kr300.xml"
    assert run("export", "kr300", "--to", "mjcf", "--out", out, "--measure", rec, "--engine", "pin") == 0
    said = capsys.readouterr().out
    assert "20 windows of 0.5 s" in said and "phi.joint_1" in said
    loaded, recording = fj.load_robot("kr300"), fj.read_recording(rec)
    model = FlexibleJointModel(loaded)
    ours = compare(loaded, recording, engine="pin")
    theirs = compared(model, recording, rollout=MujocoRun(out.read_text(), model).rollout)
    loss = differences(ours, theirs)
    assert set(loss) == {name for name in ours.rms if not name.startswith("tau_t")}
    # MuJoCo's step of order 1 and its limits that never pull: far below what the simulation itself errs
    for name, rms in loss.items():
        assert rms < (0.05 if name.startswith("phi") else 0.01) * ours.rms[name], name


def test_the_loss_shows_what_is_not_expressible(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    robot = fj.load_robot(file(tmp_path, lock=["wrist"]))
    time = np.arange(0.0, 2.0, 1e-3)
    torque = {("tau_m", name): 2.0 * np.sin(3.0 * time) for name in robot.joint_names}
    recording = fj.simulate(
        FlexibleJointModel(robot), fj.make_recording(time, torque), drive="torque"
    ).measured
    rubbing = robot.extended([effect("load_friction", "elbow", coefficient=0.5)])
    loss = []
    for which in (robot, rubbing):
        model = FlexibleJointModel(which)
        run = MujocoRun(exported(which, "mjcf").text, model)
        both = compared(model, recording, engine="pin"), compared(model, recording, rollout=run.rollout)
        loss.append(differences(*both)["q.elbow"])
    assert loss[1] > 5.0 * loss[0]


def test_a_recording_without_torques_measures_nothing(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    time = np.arange(0.0, 2.0, 2e-3)
    columns = {("q", name): 0.3 * np.sin(2.0 * time) for name in ("shoulder", "elbow")}
    columns |= {("q_ref", name): values for (_, name), values in list(columns.items())}
    rec, out = tmp_path / "rec.csv", tmp_path / "arm.xml"
    fj.make_recording(time, columns).write(rec)
    words = ("export", robot, "--to", "mjcf", "--out", out, "--measure", rec)
    assert "expected tau_m or tau_motor of every joint" in complaint(capsys, *words)
    assert not out.exists()
