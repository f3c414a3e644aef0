"""The command line: what it prints, writes and returns."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import fake_diagnosis
from support.cli_runs import complaint, run

import flexjoint.diagnosis.pipeline
from flexjoint.cli import options
from flexjoint.core.running.budget import Budget
from flexjoint.diagnosis.result import Diagnosis, WithinTolerance
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot
from flexjoint.simulation.compiled import shared
from flexjoint.simulation.options import ENGINES
from flexjoint.simulation.simulate import simulate


@pytest.fixture
def diagnosed(monkeypatch: pytest.MonkeyPatch) -> Callable[[Diagnosis], None]:
    """Replaces the diagnosis by a given one: these tests are about what the command makes of it."""

    def give(result: Diagnosis) -> None:
        def diagnose(
            nominal: Robot,
            recordings: Sequence[Recording],
            *,
            progress: object,
            payloads: object,
            refine: bool,
            check_data: bool,
            budget: Budget,
        ) -> Diagnosis:
            assert nominal.joint_names == fake_diagnosis.JOINTS and len(recordings) >= 1
            return result

        monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", diagnose)

    return give


# --- start-up and usage -----------------------------------------------------------------------------------
def test_help_is_quick_and_names_every_command() -> None:
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "flexjoint", "--help"], capture_output=True, text=True, check=False
    )
    assert time.monotonic() - begin < 1.0  # about 0.1 s: no heavy module is imported
    assert done.returncode == 0
    for command in (
        "diagnose", "compare", "simulate", "plan", "theta-d", "view", "paper", "demo", "robots", "effects",
    ):  # fmt: skip
        assert command in done.stdout


@pytest.mark.parametrize(
    "words", [[], ["diagnos"], ["diagnose"], ["compare", "a.csv"], ["simulate", "--out", "x.csv"]]
)
def test_wrong_usage_is_one_line(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    assert "--help" in complaint(capsys, *words)


def test_robots_and_effects_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("robots") == 0
    assert (
        "kr300: joint_1, joint_2" in (robots := capsys.readouterr().out) and "rec_A, rec_B, rec_C" in robots
    )
    assert run("effects") == 0
    listed = capsys.readouterr().out
    assert "backlash(gap [rad])" in listed and "On the motor." in listed


def test_a_reader_that_has_enough_is_no_error() -> None:
    done = subprocess.run(
        f"{sys.executable} -m flexjoint effects | head -n 1",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == "" and done.stdout.count("\n") == 1


# --- compare and simulate ---------------------------------------------------------------------------------
def test_compare_prints_and_writes_the_errors(
    tmp_path: Path, arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    driven = recording.read(monday)
    zero = np.zeros(len(driven.time))
    columns = dict(driven.columns) | {("tau_motor", joint): zero for joint in fake_diagnosis.JOINTS}
    recording.write(Recording(driven.time, columns), monday)
    out = tmp_path / "errors.json"
    assert run("compare", monday, "--robot", arm.path, "--horizon", 0.25, "--json", out) == 0
    errors = json.loads(out.read_text())
    assert set(errors) == {"rms", "nrmse", "horizon", "windows"}
    assert errors["horizon"] == 0.25 and errors["windows"] == 16
    assert {"q.elbow", "tau_t.shoulder", "phi.elbow"} <= set(errors["rms"])
    printed = capsys.readouterr().out
    assert "16 windows of 0.25 s" in printed and "phi.elbow" in printed and "N m" in printed


def test_simulate_writes_a_recording_that_compares_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = np.arange(400) / 200
    told = {("q_ref", joint): 0.3 * np.sin(2 * at) for joint in ("joint1", "joint2")}
    recording.write(recording.make(at, told), tmp_path / "told.csv")
    out = tmp_path / "runs" / "simulated.parquet"
    assert run("simulate", "--robot", "rrbot", "--reference", tmp_path / "told.csv", "--out", out) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    simulated = recording.read(out)
    assert simulated.joints == ("joint1", "joint2") and simulated.has("tau_m", "joint1")
    assert run("compare", out, "--robot", "rrbot", "--json", tmp_path / "errors.json") == 0
    errors = json.loads((tmp_path / "errors.json").read_text())
    assert max(errors["nrmse"].values()) < 0.01  # the same model on both sides; only start states differ


def test_the_engine_is_chosen_by_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    at = np.arange(100) / 200
    told = {("q_ref", joint): 0.3 * np.sin(2 * at) for joint in ("joint1", "joint2")}
    recording.write(recording.make(at, told), tmp_path / "told.csv")
    common = ("simulate", "--robot", "rrbot", "--reference", tmp_path / "told.csv", "--out")
    runs, errors = [], []
    for name in options.ENGINES:
        assert run(*common, tmp_path / f"{name}.csv", "--engine", name) == 0
        runs.append(recording.read(tmp_path / f"{name}.csv").get("theta", "joint2"))
        where = tmp_path / f"{name}.json"
        compared = ("compare", tmp_path / "auto.csv", "--robot", "rrbot", "--horizon", 0.2)
        assert run(*compared, "--engine", name, "--json", where) == 0
        errors.append(json.loads(where.read_text())["rms"]["theta.joint2"])
    np.testing.assert_array_equal(runs[0], runs[2])  # auto leaves short runs to the pin loop
    np.testing.assert_allclose(runs[1], runs[2], rtol=0, atol=1e-9)
    assert errors[0] == errors[2] == pytest.approx(errors[1], abs=1e-9)
    monkeypatch.setattr("flexjoint.simulation.compiled.cache.compilers", lambda: ())
    shared._made.clear()
    capsys.readouterr()
    complaint(capsys, *common, tmp_path / "none.csv", "--engine", "compiled")
    assert options.ENGINES == ENGINES


# --- diagnose ---------------------------------------------------------------------------------------------
def outputs(tmp_path: Path) -> dict[str, Path]:
    folder = tmp_path / "out"
    return {
        "--json": folder / "d.json",
        "--report": folder / "d.html",
        "--model": folder / "robots" / "arm.yaml",
    }


def flags(files: dict[str, Path]) -> list[object]:
    return [word for pair in files.items() for word in pair]


@pytest.mark.parametrize("verdict", ["causes", "healthy", "unexplained", "refused"])
def test_every_verdict_is_written_and_is_no_failure(
    tmp_path: Path, arm: Robot, monday: Path, diagnosed: Callable[[Diagnosis], None], verdict: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    measured = fake_diagnosis.signals(seconds=4.0)
    before, after = (fake_diagnosis.simulation(measured, size) for size in (0.3, 0.02))
    results = {
        "causes": fake_diagnosis.causes(measured, before, after),
        "healthy": fake_diagnosis.healthy(measured, before),
        "unexplained": fake_diagnosis.unexplained(measured, before),
        "refused": fake_diagnosis.refused(),
    }
    diagnosed(results[verdict])
    files = outputs(tmp_path)
    assert run("diagnose", monday, monday, "--robot", arm.path, *flags(files)) == 0
    said = json.loads(files["--json"].read_text())
    assert said["schema"] == 1 and said["verdict"] == verdict and said["model"] == "robots/arm.yaml"
    assert "<html" in files["--report"].read_text()
    extended = robot.load(files["--model"])
    named = [(f["effect"], f["joint"]) for f in said["findings"]]
    assert [effect.key for effect in extended.effects] == named
    printed = capsys.readouterr()
    assert printed.err == "" and all(f"wrote {path}" in printed.out for path in files.values())


def test_unlikely_causes_stay_out_of_the_written_robot_unless_asked_for(
    diagnosed: Callable[[Diagnosis], None],
    arm: Robot,
    monday: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    likely, unlikely = fake_diagnosis.two_causes().findings
    diagnosed(replace(fake_diagnosis.two_causes(), findings=(likely, replace(unlikely, probability=0.31))))
    out = tmp_path / "extended.yaml"
    words = ("diagnose", monday, "--robot", arm.path, "--model", out)
    assert run(*words) == 0
    said = " ".join(capsys.readouterr().out.split())
    left = "sensor delay at shoulder (31 %), less likely than 50 %; --all-causes puts it in"
    assert f"wrote {out} without {left}" in said
    assert [str(e) for e in robot.load(out).effects] == ["motor_coulomb_friction on elbow"]
    assert run(*words, "--all-causes") == 0
    assert f"wrote {out}\n" in capsys.readouterr().out
    assert len(robot.load(out).effects) == 2


def test_numbers_within_their_tolerance_are_changed_where_that_is_asked_for(
    diagnosed: Callable[[Diagnosis], None],
    arm: Robot,
    monday: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A number of the robot, and one of a finding."""
    found = fake_diagnosis.two_causes()
    off = (
        WithinTolerance("motor_viscous_friction", "shoulder", "coefficient", -0.4),
        WithinTolerance("motor_coulomb_friction", "elbow", "level", 0.25),
    )
    diagnosed(replace(found, within_tolerance=off))
    out = tmp_path / "extended.yaml"
    words = ("diagnose", monday, "--robot", arm.path, "--model", out)
    assert run(*words) == 0
    assert "within their tolerances are as they were; --numbers changes them" in capsys.readouterr().out
    was = {e.key: e for e in robot.load(out).effects}
    assert run(*words, "--numbers") == 0
    assert "--numbers" not in capsys.readouterr().out
    now = {e.key: e for e in robot.load(out).effects}
    assert set(now) - set(was) == {("motor_viscous_friction", "shoulder")}
    assert now["motor_viscous_friction", "shoulder"].p.coefficient == -0.4
    key = ("motor_coulomb_friction", "elbow")
    assert now[key].p.level == pytest.approx(was[key].p.level + 0.25)


