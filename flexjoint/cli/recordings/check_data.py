"""`flexjoint check-data`: whether signs, zeros, units and names of a recording are those of its robot."""

from __future__ import annotations

import argparse

from rich.console import Console

from flexjoint.cli.options import load_chosen, mapping_of
from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import RecordingError
from flexjoint.core.files import all_or_none
from flexjoint.core.messages import escaped
from flexjoint.diagnosis.data.check import check_data
from flexjoint.recording.checks import check
from flexjoint.recording.importing import read
from flexjoint.report.terminal import show


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, and on data that are wrong and not repaired."""
    inputs = [arguments.recording, *([arguments.mapping] if arguments.mapping is not None else [])]
    if arguments.json is not None:
        check_place(arguments.json, (".json",), inputs)
    if arguments.out is not None:
        check_place(arguments.out, (".csv", ".parquet"), inputs)
    robot = load_chosen(arguments)
    table = read(arguments.recording, mapping_of(arguments), robot).recording
    check(robot, table)
    found = check_data(robot, table)
    with all_or_none():
        if arguments.out is not None:
            found.repaired.write(arguments.out)
        if arguments.json is not None:
            found.write(arguments.json)
    console = Console()
    show(found.summary(), console)
    left = [f for f in found.findings if arguments.out is None or not f.columns]
    if arguments.out is not None:
        done = len(found.findings) - len(left)
        told = f"wrote {escaped(str(arguments.out))}; errors repaired: {done}"
        console.print(told, markup=False, highlight=False, soft_wrap=True)
    if left:
        how = "in the robot file"
        if left[0].columns:
            how = "with --out REC.parquet"
        elif left[0].command:
            how = f"with {left[0].command}"
        raise RecordingError(
            f"{arguments.recording}: errors of the data: {len(left)}; the first: {left[0].text}; repair"
            f" it {how}"
        )
