"""The page of a fleet: one line for each robot that needs somebody, its numbers over time, and the rest as a
count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.followup.fleet import words
from flexjoint.diagnosis.followup.fleet.assess import Line, Trend
from flexjoint.diagnosis.followup.fleet.fleet import Fleet, day
from flexjoint.diagnosis.followup.fleet.units import release
from flexjoint.diagnosis.result.wording import clean
from flexjoint.report import plots
from flexjoint.report.page import template

DAY = 86_400.0  # [s]
PLOTS = 6  # numbers of a robot that are drawn
UNUSABLE = 50  # recordings that are listed
SORTS = (("wear", "Wear"), ("setting", "Settings"), ("sensor", "Sensors"), ("unknown", "Cause not known"))


@dataclass(frozen=True)
class Row:
    robot: str
    joint: str
    what: str
    more: tuple[str, ...]
    sure: str
    since: str
    next: str


@dataclass(frozen=True)
class Group:
    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Drawn:
    image: plots.Image
    caption: str


@dataclass(frozen=True)
class Detail:
    robot: str
    events: tuple[str, ...]
    plots: tuple[Drawn, ...]


def html(fleet: Fleet) -> str:
    """One self-contained HTML document in the style of a diagnosis' report."""
    needs = fleet.of("needs")
    unusable = [
        f"{clean(period.machine)}, {clean(entry.recording.name)}: {clean(error)}"
        for period in fleet.periods
        for entry, error in period.unusable
    ]
    return template("fleet.html").render(
        count=len(fleet.lines),
        needs=len(needs),
        green=len(fleet.of("green")),
        again=[f"{clean(line.period.machine)}: {line.next}" for line in fleet.of("again")],
        silent=[f"{clean(line.period.machine)}: {line.next}" for line in fleet.of("unusable")],
        groups=_groups(needs),
        details=[_detail(fleet, line) for line in needs],
        notes=[clean(note) for note in fleet.notes],
        unusable=unusable[:UNUSABLE],
        more=max(0, len(unusable) - UNUSABLE),
        recordings=sum(len(period.readings) for period in fleet.periods),
        version=release(),
        script=None,  # nothing to enlarge or sort
    )


def _groups(needs: Sequence[Line]) -> tuple[Group, ...]:
    """By the sort of the heaviest trouble; within one the most urgent first."""
    out = []
    for sort, title in SORTS:
        rows = tuple(_row(line) for line in needs if line.troubles[0].sort == sort)
        if rows:
            out.append(Group(title, rows))
    return tuple(out)


def _row(line: Line) -> Row:
    first, *more = line.troubles
    return Row(
        clean(line.period.machine),
        clean(first.joint or "whole robot"),
        clean(first.what),
        tuple(f"{clean(t.joint or 'whole robot')}: {clean(t.what)}" for t in more),
        line.sure,
        day(first.since),
        line.next,
    )


def _detail(fleet: Fleet, line: Line) -> Detail:
    events = [event for event in fleet.events if event.machine == line.period.machine]
    troubled = {trouble.key for trouble in line.troubles}
    chosen = sorted(line.trends, key=lambda trend: (trend.key not in troubled, not trend.significant))
    start = min((reading.entry.time for reading in line.period.readings), default=0.0)
    drawn = tuple(_drawn(trend, start, [event.time for event in events]) for trend in chosen[:PLOTS])
    told = tuple(f"{day(event.time)}: {clean(event.text)}" for event in events)
    return Detail(clean(line.period.machine), told, drawn)


def _drawn(trend: Trend, start: float, events: Sequence[float]) -> Drawn:
    effect, joint, parameter = trend.key
    points = trend.change.points if trend.change is not None and trend.significant else ()
    name = f"{words.name_of(effect)}{f' at {clean(joint)}' if joint else ''}: {clean(parameter)}"
    image = plots.over_time(
        (trend.time - start) / DAY,
        trend.values,
        trend.stds,
        [(point - start) / DAY for point in points],
        [(event - start) / DAY for event in events],
        words.unit_of(effect, parameter),
        name,
    )
    caption = f"{name}; days since {day(start)}"
    if trend.change is not None and trend.change.warm:
        caption += f"; {trend.change.per_degree:.2g} ± {trend.change.per_degree_error:.1g} per deg C"
    if not np.all(np.isfinite(trend.temperature)):
        caption += "; temperature not recorded"
    return Drawn(image, caption)
