"""Are the data what they say? Signs, zeros, units and names of a recording against its robot, in well under a
second, before any cause is blamed.

First what columns of the motion say of each other (motion/), then, with that repaired, what the recorded
torques say of the motion (torques/). A real machine with its friction, its load and its errors passes; an
error is reported where its repair alone makes the torques follow.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flexjoint.core.errors import RecordingError
from flexjoint.core.files import check_suffix, write_json
from flexjoint.core.text import Block, Line, as_html, plain
from flexjoint.diagnosis.data import bodies, columns
from flexjoint.diagnosis.data.change import Change
from flexjoint.diagnosis.data.motion import encoders, stamps, velocities
from flexjoint.diagnosis.data.sentences import evidence, said
from flexjoint.diagnosis.data.torques.errors import turned, unit, zero
from flexjoint.diagnosis.data.torques.follows import Balance
from flexjoint.diagnosis.data.torques.lag import torque_lag
from flexjoint.diagnosis.data.torques.sampled import sampled
from flexjoint.diagnosis.data.torques.search import Found, found_errors
from flexjoint.diagnosis.result.sentences import data_lines
from flexjoint.diagnosis.result.values import DataFinding, data_to_json
from flexjoint.diagnosis.result.wording import clean, sentence
from flexjoint.diagnosis.settings import USUAL, DataSettings
from flexjoint.recording import table as tables
from flexjoint.recording.clock import without_pauses
from flexjoint.recording.readings.channels import inspected
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording
from flexjoint.robot import robot as robots
from flexjoint.robot.robot import Robot, shipped_robots


@dataclass(frozen=True)
class DataCheck:
    """What `check_data` found: errors of the data, the recording that it looked at, and how a diagnosis takes
    readings that are no error, but not what their name says either (held, stuck, saturated, filtered)."""

    robot: str
    recording: Recording
    findings: tuple[DataFinding, ...]
    notes: tuple[str, ...] = ()

    @property
    def repaired(self) -> Recording:
        """The recording with the columns of all findings made right; itself without findings."""
        return columns.repaired(self.recording, self.findings)

    def summary(self) -> tuple[Block, ...]:
        """The findings with their repairs, as blocks of text."""
        if not self.findings:
            head = f"{clean(self.recording.name)} against {clean(self.robot)}: no error of the data found"
            return (Line(head, whole=True), *self._noted())
        head = f"{clean(self.recording.name)} against {clean(self.robot)}: the data cannot be right"
        return (
            Line(head, "bold", whole=True),
            *(Line(text, whole=True) for text in data_lines(self.findings)),
            *self._noted(),
        )

    def _noted(self) -> tuple[Block, ...]:
        return tuple(Line(sentence(note), "dim", whole=True) for note in self.notes)

    def __str__(self) -> str:
        return plain(self.summary())

    def _repr_html_(self) -> str:
        return as_html(self.summary())

    def to_json(self) -> dict[str, Any]:
        """The JSON form of `flexjoint check-data` (docs/reference/formats.md)."""
        return {
            "schema": 1,
            "data": [data_to_json(finding) for finding in self.findings],
            "notes": list(self.notes),
        }

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the findings as JSON, whole or not at all."""
        out = Path(path)
        check_suffix(out, (".json",))
        write_json(out, self.to_json())


def check_data(robot: Robot, recording: Recording, *, settings: DataSettings = USUAL.data) -> DataCheck:
    """Whether signs, zeros, units and names of a recording are those of its robot.

    Args:
        robot: the nominal model.
        recording: of this robot; currents become torques where the robot file has the constants.
        settings: the numbers that decide (docs/reference/settings.md).

    Raises RecordingError or RobotError of what is no recording or no robot, RecordingError for currents
    without constants.
    """
    robot = robots.expect(robot, "check_data")
    recording = of_robot(robot, tables.expect(recording, "check_data"))
    findings = data_errors(robot, recording, settings)
    right = columns.repaired(recording, findings)
    return DataCheck(robot.name, recording, findings, (*recording.notes, *_taken(robot, right, settings)))


def data_errors(robot: Robot, recording: Recording, settings: DataSettings) -> tuple[DataFinding, ...]:
    """What of a recording in its robot's quantities (`readings.quantities.of_robot`) cannot be right."""
    if arrived := tuple(stamps.of_arrival(recording, settings)):  # nothing else can be told from wrong times
        return arrived
    now = without_pauses(recording)
    direct = list(encoders.differences(robot, now, settings))
    now = columns.repaired(now, direct)
    rates = list(velocities.disagreeing(robot, now, settings))
    now = columns.repaired(now, rates)
    direct = [*direct, *rates]
    found = [*bodies.impossible(robot, settings), *_merged(direct, _by_torques(robot, now, settings))]
    command = _command(robot, recording)
    return tuple(replace(f, recording=recording.name, command=command if f.columns else "") for f in found)


