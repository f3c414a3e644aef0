"""`flexjoint compare`: how far a robot's simulation is from a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from flexjoint.cli.options import budget_from, load_chosen, mapping_of
from flexjoint.cli.outputs import Asked
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.recording.checks import check
from flexjoint.recording.importing import read
from flexjoint.report.progress import Progress
from flexjoint.report.terminal import show


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input."""
    budget = budget_from(arguments)
    Asked(json=arguments.json).check([arguments.recording, Path(arguments.robot)])
    robot = load_chosen(arguments)
    table = read(arguments.recording, mapping_of(arguments), robot).recording
    check(robot, table)
    with Progress() as bar:
        result = compare(
            robot,
            table,
            horizon=arguments.horizon,
            closed_loop=arguments.closed_loop,
            engine=arguments.engine,
            progress=bar,
            budget=budget,
        )
    if arguments.json is not None:
        result.write(arguments.json)
    show(result.table(), Console())
