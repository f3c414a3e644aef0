"""`flexjoint check`: whether a machine is as it was, in a small part of the time that its recording lasts."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from flexjoint.cli import options
from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.followup.checking.check import check
from flexjoint.recording import checks
from flexjoint.recording.importing import read
from flexjoint.report.terminal import show

CHANGED = 1
ROBOTS = (".yaml", ".yml")


def run(arguments: argparse.Namespace) -> int:
    """The command: 0 as before, 1 changed. Raises FlexJointError on unusable input."""
    against: Path = arguments.against
    if arguments.robot is None:
        if against.suffix not in ROBOTS:
            raise FlexJointError(
                f"{against} does not hold its robot; give that, too: --robot R.yaml, as `diagnose` had it"
            )
        arguments.robot, before = str(against), None
    else:
        before = against
    inputs = [arguments.recording, Path(arguments.robot), against]
    if arguments.json is not None:
        check_place(arguments.json, (".json",), inputs)
    robot = options.load_chosen(arguments)
    table = read(arguments.recording, options.mapping_of(arguments), robot).recording
    checks.check(robot, table)
    found = check(robot, table, before)
    if arguments.json is not None:
        found.write(arguments.json)
    if not arguments.quiet:
        show(found.summary(), Console())
    return 0 if found.verdict == "as_before" else CHANGED
