"""`flexjoint benchmark make | answer | score`: recordings with known defects (docs/studies/benchmark.md)."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import whole_folder, write_json
from flexjoint.core.messages import escaped
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import to_json
from flexjoint.recording import table
from flexjoint.report.progress import Progress
from flexjoint.robot import robot
from flexjoint_benchmark import SCHEMA, BenchmarkError
from flexjoint_benchmark.cases import PARTS
from flexjoint_benchmark.folder import CASES, cases, make
from flexjoint_benchmark.score import read_answers, score

KEPT = ("effect", "joint", "probability", "parameters", "since", "indistinguishable")  # of a finding


def make_folder(arguments: argparse.Namespace) -> None:
    """Write a benchmark into a new folder."""
    real = None if arguments.no_real else robot.robots_folder()
    parts = tuple(arguments.parts or PARTS)
    try:
        with Progress() as bar, whole_folder(arguments.out) as folder:
            done = make(
                folder,
                arguments.count,
                arguments.seed,
                parts,
                real,
                lambda k, total: bar(k / total, f"case {k} of {total}"),
            )
    except BenchmarkError as error:
        raise FlexJointError(str(error)) from None
    print(f"wrote {done} cases to {escaped(str(arguments.out))}")


def answer(arguments: argparse.Namespace) -> None:
    """Diagnose every case that has no answer yet; each is written down when it is known."""
    check_place(arguments.answers, (".json",), [arguments.folder / CASES])
    try:
        listed = cases(arguments.folder)
        answers = dict(read_answers(arguments.answers, listed)[1]) if arguments.answers.exists() else {}
    except BenchmarkError as error:
        raise FlexJointError(str(error)) from None
    waiting = [name for name in listed["cases"] if name not in answers]
    with Progress() as bar:
        for k, name in enumerate(waiting):
            bar(k / len(waiting), f"diagnosing {name}")
            entry = listed["cases"][name]
            answers[name] = _answer(arguments.folder / entry["robot"], arguments.folder / entry["recording"])
            write_json(arguments.answers, {"schema": SCHEMA, "tool": "flexjoint", "answers": answers})
    print(f"{len(answers)} answers are in {escaped(str(arguments.answers))}")


def show_score(arguments: argparse.Namespace) -> None:
    """Score a file of answers."""
    if arguments.json is not None:
        check_place(arguments.json, (".json",), [arguments.answers, arguments.folder / CASES])
    try:
        scored = score(arguments.folder, arguments.answers)
    except BenchmarkError as error:
        raise FlexJointError(str(error)) from None
    if arguments.json is not None:
        write_json(arguments.json, scored.to_json())
    print(scored)


def _answer(model: Path, recording: Path) -> dict[str, Any]:
    started = time.perf_counter()
    try:
        said = to_json(diagnose(robot.load(model), [table.read(recording)]))
    except FlexJointError as error:
        return {"verdict": "refused", "findings": [], "error": str(error)}
    findings = [{key: finding.get(key) for key in KEPT} for finding in said["findings"]]
    seconds = round(time.perf_counter() - started, 2)
    return {"verdict": said["verdict"], "findings": findings, "seconds": seconds}
