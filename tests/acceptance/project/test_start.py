"""The page start.md: its commands, as they stand, from an own description and log to a report."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support import fake_diagnosis
from support.cli_runs import run
from support.pages import DOCS, blocks
from support.thorough import thorough

import flexjoint.diagnosis.pipeline
from flexjoint.robot import robot

FRICTION, DAMPING = 3.0, 9.0  # N m, planted; N m s/rad, of the machine, which its URDF does not state


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the URDF of a rigid machine and its log, as another program wrote it."""
    folder = tmp_path_factory.mktemp("machine")
    data = yaml.safe_load((ROBOTS / "lever.yaml").read_text())
    data["joints"]["swing"] |= {"stiffness": float("inf"), "damping": 0.0, "kp": 600.0, "kd": 30.0}
    assert data["joints"]["swing"]["motor_damping"] == DAMPING
    for name in ("lever.urdf", "arm2.urdf"):
        shutil.copyfile(ROBOTS / "lever.urdf", folder / name)
    (folder / "lever.yaml").write_text(yaml.safe_dump(data))
    friction = Planted("motor_coulomb_friction", "swing", {"level": FRICTION})
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(folder / "lever.yaml", [friction], "rich", 16.0, 5, sensors, rate=250.0).columns
    columns = {channel: recorded[f"{channel}.swing"] for channel in ("theta", "tau_motor")}
    np.savez(folder / "log.npz", time=recorded["time"], joint_names=["swing"], **columns)  # type: ignore[arg-type]
    return folder


def commands() -> list[list[str]]:
    (page,) = blocks(DOCS / "start" / "start.md", "sh")
    return [shlex.split(line)[1:] for line in page.splitlines() if line]


def copied(machine: Path, folder: Path) -> None:
    for name in ("arm2.urdf", "log.npz"):
        shutil.copyfile(machine / name, folder / name)


def test_the_commands_of_the_page_run_one_after_the_other(
    machine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The diagnosis takes its time and is run below; here another one's result is put in its place."""
    copied(machine, tmp_path)
    monkeypatch.chdir(tmp_path)
    refused = fake_diagnosis.refused()
    monkeypatch.setattr(flexjoint.diagnosis.pipeline, "diagnose", lambda *_given, **_options: refused)
    for words in commands():
        assert run(*words) == 0, words
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"arm2.urdf", "log.npz", "arm2.yaml", "monday.parquet", "report.html", "extended.yaml"}
    printed = capsys.readouterr().out
    assert "next: flexjoint diagnose log.npz --robot arm2.yaml --report report.html" in printed
    assert robot.load("arm2.yaml").joint("swing").rigid


@thorough
def test_the_page_finds_what_the_description_did_not_know(
    machine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied(machine, tmp_path)
    monkeypatch.chdir(tmp_path)
    for words in commands():
        assert run(*words, *(("--json", "found.json") if words[0] == "diagnose" else ())) == 0
    found = {item["effect"]: item for item in json.loads(Path("found.json").read_text())["findings"]}
    # 2.97 +- 0.04 N m and 9.02 +- 0.03 N m s/rad: the robot file states none of either
    assert found["motor_coulomb_friction"]["parameters"]["level"]["value"] == pytest.approx(
        FRICTION, rel=0.05
    )
    damping = found["motor_viscous_friction"]["parameters"]["coefficient"]["value"]
    assert damping == pytest.approx(DAMPING, rel=0.05)
