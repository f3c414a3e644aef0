"""Unusable input on the command line: one line that says what was expected, exit code 2, nothing written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from support import fake_diagnosis
from support.cli_runs import complaint, run
from support.folders import locked

import flexjoint.diagnosis.pipeline
from flexjoint.cli.main import main
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.recording import table as recording
from flexjoint.robot.robot import Robot


# --- unusable input -----------------------------------------------------------------------------------------
def spoilt(path: Path, **changes: object) -> None:
    """Rewrite a CSV recording with some columns (an underscore for the dot) replaced."""
    table = recording.read(path)
    lines = {"time": table.time, **{f"{c}.{j}": values for (c, j), values in table.columns.items()}}
    lines.update({name.replace("__", "."): values for name, values in changes.items()})
    rows = [",".join(lines), *(",".join(map(str, row)) for row in zip(*lines.values(), strict=True))]
    path.write_text("\n".join(rows))


def no_recording(path: Path) -> None:
    path.unlink()


def empty(path: Path) -> None:
    path.write_text("")


def unknown_joint(path: Path) -> None:
    spoilt(path, q__ellbow=np.zeros(1000))


def backwards(path: Path) -> None:
    spoilt(path, time=np.arange(1000) % 20 / 250)


def not_a_number(path: Path) -> None:
    spoilt(path, q__elbow=np.full(1000, np.nan))


def degrees(path: Path) -> None:
    spoilt(path, dtheta__elbow=recording.read(path).get("dtheta", "elbow") * 180 / np.pi)


def all_degrees(path: Path) -> None:
    table = recording.read(path)
    angles = {k: v for k, v in table.columns.items() if k[0] != "tau_t"}
    spoilt(path, **{f"{c}__{j}": v * 180 / np.pi for (c, j), v in angles.items()})


def words_for_numbers(path: Path) -> None:
    spoilt(path, q__elbow=["high"] * 1000)


def slow(path: Path) -> None:
    spoilt(path, time=np.arange(1000) * 0.1)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (no_recording, "monday.csv does not exist; give a .csv or .parquet file"),
        (empty, "monday.csv is empty; expected a table with a time column"),
        (unknown_joint, "column q.ellbow: unknown joint 'ellbow' (did you mean 'elbow'?); valid: elbow"),
        (backwards, "time must increase strictly, but goes from 0.076 to 0 s in row 21"),
        (not_a_number, "column q.elbow holds 0 numbers in 1000 rows; leave a channel out that was not"),
        (degrees, "dtheta.elbow is 57.3 times the derivative of theta.elbow"),
        (all_degrees, "stiffness times (theta.shoulder - q.shoulder) is 57.3 times tau_t.shoulder"),
        (words_for_numbers, "column q.elbow holds string, expected numbers"),
        (slow, "a sample every 0.1 s is too coarse; record at 50 Hz or faster"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["diagnose", "compare"])
def test_an_unusable_recording_is_refused(
    tmp_path: Path, arm: Robot, monday: Path, spoil: Callable[[Path], None], said: str, command: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    spoil(monday)
    out = tmp_path / "out" / "d.json"
    assert said in complaint(capsys, command, monday, "--robot", arm.path, "--json", out)
    assert not out.parent.exists()


def changed(path: Path, **changes: object) -> None:
    raw = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**raw, **changes}))


def broken_yaml(path: Path) -> None:
    path.write_text("joints: {elbow: {stiffness: 260")


def missing_urdf(path: Path) -> None:
    (path.parent / "arm2.urdf").unlink()


def broken_urdf(path: Path) -> None:
    (path.parent / "arm2.urdf").write_text("<robot><link")


def unknown_key(path: Path) -> None:
    changed(path, gravitation=9.81)


def unknown_effect(path: Path) -> None:
    changed(path, effects=[{"effect": "blacklash", "joint": "elbow", "gap": 0.01}])


def same_effect_twice(path: Path) -> None:
    changed(path, effects=2 * [{"effect": "backlash", "joint": "elbow", "gap": 0.01}])


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (Path.unlink, "robot file {} does not exist; give the path of a robot YAML"),
        (broken_yaml, "{} is not valid YAML"),
        (missing_urdf, "arm2.urdf does not exist; `urdf` is relative to the YAML or package://"),
        (broken_urdf, "arm2.urdf cannot be loaded"),
        (unknown_key, "{}: unknown key 'gravitation' (did you mean 'gravity'?); valid: base, contacts"),
        (unknown_effect, "{}: unknown effect 'blacklash' (did you mean 'backlash'?); valid: asymmetric"),
        (same_effect_twice, "{}: backlash on elbow is listed twice; keep one entry"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["diagnose", "compare", "simulate"])
def test_an_unusable_robot_is_refused(
    tmp_path: Path, arm: Robot, monday: Path, spoil: Callable[[Path], None], said: str, command: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    spoil(arm.path)
    out = tmp_path / "out" / ("s.csv" if command == "simulate" else "d.json")
    rest = ["--reference", monday, "--out", out] if command == "simulate" else [monday, "--json", out]
    assert said.format(arm.path) in complaint(capsys, command, "--robot", arm.path, *rest)
    assert not out.parent.exists()


def test_an_unknown_shipped_robot_lists_those_there_are(
    monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = complaint(capsys, "compare", monday, "--robot", "kr30")
    assert "no robot 'kr30': give a YAML file or one of centauro, kr300, panda, rrbot" in said


@pytest.mark.parametrize("horizon", [0, -1, 1e9, "nan"])
def test_a_horizon_that_does_not_fit_is_refused(
    arm: Robot, monday: Path, horizon: object, capsys: pytest.CaptureFixture[str]
) -> None:
    said = complaint(capsys, "compare", monday, "--robot", arm.path, "--horizon", horizon)
    assert "does not fit into 4 s; give a horizon > 0" in said


def test_a_recording_that_drives_nothing_is_refused(
    arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no q_ref for joint shoulder" in complaint(capsys, "compare", monday, "--robot", arm.path)


# --- unwritable output --------------------------------------------------------------------------------------
@pytest.mark.parametrize("flag", ["--json", "--report", "--model"])
def test_wrong_suffixes_and_places_are_refused_before_the_work(
    tmp_path: Path, arm: Robot, monday: Path, flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    suffix = {"--json": ".json", "--report": ".html", "--model": ".yaml"}[flag]
    words = ["diagnose", monday, "--robot", arm.path, flag]
    assert f"expected a name that ends in {suffix}" in complaint(capsys, *words, tmp_path / "out.txt")
    (tmp_path / f"folder{suffix}").mkdir()
    assert "it is a folder" in complaint(capsys, *words, tmp_path / f"folder{suffix}")
    assert "no file can be made in" in complaint(capsys, *words, monday / f"below_a_file{suffix}")
    assert list((tmp_path / f"folder{suffix}").iterdir()) == []


def test_an_output_may_not_replace_an_input(
    tmp_path: Path, arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = arm.path.read_bytes(), monday.read_bytes()
    same = tmp_path / "." / arm.path.name
    said = complaint(capsys, "diagnose", monday, "--robot", arm.path, "--model", same)
    assert "it is an input; give another name" in said
    complaint(capsys, "simulate", "--robot", arm.path, "--reference", monday, "--out", monday)
    assert (arm.path.read_bytes(), monday.read_bytes()) == before


def test_the_demo_refuses_a_file_for_its_folder(monday: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "it is a file; give --out a folder" in complaint(capsys, "demo", "--out", monday)


def test_a_folder_without_permission_is_refused(
    tmp_path: Path, arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = locked(tmp_path / "locked") / "d.json"
    assert f"cannot write {out}" in complaint(capsys, "diagnose", monday, "--robot", arm.path, "--json", out)


def test_an_output_that_fails_late_leaves_no_part_of_it(
    tmp_path: Path,
    arm: Robot,
    monday: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A disk that fills up while the files are written."""

    def full(source: str, target: object) -> None:
        raise OSError(28, "No space left on device")

    def refused(*_: object, **__: object) -> Diagnosis:
        return fake_diagnosis.refused()

    monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", refused)
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(os, "replace", full)
    said = complaint(capsys, "diagnose", monday, "--robot", arm.path, "--json", tmp_path / "out" / "d.json")
    assert "No space left on device" in said
    assert list((tmp_path / "out").iterdir()) == []


def test_an_error_of_ours_is_not_dressed_up(
    monkeypatch: pytest.MonkeyPatch, arm: Robot, monday: Path
) -> None:
    """What no input can cause shows where it happened."""

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", broken)
    with pytest.raises(ZeroDivisionError):
        main(["diagnose", str(monday), "--robot", str(arm.path)])


def test_interrupting_is_one_line(
    monkeypatch: pytest.MonkeyPatch, arm: Robot, monday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", interrupted)
    assert run("diagnose", monday, "--robot", arm.path) == 130
    assert capsys.readouterr().err == "flexjoint: interrupted\n"
