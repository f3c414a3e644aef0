"""`flexjoint diagnose`: what the simulation gets wrong on a recording, as words, JSON, a page and a robot."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from flexjoint.cli.options import load_chosen, mapping_of
from flexjoint.cli.outputs import Asked, page
from flexjoint.core.messages import escaped
from flexjoint.diagnosis import pipeline
from flexjoint.diagnosis.agreement.agreement import agreement
from flexjoint.diagnosis.result import LEAST, Diagnosis, to_json
from flexjoint.diagnosis.result.wording import cause, listed, percent
from flexjoint.recording.checks import check
from flexjoint.recording.importing import logs_in, read
from flexjoint.report.terminal import Progress, no_progress, summary
from flexjoint.robot.payload import parse


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before the long work."""
    asked = Asked(arguments.json, arguments.report, arguments.model)
    mapped = [arguments.mapping] if arguments.mapping is not None else []
    asked.check([Path(arguments.robot), *arguments.recordings, *mapped])
    nominal = load_chosen(arguments)
    mapping = mapping_of(arguments)
    paths = [log for path in arguments.recordings for log in logs_in(path)]
    recordings = [read(path, mapping, nominal).recording for path in paths]
    for table in recordings:
        check(nominal, table)
    payloads = parse(arguments.payload, [str(path) for path in paths])
    with Progress() as bar:
        shown = no_progress if arguments.quiet else bar
        diagnosis = pipeline.diagnose(
            nominal,
            recordings,
            progress=shown,
            payloads=payloads,
            refine=not arguments.no_refine,
            check_data=not arguments.ignore_data_checks,
        )
        shown(1.0, "comparing the recordings with each other")
        diagnosis = agreement(nominal, recordings, diagnosis, payloads=payloads)
    html = None
    if asked.report is not None:  # its numbers are those of all causes that it names
        html = page(diagnosis, nominal, diagnosis.extend(nominal, least=0.0), recordings[0])
    least = 0.0 if arguments.all_causes else LEAST
    asked.write(to_json(diagnosis, asked.model_name()), html, diagnosis.extend(nominal, least))
    if not arguments.quiet:
        console = Console()
        summary(diagnosis, console)
        for line in written(diagnosis, asked, least):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def written(diagnosis: Diagnosis, asked: Asked, least: float) -> Iterator[str]:
    """What was written, and of the extended robot what was left out."""
    kept = diagnosis.likely(least)
    left = [finding for finding in diagnosis.findings if finding not in kept]
    names = listed(f"{cause(f.effect, f.joint)} ({percent(f.probability)})" for f in left)
    for path in asked.paths():
        if path == asked.model and left:
            yield (
                f"wrote {escaped(str(path))} without {names}, less likely than {percent(least)}; --all-causes"
                f" puts {'it' if len(left) == 1 else 'them'} in"
            )
        else:
            yield f"wrote {escaped(str(path))}"
