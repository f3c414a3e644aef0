"""`flexjoint init`: the robot file of a description, checked against a recording where there is one."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from flexjoint.cli import options
from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import write_text
from flexjoint.core.messages import escaped
from flexjoint.core.text import plain
from flexjoint.diagnosis.data.check import check_data
from flexjoint.diagnosis.result.sentences import data_lines
from flexjoint.recording.checks import check, check_joints
from flexjoint.recording.importing import read
from flexjoint.recording.table import Recording
from flexjoint.robot.draft import Seen, draft
from flexjoint.robot.robot import Robot


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    out: Path = arguments.out
    inputs = [Path(arguments.description), arguments.recording, arguments.mapping]
    check_place(out, (".yaml", ".yml"), [path for path in inputs if path is not None])
    if out.exists() and not arguments.force:
        raise FlexJointError(
            f"{out} is there already; give another name with --out, or --force to write over it"
        )
    made = draft(arguments.description, out, springs=not arguments.rigid)
    account = ""
    wrong: tuple[str, ...] = ()
    if arguments.recording is not None:
        imported = read(arguments.recording, options.mapping_of(arguments), made.robot)
        check_joints(made.robot, imported.recording)
        made = draft(arguments.description, out, _seen(imported.recording), springs=not arguments.rigid)
        check(made.robot, imported.recording)
        wrong = _wrong(made.robot, imported.recording)
        account = plain(imported.account) if imported.account else _short(imported.recording)
    write_text(out, made.text)
    for line in (account, *wrong, *made.notes):
        if line:
            print(escaped(line, "\n"))
    kind = "rigid" if all(joint.rigid for joint in made.robot.joints) else "flexible"
    marks = made.text.count("CHECK") - 1
    print(
        f"wrote {escaped(str(out))}: {kind} joints, tolerances by default; {marks} lines marked CHECK say"
        f" where numbers are found"
    )
    print(escaped(f"next: {_next(arguments, out, bool(wrong))}"))


def _wrong(robot: Robot, recording: Recording) -> tuple[str, ...]:
    """Errors of the data, with their repairs. Currents are left out: no constants of them are stated yet."""
    columns = {key: values for key, values in recording.columns.items() if key[0] != "current"}
    found = check_data(robot, replace(recording, columns=columns)).findings
    return data_lines([replace(finding, command="") for finding in found])


def _seen(recording: Recording) -> Seen:
    channels = {
        joint: tuple(c for c, name in recording.columns if name == joint) for joint in recording.joints
    }
    return Seen(recording.name, 1.0 / recording.period, channels)


def _short(recording: Recording) -> str:
    channels = ", ".join(dict.fromkeys(channel for channel, _ in recording.columns))
    lines = [
        f"{recording.name}: {channels} of {', '.join(recording.joints)}; {1.0 / recording.period:.4g} Hz,"
        f" {recording.duration:.4g} s",
        *recording.notes,
    ]
    return "\n".join(lines)


def _next(arguments: argparse.Namespace, out: Path, wrong: bool) -> str:
    if arguments.recording is None:
        return f"flexjoint import LOG --robot {out} --to table.parquet"
    stated = any(
        getattr(arguments, key) not in (None, False)
        for key in ("degrees", "radians", "gear", "torque_constant", "joints", "encoder", "episode")
    )
    if stated:  # what the options state goes into a table
        return (
            f"flexjoint import {arguments.recording} --robot {out} --to table.parquet, with the same options"
        )
    mapping = f" --mapping {arguments.mapping}" if arguments.mapping is not None else ""
    given = f"{arguments.recording} --robot {out}{mapping}"
    if wrong:
        return f"flexjoint check-data {given} --out repaired.parquet"
    return f"flexjoint diagnose {given} --report report.html"
