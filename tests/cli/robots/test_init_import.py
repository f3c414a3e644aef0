"""`flexjoint init` and `flexjoint import`: what they print, write and refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import fake_diagnosis
from support.cli_runs import complaint, run
from support.logs import JOINTS, assert_is, motion, write_csv
from support.robots.robot_files import URDF

import flexjoint.diagnosis.pipeline
from flexjoint.recording import table
from flexjoint.robot import robot

M = motion(4.0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a description, a log of the form of a recording, and one of another program."""
    (tmp_path / "arm2.urdf").write_text(URDF)
    table.write(
        table.make(M.time, {("q", name): M.q[:, k] for k, name in enumerate(JOINTS)}), tmp_path / "own.csv"
    )
    write_csv(tmp_path / "log.csv", {"time": M.time, "pos_1": M.q[:, 0], "pos_2": M.q[:, 1]})
    (tmp_path / "map.yaml").write_text("joints: [shoulder, elbow]\nchannels: {q: pos}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- init ---------------------------------------------------------------------------------------------------
def test_init_writes_a_file_that_loads_and_says_what_is_next(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", "arm2.urdf") == 0
    printed = capsys.readouterr().out
    assert "wrote robot.yaml: rigid joints" in printed and "lines marked CHECK" in printed
    assert "next: flexjoint import LOG --robot robot.yaml --to table.parquet" in printed
    assert robot.load("robot.yaml").joint_names == ("shoulder", "elbow", "wrist")
    assert "robot.yaml is there already" in complaint(capsys, "init", "arm2.urdf")
    assert run("init", "arm2.urdf", "--force", "--rigid") == 0


def test_init_with_a_recording_holds_what_it_does_not_have(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", "arm2.urdf", "--recording", "own.csv") == 0
    printed = capsys.readouterr().out
    assert (
        "own.csv: q of shoulder, elbow; 250 Hz" in printed and "held: wrist (not in the recording" in printed
    )
    assert "next: flexjoint diagnose own.csv --robot robot.yaml --report report.html" in printed
    assert robot.load("robot.yaml").joint_names == JOINTS


def test_init_names_an_error_of_the_data_and_how_to_repair_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The motor's encoder of the elbow counts against its link's; the shoulder's is right."""
    sides = {(side, name): M.q[:, k] for k, name in enumerate(JOINTS) for side in ("q", "theta")}
    table.write(table.make(M.time, {**sides, ("theta", "elbow"): -M.q[:, 1]}), folder / "turned.csv")
    assert run("init", "arm2.urdf", "--recording", "turned.csv") == 0
    printed = capsys.readouterr().out
    assert "the motor encoder of elbow has the wrong sign" in printed and "of shoulder has" not in printed
    assert "Repair: theta.elbow = -1 * theta.elbow" in printed
    assert "next: flexjoint check-data turned.csv --robot robot.yaml --out repaired.parquet" in printed
    assert run("check-data", "turned.csv", "--robot", "robot.yaml", "--out", "repaired.parquet") == 0


def test_init_takes_another_programs_log(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", "arm2.urdf", "--recording", "log.csv", "--mapping", "map.yaml") == 0
    assert "--mapping map.yaml --report" in capsys.readouterr().out
    assert run("init", "arm2.urdf", "--recording", "own.csv", "--radians", "--force") == 0
    assert "with the same options" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere.urdf",), "nowhere.urdf does not exist"),
        (("arm2.urdf", "--out", "robot.txt"), "expected a name that ends in .yaml or .yml"),
        (("arm2.urdf", "--out", "."), "expected a name that ends in"),
        (("arm2.urdf", "--recording", "no.csv"), "no.csv does not exist"),
        (("arm2.urdf", "--recording", "log.csv"), "log.csv"),
        (("arm2.urdf", "--recording", "hip.csv"), "unknown joint 'hip'; valid: elbow, shoulder, wrist"),
        (("arm2.urdf", "--recording", "deg.csv"), "it looks like degrees"),
        (("kr300",), "kr300 is a shipped robot, whose file is written: say --robot kr300"),
        (("kr301",), "expected a URDF, MJCF or SDF"),
        (("arm2.urdf", "--gear", "x"), "expected numbers between commas, got 'x'"),
    ],
)
def test_init_refuses_in_one_line_and_writes_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    write_csv(folder / "hip.csv", {"time": M.time, "q.hip": M.q[:, 0]})
    write_csv(folder / "deg.csv", {"time": M.time, "q.elbow": np.degrees(M.q[:, 0])})
    before = {path.name for path in folder.iterdir()}
    assert said in complaint(capsys, "init", *words)
    assert {path.name for path in folder.iterdir()} == before


# --- import -------------------------------------------------------------------------------------------------
def test_import_tells_what_it_understood_and_writes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("import", "log.csv", "--mapping", "map.yaml", "--to", "out.parquet") == 0
    printed = capsys.readouterr().out
    assert "clock: time; 1000 samples in 3.996 s, 250 Hz; no gaps" in printed
    assert "joints: shoulder, elbow (in the order that was stated)" in printed
    assert "no joint beyond 0.9, so within one turn: --degrees if not" in printed
    assert "next: flexjoint diagnose out.parquet --robot robot.yaml" in printed
    assert_is(table.read("out.parquet"), "q", M.q)


def test_what_is_written_is_named_without_what_a_terminal_obeys(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    red = "\x1b[31m"
    (folder / f"{red}log.csv").write_text((folder / "own.csv").read_text())
    assert run("init", "arm2.urdf", "--recording", f"{red}log.csv", "--out", f"{red}r.yaml") == 0
    assert run("import", f"{red}log.csv", "--to", f"{red}t.csv") == 0
    assert run("import", f"{red}log.csv", "--signals") == 0
    assert run("check-data", f"{red}log.csv", "--robot", f"{red}r.yaml", "--out", f"{red}c.csv") == 0
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err and "wrote \\x1b[31mr.yaml" in said.out


def test_import_lists_signals(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("import", "log.csv", "--signals") == 0
    assert "pos: 1000 samples of 2" in capsys.readouterr().out


def test_options_answer_what_a_log_leaves_open(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    degrees = np.degrees(M.q) * 50.0
    columns = {"time": M.time, "theta_0": degrees[:, 0], "theta_1": degrees[:, 1]}
    write_csv(folder / "rotor.csv", columns)
    words = ("import", "rotor.csv", "--to", "out.csv")
    assert "give --joints NAME,NAME" in complaint(capsys, *words)
    joints = ("--joints", "shoulder,elbow")
    assert "Give --degrees or --radians, or --gear RATIO" in complaint(capsys, *words, *joints)
    assert run(*words, *joints, "--degrees", "--gear", "50") == 0
    assert_is(table.read("out.csv"), "theta", M.q)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("no.mcap", "--to", "out.csv"), "no.mcap does not exist; give the path of a file or folder"),
        (("log.csv",), "give --to TABLE.parquet, or --signals"),
        (("log.csv", "--to", "out.mat"), "expected a name that ends in .csv or .parquet"),
        (("log.csv", "--to", "log.csv"), "it is an input; give another name"),
        (("log.csv", "--to", "out.csv"), "which signal is which channel? Write a mapping"),
        (("log.csv", "--to", "out.csv", "--mapping", "no.yaml"), "mapping no.yaml does not exist"),
        (
            ("log.csv", "--to", "out.csv", "--mapping", "bad.yaml"),
            "unknown key 'chanels' (did you mean 'channels'?)",
        ),
        (("x.xyz", "--to", "out.csv"), "expected one of .csv, .txt"),
        ((".", "--to", "out.csv"), "is a folder, expected a bag of ROS 2"),
        (("own.csv", "--to", "out.csv", "--robot", "kr300"), "unknown joint 'shoulder'"),
        (("own.csv", "--to", "out.csv", "--degrees", "--radians"), "not allowed with argument"),
    ],
)
def test_import_refuses_in_one_line_and_writes_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    (folder / "bad.yaml").write_text("chanels: {}")
    (folder / "x.xyz").write_text("x")
    before = {path.name for path in folder.iterdir()}
    assert said in complaint(capsys, "import", *words)
    assert {path.name for path in folder.iterdir()} == before


# --- straight into a diagnosis ------------------------------------------------------------------------------
def test_diagnose_and_compare_take_a_log_with_its_mapping(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run("init", "arm2.urdf", "--recording", "own.csv") == 0
    given = []

    def diagnose(nominal: object, recordings: list[table.Recording], **options: object) -> object:
        given.extend(recordings)
        return fake_diagnosis.refused()

    monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", diagnose)
    words = ("diagnose", "log.csv", "--robot", "robot.yaml", "--mapping", "map.yaml", "--quiet")
    assert run(*words) == 0
    assert_is(given[0], "q", M.q)
    capsys.readouterr()
    assert "log.csv: no q_ref for joint shoulder" in complaint(
        capsys, "compare", "log.csv", "--robot", "robot.yaml", "--mapping", "map.yaml"
    )
    assert "which signal is which channel" not in complaint(
        capsys, "diagnose", "log.csv", "--robot", "robot.yaml"
    )