def test_a_description_is_no_robot_file(arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """But it can be looked at."""
    said = complaint(capsys, "compare", monday, "--robot", arm.urdf)
    assert "arm2.urdf is a description and says nothing of springs and motors; write a robot file" in said


def test_quiet_prints_nothing(
    arm: Robot, monday: Path, diagnosed: Callable[[Diagnosis], None], capsys: pytest.CaptureFixture[str]
) -> None:
    diagnosed(fake_diagnosis.refused())
    assert run("diagnose", monday, "--robot", arm.path, "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_without_a_model_the_json_names_none(
    tmp_path: Path, arm: Robot, monday: Path, diagnosed: Callable[[Diagnosis], None]
) -> None:
    diagnosed(fake_diagnosis.refused())
    assert run("diagnose", monday, "--robot", arm.path, "--json", tmp_path / "d.json") == 0
    assert json.loads((tmp_path / "d.json").read_text())["model"] is None


def test_a_planted_cause_is_named_and_gains(tmp_path: Path) -> None:
    """The whole chain once, with the real diagnosis; how well it names is tested elsewhere."""
    nominal = robot.load("rrbot_last_joint")
    friction = effect("motor_coulomb_friction", "joint2", level=0.6)
    at = np.arange(8000) / 1000
    told = 0.5 * np.sin(2.5 * at) + 0.25 * np.sin(7.0 * at)
    machine = FlexibleJointModel(nominal.extended([friction]))
    noise = {"q": 2e-5, "theta": 2e-5, "dq": 4e-3, "dtheta": 4e-3, "tau_t": 0.02}
    reference = recording.make(at, {("q_ref", "joint2"): told})
    measured = simulate(machine, reference, sample_rate=500, noise=noise, seed=4).measured
    recording.write(measured, tmp_path / "rec.parquet")
    files = {"--json": tmp_path / "d.json", "--model": tmp_path / "m.yaml", "--report": tmp_path / "d.html"}
    assert (
        run("diagnose", tmp_path / "rec.parquet", "--robot", "rrbot_last_joint", "--quiet", *flags(files))
        == 0
    )
    said = json.loads(files["--json"].read_text())
    assert [(f["effect"], f["joint"]) for f in said["findings"]] == [("motor_coulomb_friction", "joint2")]
    error = []
    for model in ("rrbot_last_joint", files["--model"]):
        words = ["compare", tmp_path / "rec.parquet", "--robot", model, "--json", tmp_path / "c.json"]
        assert run(*words) == 0
        error.append(json.loads((tmp_path / "c.json").read_text())["rms"]["q.joint2"])
    assert error[1] < 0.1 * error[0]


# --- how long it takes -------------------------------------------------------------------------------------
@pytest.mark.parametrize("command", ["diagnose", "compare"])
def test_a_budget_that_is_no_time_is_refused(
    command: str, arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = complaint(capsys, command, monday, "--robot", arm.path, "--budget", "soon")
    assert "budget: expected a time such as 60s, 5min or 1h, got 'soon'" in said
