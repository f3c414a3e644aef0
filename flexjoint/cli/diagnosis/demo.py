"""`flexjoint demo`: recording A of the KR300 is diagnosed, recordings B and C measure what it gained."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from flexjoint.cli.outputs import Asked, page, print_table
from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import all_or_none, write_json
from flexjoint.diagnosis.comparison.compare import Comparison, compare
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.result.wording import clean, number
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.report.progress import Progress
from flexjoint.report.terminal import summary
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot

ROBOT = "kr300"
DIAGNOSED = "rec_A"
UNSEEN = ("rec_B", "rec_C")


def run(arguments: argparse.Namespace) -> None:
    """The command."""
    outputs(arguments.out)  # complains before the work, not after it
    with Progress() as bar:
        shown = found(bar)
    show(shown, write(shown, arguments.out), Console())


@dataclass(frozen=True)
class Demo:
    """What the demo found: `gains` holds the nominal and the extended model's errors by unseen recording."""

    nominal: Robot
    extended: Robot
    recording: Recording
    diagnosis: Diagnosis
    gains: Mapping[str, tuple[Comparison, Comparison]]


def found(progress: Callable[[float, str], None]) -> Demo:
    """Diagnose recording A and measure the gain on B and C, which the diagnosis never saw."""
    nominal = robot.load(ROBOT)
    folder = robot.robots_folder() / ROBOT / "recordings"
    measured = recording.read(folder / f"{DIAGNOSED}.parquet")
    diagnosis = diagnose(nominal, [measured], progress=progress)
    extended = diagnosis.extend(nominal)
    gains = {}
    for name in UNSEEN:
        progress(1.0, f"measuring the gain on {name}")
        unseen = recording.read(folder / f"{name}.parquet")
        gains[name] = (
            compare(nominal, unseen),
            compare(extended, unseen),
        )
    return Demo(nominal, extended, measured, diagnosis, gains)


def outputs(folder: Path) -> Asked:
    """The files that the demo writes; FlexJointError when they could not be written there."""
    if folder.exists() and not folder.is_dir():
        raise FlexJointError(f"cannot write into {folder}: it is a file; give --out a folder")
    files = Asked(folder / "diagnosis.json", folder / "report.html", folder / f"{ROBOT}_extended.yaml")
    files.check()
    return files


def write(shown: Demo, folder: Path) -> Mapping[str, Path]:
    """Write report, diagnosis, extended robot and gain into a folder; returns the files by what they are."""
    files = outputs(folder)
    everything = shown.diagnosis.extend(shown.nominal, least=0.0)  # its numbers are those of all causes
    html = page(shown.diagnosis, shown.nominal, everything, shown.recording)
    recordings = {
        name: {"before": before.to_json(), "after": after.to_json()}
        for name, (before, after) in shown.gains.items()
    }
    gain = {"schema": 1, "recordings": recordings}
    with all_or_none():
        files.write(to_json(shown.diagnosis, files.model_name()), html, shown.extended)
        write_json(folder / "gain.json", gain)
    return {
        "report": folder / "report.html",
        "diagnosis": folder / "diagnosis.json",
        "extended robot": folder / f"{ROBOT}_extended.yaml",
        "gain on B and C": folder / "gain.json",
    }


def show(shown: Demo, files: Mapping[str, Path], console: Console) -> None:
    """Print the diagnosis, the gain on the unseen recordings and where the files lie."""
    summary(shown.diagnosis, console)
    console.print()
    said = "RMS error of theta - q about its mean [mrad], on data the diagnosis never saw"
    console.print(said, markup=False, highlight=False)
    print_table(console, ("joint", *_heads()), _rows(shown))
    console.print()
    for what, path in files.items():
        console.print(f"{what}: {clean(path)}", markup=False, highlight=False, soft_wrap=True)


def _heads() -> list[str]:
    whens = ("nominal", "extended", "ratio")
    return [f"{name.removeprefix('rec_')} {when}" for name in UNSEEN for when in whens]


def _rows(shown: Demo) -> list[list[str]]:
    rows = []
    for joint in shown.nominal.joint_names:
        key = f"phi.{joint}"
        if all(key in before.rms for before, _ in shown.gains.values()):
            pairs = [(1e3 * before.rms[key], 1e3 * after.rms[key]) for before, after in shown.gains.values()]
            rows.append([joint, *(cell for pair in pairs for cell in _cells(*pair))])
    return rows


def _cells(before: float, after: float) -> tuple[str, str, str]:
    return number(before), number(after), f"{before / after:.1f}" if after > 0.0 else ""
