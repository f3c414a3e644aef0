"""The open benchmark: a folder that tells nothing, a score that can be checked by hand, and its commands."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.pages import ROOT
from support.thorough import thorough

from flexjoint.cli.main import main
from flexjoint.effects import catalogue
from flexjoint.recording import table
from flexjoint.recording.checks import check
from flexjoint.robot import robot
from flexjoint_benchmark import BenchmarkError
from flexjoint_benchmark.adapters import least_squares
from flexjoint_benchmark.adapters.joints import read
from flexjoint_benchmark.cases import EVERY, PARTS
from flexjoint_benchmark.folder import cases, make, truth
from flexjoint_benchmark.score import score


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("benchmark") / "of_two"
    assert make(out, 2, 3, ("clean", "healthy")) == 4
    return out


def answers(folder: Path, said: dict[str, list[dict[str, Any]]], name: str = "answers.json") -> Path:
    path = folder.parent / name
    told = {case: {"findings": findings, "seconds": 2.0} for case, findings in said.items()}
    path.write_text(json.dumps({"schema": 1, "tool": "by hand", "answers": told}))
    return path


def named(entry: dict[str, Any], **change: Any) -> dict[str, Any]:
    """A planted cause as an answer names it."""
    numbers = {name: {"value": value, "std": 0.0} for name, value in entry["parameters"].items()}
    return {"effect": entry["effect"], "joint": entry["joint"], "parameters": numbers, **change}


# --- the folder -------------------------------------------------------------------------------------------
def test_every_case_is_a_recording_of_its_nominal_model(folder: Path) -> None:
    listed = cases(folder)
    assert len(listed["cases"]) == 4
    for entry in listed["cases"].values():
        nominal = robot.load(folder / entry["robot"])
        check(nominal, table.read(folder / entry["recording"]))
        assert list(nominal.joint_names) == entry["joints"]


def test_the_effects_that_answers_may_name_are_the_catalogue(folder: Path) -> None:
    listed = cases(folder)["effects"]
    assert set(listed) == set(EVERY) <= set(catalogue())
    for name, effect in listed.items():
        assert set(effect["parameters"]) <= {param.name for param in catalogue()[name].params} | {
            "channel",
            "side",
        }


def test_nothing_in_the_open_tells_the_truth(folder: Path) -> None:
    planted = {entry["effect"] for t in truth(folder).values() for entry in t["truth"]}
    assert planted
    for path in folder.rglob("*"):
        if path.suffix in (".yaml", ".urdf", ".sealed", ".md"):
            assert not any(effect in path.read_text() for effect in planted), path
    assert {t["part"] for t in truth(folder).values()} == {"clean", "healthy"}


def test_the_same_seed_makes_the_same_folder(tmp_path: Path) -> None:
    held = []
    for seed, name in ((3, "one"), (3, "again"), (4, "other")):
        make(tmp_path / name, 1, seed, ("healthy",))
        files = [path for path in sorted((tmp_path / name).rglob("*")) if path.is_file()]
        held.append({path.relative_to(tmp_path / name).as_posix(): path.read_bytes() for path in files})
    assert held[0] == held[1] != held[2]


def test_real_machines_come_with_their_licence(tmp_path: Path) -> None:
    make(tmp_path / "real", 1, 1, ("healthy",), robot.robots_folder())
    listed = cases(tmp_path / "real")["cases"]
    assert {"kr300_rec_A", "kr300_rec_B", "kr300_rec_C", "tx40_rec"} <= set(listed)
    for name in ("kr300_rec_B", "tx40_rec"):
        assert (tmp_path / "real" / name / "LICENSE-DATA").is_file()
        check(
            robot.load(tmp_path / "real" / listed[name]["robot"]),
            table.read(tmp_path / "real" / listed[name]["recording"]),
        )


# --- the score --------------------------------------------------------------------------------------------
def test_the_truth_itself_is_right(folder: Path) -> None:
    said = {name: [named(entry) for entry in t["truth"]] for name, t in truth(folder).items()}
    clean, healthy = score(folder, answers(folder, said)).rows
    assert (clean.right, clean.found, clean.causes, clean.names, clean.false_names) == (2, 2, 2, 2, 0)
    assert clean.size_error == 0.0 and clean.seconds == 2.0
    assert (healthy.right, healthy.names) == (2, 0)


def test_a_false_name_a_wrong_joint_and_silence_are_counted(folder: Path) -> None:
    true = truth(folder)
    clean = [name for name, t in true.items() if t["part"] == "clean"]
    healthy = [name for name, t in true.items() if t["part"] == "healthy"]
    (entry,) = true[clean[0]]["truth"]
    extra = {"effect": "cogging", "joint": true[clean[0]]["joints"][0], "parameters": {}}
    assert entry["effect"] != "cogging"
    said = {
        clean[0]: [named(entry), extra],
        healthy[0]: [{"effect": "payload", "joint": None, "probability": 0.49}],
    }
    rows = {row.part: row for row in score(folder, answers(folder, said)).rows}
    assert (rows["clean"].right, rows["clean"].found, rows["clean"].false_names) == (0, 1, 1)
    assert rows["clean"].answered == 1  # the other case: nothing was named in it
    assert (rows["healthy"].right, rows["healthy"].names) == (2, 0)  # below one half it is no name
    said = {healthy[0]: [{"effect": "payload", "joint": true[healthy[0]]["joints"][0], "probability": 0.5}]}
    rows = {row.part: row for row in score(folder, answers(folder, said)).rows}
    assert (rows["healthy"].right, rows["healthy"].false_names) == (1, 1)


def test_a_tie_and_an_equivalent_are_right_and_have_no_size(folder: Path) -> None:
    true = truth(folder)
    name, entry = next((n, t["truth"][0]) for n, t in true.items() if t["part"] == "clean")
    tied = {"effect": "cogging", "joint": entry["joint"]}
    tied["indistinguishable"] = [{"effect": entry["effect"], "joint": entry["joint"]}]
    clean = score(folder, answers(folder, {name: [tied]})).rows[0]
    assert (clean.right, clean.found, clean.false_names) == (1, 1, 0)
    assert clean.to_json()["size_error"] is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[]", "expected an object"),
        ('{"schema": 2, "answers": {}}', '"schema": 1'),
        ('{"schema": 1, "answers": {"c9999": {"findings": []}}}', "no case 'c9999'"),
        ('{"schema": 1, "answers": {"c0001": {}}}', "give an empty one"),
        (
            '{"schema": 1, "answers": {"c0001": {"findings": [{"effect": "slack"}]}}}',
            "unknown effect 'slack'",
        ),
        (
            '{"schema": 1, "answers": {"c0001": {"findings": [{"effect": "backlash", "joint": "knee"}]}}}',
            "unknown joint 'knee'",
        ),
        (
            '{"schema": 1, "answers": {"c0001": {"findings": [{"effect": "backlash", "probability": 2}]}}}',
            "between 0 and 1",
        ),
        (
            '{"schema": 1, "answers": {"c0001": {"findings":'
            ' [{"effect": "backlash", "indistinguishable": [1]}]}}}',
            '"indistinguishable" is a list of',
        ),
        ("[" * 100_000, "is nested too deeply"),
    ],
    ids=range(9),
)
def test_answers_that_cannot_be_read_are_refused_in_one_line(
    folder: Path, content: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder.parent / "bad.json"
    path.write_text(content)
    with pytest.raises(BenchmarkError, match=said):
        score(folder, path)
    assert main(["benchmark", "score", str(folder), str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_whole_number_of_hundreds_of_digits_is_no_size(folder: Path) -> None:
    name, true = next((name, t) for name, t in truth(folder).items() if t["part"] == "clean")
    said = {name: [named(true["truth"][0])]}
    for number in said[name][0]["parameters"].values():
        number["value"] = 10**400
    assert math.isnan(score(folder, answers(folder, said, "huge.json")).rows[0].size_error)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"joints"', '"joint"', "lacks effects, or a robot, recording or joints of a case"),
        ('"effects"', '"effect"', "lacks effects"),
        ('"recording"', '"record"', "lacks effects, or a robot, recording"),
    ],
)
def test_a_list_of_cases_that_lacks_something_is_refused(
    folder: Path, tmp_path: Path, old: str, new: str, said: str
) -> None:
    text = (folder / "cases.json").read_text()
    assert old in text
    (tmp_path / "cases.json").write_text(text.replace(old, new, 1))
    with pytest.raises(BenchmarkError, match=said):
        cases(tmp_path)


# --- commands ---------------------------------------------------------------------------------------------
def test_the_commands_make_and_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "of_one"
    assert main(["benchmark", "make", str(out), "--count", "1", "--parts", "healthy", "--no-real"]) == 0
    said = answers(out, {"c0001": []})
    assert main(["benchmark", "score", str(out), str(said), "--json", str(tmp_path / "score.json")]) == 0
    assert "healthy  1/1" in capsys.readouterr().out
    assert json.loads((tmp_path / "score.json").read_text())["parts"][0]["right"] == 1
    assert main(["benchmark", "make", str(out)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert main(["benchmark", "make", str(tmp_path / "new"), "--parts", "dusty"]) == 2
    assert f"there are {', '.join(PARTS)}" in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_it_runs_without_the_product(folder: Path) -> None:
    said = answers(folder, {})
    code = (
        "import sys, runpy; sys.modules['flexjoint'] = None;"
        f"sys.argv = ['benchmark', 'score', {str(folder)!r}, {str(said)!r}];"
        "runpy.run_module('flexjoint_benchmark', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert "clean" in done.stdout, done.stderr


# --- an adapter -------------------------------------------------------------------------------------------
def test_least_squares_names_friction_and_its_level(tmp_path: Path) -> None:
    from planting import ROBOTS, Planted, plant
    from planting.cases import QUIET_FEEDBACK

    level = 3.0
    friction = Planted("motor_coulomb_friction", "swing", {"level": level})
    recorded = plant(ROBOTS / "lever.yaml", [friction], "rich", 8.0, 5, QUIET_FEEDBACK)
    recorded.write(tmp_path / "recording.parquet")
    for name in ("lever.yaml", "lever.urdf"):
        (tmp_path / name).write_text((ROBOTS / name).read_text())
    machine = read(tmp_path, {"robot": "lever.yaml", "recording": "recording.parquet"})
    found = least_squares.find(machine, tmp_path)
    (value,) = [f["parameters"]["level"]["value"] for f in found if f["effect"] == "motor_coulomb_friction"]
    # the sign of a filtered speed is smeared over 1/20 Hz at each of some twenty reversals in 7 s
    assert value == pytest.approx(level, rel=0.1)


@thorough
def test_mujoco_sysid_finds_that_friction_and_nothing_on_a_healthy_machine(tmp_path: Path) -> None:
    # the module itself is in every mujoco, and empty where its own dependencies are not installed
    if not hasattr(pytest.importorskip("mujoco.sysid"), "TimeSeries"):
        pytest.skip(
            "pip install '.[benchmark]' brings mujoco[sysid], to which this compares; it is an optional extra"
        )
    from planting import ROBOTS, Planted, plant
    from planting.cases import QUIET_FEEDBACK

    from flexjoint_benchmark.adapters import mujoco_sysid

    level, found = 6.0, {}
    for name, planted in (
        ("healthy", []),
        ("rubbing", [Planted("motor_coulomb_friction", "swing", {"level": level})]),
    ):
        folder = tmp_path / name
        folder.mkdir()
        plant(ROBOTS / "lever.yaml", planted, "rich", 8.0, 5, QUIET_FEEDBACK).write(
            folder / "recording.parquet"
        )
        (folder / "robot.yaml").write_text((ROBOTS / "lever.yaml").read_text())
        (folder / "lever.urdf").write_text((ROBOTS / "lever.urdf").read_text())
        case = {"robot": "robot.yaml", "recording": "recording.parquet"}
        machine = read(folder, case, mujoco_sysid.CUTOFF)
        found[name] = mujoco_sysid.find(machine, folder)
    assert found["healthy"] == []
    (value,) = [
        f["parameters"]["level"]["value"] for f in found["rubbing"] if f["effect"] == "motor_coulomb_friction"
    ]
    # its stop is soft, and its signals are filtered at 80 Hz
    assert value == pytest.approx(level, rel=0.15)
