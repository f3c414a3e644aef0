"""A disk that is full, or read-only: one line, exit code 2, no file, and no work where the place can be seen
to take nothing. On a small disk of its own, which only root may mount."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.cli_runs import complaint, run
from support.robots.robot_files import URDF, content

from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.robot import robot
from flexjoint.simulation.simulate import simulate

JOINTS = ("shoulder", "elbow")
COMMANDS = {
    "diagnose": "diagnose rec.parquet --robot arm.yaml --quiet --json {}/d.json --report {}/d.html"
    " --model {}/d.yml",
    "compare": "compare rec.parquet --robot arm.yaml --horizon 0.2 --json {}/new/c.json",
    "simulate": "simulate --robot arm.yaml --reference ref.csv --engine pin --out {}/s.csv",
    "import": "import rec.parquet --to {}/i.csv",
    "check-data": "check-data rec.parquet --robot arm.yaml --out {}/r.csv --json {}/e.json",
    "check": "check rec.parquet --robot arm.yaml --against d.json --json {}/c.json",
    "theta-d": "theta-d poses.csv --robot arm.yaml --out {}/t.csv",
    "export": "export arm.yaml --to urdf --out {}/a.urdf",
    "init": "init arm2.urdf --out {}/a.yaml",
    "fleet": "fleet machines --robot arm.yaml --workers 1 --out {}/fleet",
    "benchmark make": "benchmark make {}/b --count 1 --parts healthy --no-real",
    "benchmark score": "benchmark score bench answers.json --json {}/score.json",
    "plan": "plan --robot arm.yaml --out {}/p.csv --json {}/p.json",
    "benchmark answer": "benchmark answer bench {}/a.json",
    "demo": "demo --out {}/demo",
    "paper": "paper one-link --out {}",
}
LONG = (
    "plan",
    "benchmark answer",
    "demo",
    "paper",
)  # work of ten seconds and more before anything is written


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands read."""
    made = tmp_path_factory.mktemp("inputs")
    (made / "arm2.urdf").write_text(URDF)
    (made / "arm.yaml").write_text(yaml.safe_dump(content(lock=["wrist"])))
    time = np.arange(750) / 250.0
    reference = Recording(time, {("q_ref", joint): 0.2 * np.sin(9.0 * time) for joint in JOINTS})
    recording.write(reference, made / "ref.csv")
    noise = {"q": 1e-5, "theta": 1e-5, "tau_m": 1e-3}
    measured = simulate(robot.load(made / "arm.yaml"), reference, sample_rate=250.0, noise=noise).measured
    kept = {key: x for key, x in measured.columns.items() if key[0] in ("q", "theta", "tau_m")}
    recording.write(Recording(measured.time, kept), made / "rec.parquet")
    (made / "poses.csv").write_text("q.shoulder,q.elbow\n0.1,0.2\n")
    (made / "machines" / "one").mkdir(parents=True)
    shutil.copy(made / "rec.parquet", made / "machines" / "one")
    (made / "answers.json").write_text('{"schema": 1, "tool": "none", "answers": {}}')
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        for words in ("diagnose rec.parquet --robot arm.yaml --json d.json", COMMANDS["benchmark make"]):
            assert run(*words.replace("{}/b", "bench").split()) == 0
    return made


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A folder in which a small disk can be mounted."""
    if os.name != "posix" or os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root may mount a small disk")
    place = tmp_path / "disk"
    place.mkdir()
    yield place
    subprocess.run(["umount", place], check=False, capture_output=True)


def mounted(place: Path, options: str) -> None:
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "none", place], check=False, capture_output=True
    )
    if done.returncode:
        pytest.skip(f"no disk can be mounted here: {done.stderr.decode(errors='replace').strip()}")


def files(place: Path) -> list[Path]:
    return [path for path in place.rglob("*") if path.is_file() and path.name != "full"]


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in LONG])
def test_a_full_disk_is_one_line_and_no_file(
    inputs: Path,
    disk: Path,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    mounted(disk, "size=64k")
    with pytest.raises(OSError, match="No space left"):
        (disk / "full").write_bytes(bytes(100_000))
    monkeypatch.chdir(inputs)
    assert f"cannot write {disk}" in complaint(capsys, *COMMANDS[command].format(*3 * [disk]).split())
    assert not files(disk)


def test_of_several_files_none_is_left_where_the_last_one_does_not_fit(
    inputs: Path, disk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mounted(disk, "size=64k")
    monkeypatch.chdir(inputs)
    words = COMMANDS["diagnose"].format(*3 * [disk]).split()
    assert "No space left on device" in complaint(capsys, *words)  # the page has a megabyte, the model 1 kB
    assert not files(disk)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_read_only_folder_is_refused_before_the_work(
    inputs: Path,
    disk: Path,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    mounted(disk, "ro")
    monkeypatch.chdir(inputs)
    said = complaint(capsys, *COMMANDS[command].format(*3 * [disk]).split())
    assert f"cannot write {disk}" in said and "no file can be made in" in said
