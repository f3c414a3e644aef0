"""`flexjoint import`: the log of another program as a recording, and what was understood of it."""

from __future__ import annotations

import argparse

from flexjoint.cli import options
from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import FlexJointError
from flexjoint.core.messages import escaped
from flexjoint.recording.checks import check
from flexjoint.recording.importing import import_log, open_log
from flexjoint.recording.logs.mapping import EMPTY
from flexjoint.recording.messages import shown
from flexjoint.report.progress import Progress
from flexjoint.robot.robot import load


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    if arguments.to is not None:
        inputs = [path for path in (arguments.log, arguments.mapping) if path is not None]
        check_place(arguments.to, (".csv", ".parquet"), inputs)
    mapping = options.mapping_of(arguments) or EMPTY
    robot = load(arguments.robot) if arguments.robot is not None else None
    if arguments.signals:
        _print_signals(arguments)
        return
    if arguments.to is None:
        raise FlexJointError("import: give --to TABLE.parquet, or --signals to see what the log holds")
    with Progress() as bar:
        imported = import_log(arguments.log, mapping, robot, progress=bar)
        if robot is not None:
            check(robot, imported.recording)
    account = str(imported)
    imported.recording.write(arguments.to)
    print(escaped(account, "\n"))
    print(escaped(f"wrote {arguments.to}"))
    named = arguments.robot if arguments.robot is not None else "robot.yaml"
    print(escaped(f"next: flexjoint diagnose {arguments.to} --robot {named} --report report.html"))


def _print_signals(arguments: argparse.Namespace) -> None:
    """What a log holds, to write a mapping by."""
    with Progress() as bar:
        log = open_log(arguments.log, arguments.episode, bar)
    print(escaped(f"{log.source}: {log.format}"))
    for name, signal in log.signals.items():
        count, width = signal.values.shape
        known = log.documented.get(name)
        said = f", {known.channel}: {known.why}" if known is not None else ""
        joints = f" ({', '.join(map(shown, signal.joints))})" if signal.joints else ""
        print(f"    {shown(name)}: {count} samples of {width}{joints}{said}")
    for note in log.notes:
        print(escaped(note))
