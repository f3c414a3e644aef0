"""What was found of a fleet: who needs somebody, in words, and every number as a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from flexjoint.core.text import Block, Table, plain
from flexjoint.core.text import Line as TextLine
from flexjoint.diagnosis.followup.fleet.assess import Line, Trend
from flexjoint.diagnosis.followup.fleet.campaign import Period, Reading
from flexjoint.diagnosis.followup.fleet.roster import Event
from flexjoint.diagnosis.result.wording import clean
from flexjoint.robot.robot import Robot


@dataclass(frozen=True)
class Fleet:
    """What was found. `lines` has one robot each, the most urgent first; `notes` are about robots of one
    type; `units` were done now, in `seconds` of processors' time."""

    lines: tuple[Line, ...]
    periods: tuple[Period, ...]
    events: tuple[Event, ...]
    robots: Mapping[Path, Robot]
    notes: tuple[str, ...]
    units: int
    seconds: float

    def of(self, state: str) -> tuple[Line, ...]:
        """The robots in a state: needs, again, unusable or green."""
        return tuple(line for line in self.lines if line.state == state)

    def __str__(self) -> str:
        return plain(self.summary())

    def summary(self) -> tuple[Block, ...]:
        """Who needs somebody, as blocks of text."""
        return tuple(_blocks(self))

    def table(self) -> pa.Table:
        """Every number of every recording (docs/howto/fleets.md)."""
        rows = list(_rows(self))
        return pa.table(
            {name: pa.array([row[k] for row in rows], kind) for k, (name, kind) in enumerate(SCHEMA)}
        )

    def to_json(self) -> dict[str, Any]:
        """The page as JSON (docs/reference/formats.md)."""
        unusable = [(period, *pair) for period in self.periods for pair in period.unusable]
        return {
            "schema": 1,
            "robots": [_robot(line) for line in self.lines],
            "events": [{"robot": e.machine, "day": day(e.time), "text": e.text} for e in self.events],
            "unusable": [
                {"robot": period.machine, "recording": str(entry.recording), "error": error}
                for period, entry, error in unusable
            ],
            "notes": list(self.notes),
        }


SCHEMA = (
    ("robot", pa.string()),
    ("recording", pa.string()),
    ("time", pa.timestamp("s", tz="UTC")),
    ("joint", pa.string()),
    ("effect", pa.string()),
    ("parameter", pa.string()),
    ("value", pa.float64()),
    ("standard_error", pa.float64()),
    ("temperature", pa.float64()),
    ("changed", pa.bool_()),
    ("version", pa.string()),
)


def day(time: float) -> str:
    """A time as a date."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d")


def _rows(fleet: Fleet) -> Iterator[tuple[object, ...]]:
    for period in fleet.periods:
        for reading in period.readings:
            for (effect, joint, parameter), (value, std) in reading.numbers.items():
                yield _row(period.machine, reading, joint, effect, parameter, value, std)
            for joint, left in reading.left.items():
                yield _row(period.machine, reading, joint, "", "torque_error", left, math.nan)


def _row(
    machine: str, reading: Reading, joint: str | None, effect: str, parameter: str, value: float, std: float
) -> tuple[object, ...]:
    moment = datetime.fromtimestamp(int(reading.entry.time), UTC)
    warmth, changed = _known(reading.warmth(joint)), (joint or "") in reading.changed
    numbers = (value, _known(std), warmth, changed)
    return (
        machine, str(reading.entry.recording), moment, joint, effect, parameter, *numbers, reading.version
    )  # fmt: skip


def _robot(line: Line) -> dict[str, Any]:
    return {
        "robot": line.period.machine,
        "state": line.state,
        "chance": line.chance,
        "next": line.next,
        "troubles": [
            {"joint": t.joint, "what": t.what, "sort": t.sort, "since": day(t.since)} for t in line.troubles
        ],
        "numbers": [_number(trend) for trend in line.trends if trend.change is not None],
    }


def _number(trend: Trend) -> dict[str, Any]:
    """What became of a number over time, and how it follows the temperature."""
    found, (effect, joint, parameter) = trend.change, trend.key
    assert found is not None
    return {
        "effect": effect,
        "joint": joint,
        "parameter": parameter,
        "changed": found.kind if trend.significant else "none",
        "was": found.was,
        "now": found.now,
        "since": day(found.since),
        "chance": found.chance,
        "per_degree": found.per_degree if found.warm else None,
        "per_degree_error": found.per_degree_error if found.warm else None,
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _blocks(fleet: Fleet) -> Iterator[Block]:
    needs, again, unusable, green = (fleet.of(state) for state in ("needs", "again", "unusable", "green"))
    yield TextLine(
        f"{len(fleet.lines)} robots: {len(needs)} need somebody, {len(again)} to be recorded again,"
        f" {len(unusable)} without a usable recording, {len(green)} as before",
        "bold",
    )
    if needs:
        rows = tuple(
            (
                clean(line.period.machine),
                clean(trouble.joint or "whole robot"),
                clean(trouble.what),
                trouble.sort,
                line.sure,
                day(trouble.since),
                line.next,
            )
            for line in needs
            for trouble in line.troubles[:1]
        )
        heads = ("robot", "joint", "what", "sort", "sure", "since", "what next")
        yield Table(tuple((head, head == "sure") for head in heads), rows)
    for line in (*again, *unusable):
        yield TextLine(f"{clean(line.period.machine)}: {line.next}")
    for note in fleet.notes:
        yield TextLine(clean(note))
    bad = sum(len(period.unusable) for period in fleet.periods)
    if bad:
        yield TextLine(f"{bad} recordings could not be used; the page says why.", "dim")
