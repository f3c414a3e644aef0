"""Which recordings there are, of which machine, when and how warm: a folder, or a list.

A folder has one folder a machine, with its recordings and, unless one robot file is given for all, its robot
file. A list is a CSV with the columns `recording`, `machine`, and if known `robot`, `time`, `temperature`,
`event`; a row with an `event` and no recording is a repair. The `roster.csv` of a folder is its list.
"""

from __future__ import annotations

import csv
import math
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import read_text
from flexjoint.core.messages import shown
from flexjoint.recording.importing import BY_SUFFIX

LIST = "roster.csv"
MOST_BYTES = 50_000_000
COLUMNS = ("recording", "machine", "robot", "time", "temperature", "event")
ROBOTS = (".yaml", ".yml")
DATE = re.compile(r"(\d{4})-?(\d\d)-?(\d\d)(?:[T_ -]?(\d\d)[-:h]?(\d\d))?")


@dataclass(frozen=True)
class Entry:
    """A recording of a machine: `time` is of the clock [s since 1970], `temperature` [deg C] or None."""

    machine: str
    recording: Path
    robot: Path
    time: float
    temperature: float | None = None


@dataclass(frozen=True)
class Event:
    """What was done to a machine: it is another one from then on."""

    machine: str
    time: float
    text: str


@dataclass(frozen=True)
class Roster:
    """All recordings and events, by machine and time."""

    entries: tuple[Entry, ...]
    events: tuple[Event, ...] = ()


def read(source: Path, robot: Path | None = None) -> Roster:
    """The roster of a folder or a list; `robot` is the robot file of machines that name none.

    Raises FlexJointError where there is none, or a machine has no robot file."""
    if source.is_dir():
        roster = _of_list(source / LIST, robot) if (source / LIST).is_file() else _of_folder(source, robot)
    elif source.is_file():
        roster = _of_list(source, robot)
    else:
        raise FlexJointError(
            f"{source} does not exist; give a folder of recordings or a list (docs/howto/fleets.md)"
        )
    if not roster.entries:
        raise FlexJointError(
            f"{source} has no recording; give one folder a machine, or a list (docs/howto/fleets.md)"
        )
    order = tuple(sorted(roster.entries, key=lambda e: (e.machine, e.time, str(e.recording))))
    return Roster(order, tuple(sorted(roster.events, key=lambda e: (e.machine, e.time))))


def _of_folder(folder: Path, robot: Path | None) -> Roster:
    entries = []
    for own in sorted(path for path in folder.iterdir() if path.is_dir()):
        files = sorted(path for path in own.iterdir() if path.is_file())
        logs = [path for path in files if path.suffix.lower() in BY_SUFFIX]
        robots = [path for path in files if path.suffix in ROBOTS]
        if not logs:
            continue
        if robot is None and len(robots) != 1:
            raise FlexJointError(
                f"{own}: expected one robot file (YAML) beside the recordings, found {len(robots)}; or give"
                " one for all with --robot"
            )
        entries += [Entry(own.name, path, robot or robots[0], _time_of(path)) for path in logs]
    return Roster(tuple(entries))


def _of_list(path: Path, robot: Path | None) -> Roster:
    try:
        rows = list(csv.DictReader(read_text(path, MOST_BYTES).splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FlexJointError(f"{path} is no list in CSV: {error}") from None
    entries: list[Entry] = []
    events: list[Event] = []
    for k, row in enumerate(rows, start=2):
        where = f"{path.name} line {k}"
        unknown = [name for name in row if name not in COLUMNS]
        if unknown:
            raise FlexJointError(f"{path}: unknown column {shown(unknown[0])}; valid: {', '.join(COLUMNS)}")
        cells = {name: (value or "").strip() for name, value in row.items()}
        machine = cells.get("machine", "")
        if not machine:
            raise FlexJointError(f"{where}: expected a name in the column machine")
        if not cells.get("recording"):
            events.append(Event(machine, _stated(cells.get("time", ""), where), cells.get("event", "")))
            continue
        log = path.parent / cells["recording"]
        model = path.parent / cells["robot"] if cells.get("robot") else robot
        if model is None:
            raise FlexJointError(f"{where}: expected a robot file in the column robot, or --robot for all")
        time = _stated(cells["time"], where) if cells.get("time") else _time_of(log)
        if cells.get("event"):
            events.append(Event(machine, time, cells["event"]))
        entries.append(Entry(machine, log, model, time, _number(cells.get("temperature", ""), where)))
    return Roster(tuple(entries), tuple(events))


def _stated(text: str, where: str) -> float:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise FlexJointError(
            f"{where}: expected a time such as 2026-11-24T06:00, got {shown(text)}"
        ) from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _number(text: str, where: str) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FlexJointError(f"{where}: expected a temperature in deg C, got {shown(text)}")
    return value


def _time_of(path: Path) -> float:
    """The date in a file's name, else when it was written last."""
    found = DATE.search(path.stem)
    if found:
        year, month, day, hour, minute = (int(part or 0) for part in found.groups())
        with suppress(ValueError):  # digits that are no date
            return datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp()
    # no file is seen under a name that no disk takes, either, where Path.exists raises
    return path.stat().st_mtime if os.path.exists(path) else 0.0
