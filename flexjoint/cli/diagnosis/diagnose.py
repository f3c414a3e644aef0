"""`flexjoint diagnose`: what the simulation gets wrong on a recording, as words, JSON, a page and a robot."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from flexjoint.cli.options import budget_from, load_chosen, mapping_of
from flexjoint.cli.outputs import Asked, page
from flexjoint.core.errors import FlexJointError
from flexjoint.core.messages import escaped
from flexjoint.core.running.progress import silent
from flexjoint.core.running.worker_pool import workers_of
from flexjoint.diagnosis import pipeline
from flexjoint.diagnosis.followup.agreement.agreement import agreement
from flexjoint.diagnosis.followup.learning.learn import learn
from flexjoint.diagnosis.result import LEAST, Diagnosis, to_json
from flexjoint.diagnosis.result.wording import cause, listed, percent
from flexjoint.diagnosis.signals.excerpt import excerpts, expected_seconds, most_samples
from flexjoint.recording.checks import check
from flexjoint.recording.importing import logs_in, read
from flexjoint.recording.table import Recording
from flexjoint.report.progress import Progress
from flexjoint.report.terminal import summary
from flexjoint.robot.payload import parse
from flexjoint.robot.robot import Robot


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before the long work."""
    budget = budget_from(arguments)
    if arguments.learn and arguments.all_causes:
        raise FlexJointError(
            "--learn and --all-causes: laws are learned beside the likely causes; give one of the two"
        )
    asked = Asked(arguments.json, arguments.report, arguments.model)
    mapped = [arguments.mapping] if arguments.mapping is not None else []
    asked.check([Path(arguments.robot), *arguments.recordings, *mapped])
    nominal = load_chosen(arguments)
    mapping = mapping_of(arguments)
    paths = [log for path in arguments.recordings for log in logs_in(path)]
    recordings = [read(path, mapping, nominal).recording for path in paths]
    for k in range(len(recordings)):  # none is kept by a name: see HandedOver
        check(nominal, recordings[k])
    payloads = parse(arguments.payload, [str(path) for path in paths])
    shown_on_page = examined(nominal, recordings, budget.seconds) if asked.report is not None else None
    several = list(recordings) if len(recordings) > 1 else []
    kept = list(recordings) if arguments.learn else []
    with Progress() as bar:
        if not arguments.quiet:
            bar.expect(min(budget.left, expected_seconds(nominal, recordings, workers_of(None))))
        diagnosis = pipeline.diagnose(
            nominal,
            HandedOver(recordings),
            progress=silent if arguments.quiet else bar,
            payloads=payloads,
            refine=not arguments.no_refine,
            check_data=not arguments.ignore_data_checks,
            budget=budget,
        )
        if several:
            if not arguments.quiet:
                bar(1.0, "comparing the recordings with each other")
            diagnosis = agreement(nominal, several, diagnosis, payloads=payloads, budget=budget)
        if kept:
            report = silent if arguments.quiet else bar
            diagnosis = learn(nominal, kept, diagnosis, payloads=payloads, budget=budget, progress=report)
    html = None
    if shown_on_page is not None:  # its numbers are those of all causes that it names
        html = page(diagnosis, nominal, diagnosis.extend(nominal, least=0.0), shown_on_page)
    least = 0.0 if arguments.all_causes else LEAST
    extended = diagnosis.extend(nominal, least, numbers=arguments.numbers)
    asked.write(to_json(diagnosis, asked.model_name()), html, extended)
    if not arguments.quiet:
        console = Console()
        summary(diagnosis, console)
        for line in written(diagnosis, asked, least, arguments.numbers):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


class HandedOver(Sequence[Recording]):
    """Recordings that are given away as they are asked for: a large one then leaves memory when the part of
    it that is examined was taken."""

    def __init__(self, recordings: list[Recording]) -> None:
        self._recordings = recordings

    def __len__(self) -> int:
        return len(self._recordings)

    def __getitem__(self, place: Any) -> Any:
        return self._recordings[place]

    def __iter__(self) -> Iterator[Recording]:
        while self._recordings:
            yield self._recordings.pop(0)


def examined(nominal: Robot, recordings: Sequence[Recording], seconds: float) -> Recording:
    """The first recording, of a large one the part that the diagnosis looks at."""
    first = recordings[0]
    if first.time.size * len(nominal.joints) <= most_samples(nominal, seconds):
        return first
    return excerpts(nominal, recordings, seconds)[0][0]


def written(diagnosis: Diagnosis, asked: Asked, least: float, numbers: bool) -> Iterator[str]:
    """What was written, and of the extended robot what was left out."""
    kept = diagnosis.likely(least)
    left = [finding for finding in diagnosis.findings if finding not in kept]
    names = listed(f"{cause(f.effect, f.joint)} ({percent(f.probability)})" for f in left)
    for path in asked.paths():
        line = f"wrote {escaped(str(path))}"
        if path == asked.model and left:
            line += (
                f" without {names}, less likely than {percent(least)}; --all-causes"
                f" puts {'it' if len(left) == 1 else 'them'} in"
            )
        yield line
        if path == asked.model and diagnosis.within_tolerance and not numbers:
            yield "  nominal numbers within their tolerances are as they were; --numbers changes them"
        going = [cause(f.effect, f.joint) for f in kept if f.during]
        if path == asked.model and going:
            yield f"{escaped(str(path))} is of the robot without {listed(going)}, which comes and goes"