def _taken(robot: Robot, recording: Recording, settings: DataSettings) -> tuple[str, ...]:
    """How a diagnosis takes the channels of a recording, or why it refuses them."""
    try:
        seen = inspected(robot, without_pauses(recording))
    except RecordingError as error:
        return (str(error),)
    lag = torque_lag(robot, seen, settings)
    known = len(recording.notes)
    return (*seen.notes[known:], *([str(lag)] if lag is not None else []))


@dataclass(frozen=True)
class _Told:
    """A finding of the torques, with its change."""

    change: Change
    joint: str  # whose torque shows it
    finding: DataFinding


def _by_torques(robot: Robot, recording: Recording, settings: DataSettings) -> list[_Told]:
    data = sampled(robot, recording, settings)
    if data is None:
        return []
    balance = Balance(data, settings)
    errors = found_errors(balance)
    by_change = {id(found.change): found for found in errors}
    out = []
    for change in turned.together(balance, unit.together(balance, [f.change for f in errors])):
        first = by_change.get(id(change)) or next(
            f for f in errors if set(f.change.torques) & set(change.torques)
        )
        out.append(_Told(change, first.joint, _finding(robot, recording, change, first)))
    return out


def _finding(robot: Robot, recording: Recording, change: Change, found: Found) -> DataFinding:
    instead = [said(robot, other) for other in found.instead]
    text = said(robot, change) + evidence(found.joint, found.factor, instead)
    gravity = ""
    if change.gravity is not None:
        gravity = f"gravity: [{', '.join(f'{x:.6g}' for x in change.gravity)}]"
    made = (*columns.of_motion(recording, change.positions), *columns.of_torques(recording, change.torques))
    joint = change.joints[0] if len(change.joints) == 1 else None
    return DataFinding(change.error, joint, text, made, gravity, found.factor, found.left)


def _merged(direct: Sequence[DataFinding], by_torques: Sequence[_Told]) -> list[DataFinding]:
    """The findings; where the motor's encoder was made like the link's, and torques then say that both are
    wrong in the same way, it is the link's encoder that is."""
    left, out = list(by_torques), []
    for finding in direct:
        partner = next((told for told in left if _undoes(finding, told.change)), None)
        if partner is None:
            out.append(finding)
            continue
        left.remove(partner)
        out.append(_of_link(finding, partner))
    return [*out, *(told.finding for told in left)]


def _of_link(finding: DataFinding, partner: _Told) -> DataFinding:
    """The finding of the link's encoder that stands for one of the motor's and one of both."""
    name, told = finding.joint, partner.finding
    own = tuple(c for c in told.columns if not c.name.startswith(("theta", "dtheta")))
    why = evidence(str(partner.joint), told.factor or 1.0, ())
    if finding.error == "turned_motor_encoder":
        text = f"q.{name} runs against theta.{name}: the link encoder of {name} has the wrong sign{why}"
        return replace(told, error="turned_link_encoder", text=text, columns=own)
    shift = partner.change.positions[str(name)].shift
    off = f"{math.degrees(-shift):.4g} degrees ({-shift:.4g} rad)"
    return replace(told, text=f"the zero of the link encoder of {name} is off by {off}{why}", columns=own)


def _undoes(finding: DataFinding, change: Change) -> bool:
    """Whether a change puts the motor's encoder back to what it was."""
    if finding.joint is None or set(change.positions) != {finding.joint} or change.torques:
        return False
    source = change.positions[finding.joint]
    if finding.error == "turned_motor_encoder":
        return change.error == turned.POSITION
    if finding.error != "zero" or change.error != zero.ZERO:
        return False
    offset = next(c.offset for c in finding.columns if c.name == f"theta.{finding.joint}")
    return abs(math.remainder(source.shift + offset, 2.0 * math.pi)) < 0.1


def _command(robot: Robot, recording: Recording) -> str:
    """The command that writes the repaired recording."""
    if shipped_robots().get(robot.name) == robot.path:
        source = robot.name
    else:
        source = str(robot.path or f"{robot.name}.yaml")
    return f"flexjoint check-data {recording.name} --robot {source} --out repaired.parquet"
