"""What the commands write and print: files whole or not at all, and only after everything succeeded."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flexjoint import report
from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import all_or_none, check_folder, check_suffix, write_json, write_text
from flexjoint.diagnosis.comparison.compare import Comparison, compare
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.recording.table import Recording
from flexjoint.report.material import require
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot


@dataclass(frozen=True)
class Asked:
    """The files that `diagnose` was asked for."""

    json: Path | None = None
    report: Path | None = None
    model: Path | None = None

    def check(self, inputs: Sequence[Path] = ()) -> None:
        """Refuse before the long work what could not be written after it; raises FlexJointError."""
        places = ((self.json, (".json",)), (self.report, (".html", ".htm")), (self.model, (".yaml", ".yml")))
        for path, suffixes in places:
            if path is not None:
                check_place(path, suffixes, inputs)
        if self.report is not None:
            for package in ("matplotlib", "jinja2"):
                require(package)

    def paths(self) -> list[Path]:
        return [path for path in (self.json, self.report, self.model) if path is not None]

    def model_name(self) -> str | None:
        """The extended model as the JSON names it: relative to the JSON's folder where there is one."""
        if self.model is None:
            return None
        if self.json is None:
            return str(self.model)
        try:
            return Path(os.path.relpath(self.model.resolve(), self.json.resolve().parent)).as_posix()
        except ValueError:  # another drive
            return str(self.model)

    def write(self, diagnosis: Mapping[str, Any], page: str | None, extended: Robot) -> None:
        """Write the files that were asked for, all or none; the model's YAML first, as the JSON names it."""
        with all_or_none():
            if self.model is not None:
                robot.write(extended, self.model)
            if self.report is not None and page is not None:
                write_text(self.report, page)
            if self.json is not None:
                write_json(self.json, diagnosis)


def check_place(path: Path, suffixes: Sequence[str], inputs: Sequence[Path] = ()) -> None:
    """Raise FlexJointError unless a file of that suffix could be written there without spoiling an input."""
    check_suffix(path, suffixes)
    if path.is_dir():
        raise FlexJointError(f"cannot write {path}: it is a folder; give the name of a file")
    if path.exists() and any(item.exists() and path.samefile(item) for item in inputs):
        raise FlexJointError(f"cannot write {path}: it is an input; give another name")
    check_folder(path, path.parent)


def page(diagnosis: Diagnosis, nominal: Robot, extended: Robot, recording: Recording) -> str:
    """The report, with both models' simulation of the recording where it can be simulated."""
    before = _simulated(nominal, recording)
    after = _simulated(extended, recording) if diagnosis.findings or _laws(diagnosis) else None
    return report.render(diagnosis, nominal, recording, before, after)


def _laws(diagnosis: Diagnosis) -> bool:
    return diagnosis.learned is not None and bool(diagnosis.learned.laws)


def _simulated(loaded: Robot, recording: Recording) -> Comparison | None:
    """None where the recording lacks what a simulation needs or the simulation diverges: the diagnosis, which
    does not simulate, then stands alone."""
    try:
        return compare(loaded, recording)
    except FlexJointError:
        return None


def print_table(console: Console, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A plain table, its first column of names, the others of numbers."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for k, head in enumerate(heads):
        table.add_column(Text(head), justify="right" if k else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
