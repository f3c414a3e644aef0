"""Who needs somebody: over all robots of a fleet, with false alarms controlled.

A robot's evidence is the stronger of two, both counted as chances: how many of its checks alarm, and how far
one of its numbers has changed over time. Robots are then taken together (Benjamini and Hochberg 1995,
`scipy.stats.false_discovery_control`), so that of those shown only a stated share needs nobody. One alarm
alone asks for a second recording, and names nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.stats import binom, false_discovery_control

from flexjoint.diagnosis.followup.fleet import words
from flexjoint.diagnosis.followup.fleet.campaign import Key, Period, Reading
from flexjoint.diagnosis.followup.fleet.trends import Change, change
from flexjoint.diagnosis.result.wording import percent
from flexjoint.diagnosis.settings import USUAL, FleetSettings
from flexjoint.robot.robot import Robot

State = Literal["needs", "again", "unusable", "green"]
NEARLY = 0.9999  # what no finite number of recordings goes beyond
BY_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass(frozen=True)
class Trend:
    """A number of a machine over its recordings since the last repair; (N,) each."""

    key: Key
    time: np.ndarray
    values: np.ndarray
    stds: np.ndarray
    temperature: np.ndarray
    change: Change | None
    significant: bool = False


@dataclass(frozen=True)
class Trouble:
    """One thing that is wrong with a robot, in shop words; `weight` orders them."""

    joint: str | None
    what: str
    sort: words.Sort | Literal["unknown"]
    since: float
    weight: float
    key: Key | None = None


@dataclass(frozen=True)
class Line:
    """One robot: its state, and for one that needs somebody what is wrong, the heaviest first. `chance` is
    how often chance alone makes a robot look like this, all robots counted."""

    period: Period
    state: State
    chance: float
    troubles: tuple[Trouble, ...]
    trends: tuple[Trend, ...]
    next: str = ""

    @property
    def sure(self) -> str:
        """How sure it is that this is no chance; never certain."""
        return percent(min(1.0 - self.chance, NEARLY))

    @property
    def weight(self) -> float:
        return max((trouble.weight for trouble in self.troubles), default=0.0)


def assessed(
    periods: Sequence[Period], robots: Mapping[Path, Robot], settings: FleetSettings
) -> tuple[Line, ...]:
    """The latest period of every machine as a line, the most urgent first."""
    latest = list({period.machine: period for period in periods}.values())
    trends = [_trends(period, settings) for period in latest]
    chances = [_chance(period, own, settings) for period, own in zip(latest, trends, strict=True)]
    counted = false_discovery_control(chances) if chances else ()
    lines = [
        _line(period, own, float(p), robots[period.robot], settings)
        for period, own, p in zip(latest, trends, counted, strict=True)
    ]
    order = {"needs": 0, "again": 1, "unusable": 2, "green": 3}
    return tuple(sorted(lines, key=lambda line: (order[line.state], -line.weight, line.period.machine)))


def _trends(period: Period, settings: FleetSettings) -> tuple[Trend, ...]:
    keys = dict.fromkeys(key for reading in period.readings for key in reading.numbers)
    out = []
    for key in keys:
        shown = [reading for reading in period.readings if key in reading.numbers]
        pairs = np.array([reading.numbers[key] for reading in shown], dtype=float)
        time = np.array([reading.entry.time for reading in shown])
        warmth = np.array([reading.warmth(key[1]) for reading in shown])
        found = change(time, pairs[:, 0], pairs[:, 1], warmth, settings)
        out.append(Trend(key, time, pairs[:, 0], pairs[:, 1], warmth, found))
    return tuple(out)


def _alarms(period: Period, trends: Sequence[Trend], settings: FleetSettings) -> tuple[Reading, ...]:
    """The readings that alarm, without those in which numbers moved as their temperature makes them."""
    heated = {
        joint
        for joint in {trend.key[1] or "" for trend in trends}
        if all(_by_heat(t, settings) for t in trends if (t.key[1] or "") == joint)
    }
    return tuple(
        reading
        for reading in period.alarms
        if any(j in reading.grown or j not in heated for j in reading.changed)
    )


def _by_heat(trend: Trend, settings: FleetSettings) -> bool:
    """Whether the temperature leaves no change of a number to be seen."""
    found = trend.change
    return found is not None and found.warm and found.chance > settings.false_alarms


def _chance(period: Period, trends: Sequence[Trend], settings: FleetSettings) -> float:
    """How often chance alone makes so many alarms, or changes a number so much."""
    checks, alarms = max(0, len(period.readings) - 1), len(_alarms(period, trends, settings))
    by_alarms = float(binom.sf(alarms - 1, checks, USUAL.check.chance)) if alarms else 1.0
    changes = [trend.change.chance for trend in trends if trend.change is not None]
    by_change = min(changes, default=1.0) * len(changes)
    return min(1.0, 2.0 * min(by_alarms, by_change))


def _line(
    period: Period, trends: tuple[Trend, ...], chance: float, robot: Robot, settings: FleetSettings
) -> Line:
    sure = chance <= settings.false_alarms
    marked = tuple(_marked(trend, len(trends), settings) if sure else trend for trend in trends)
    last = period.readings[-1] if period.readings else None
    changed = [trend for trend in marked if trend.significant]
    if last is None:
        return Line(period, "unusable", 1.0, (), marked, "record again: no recording could be used")
    alarms = _alarms(period, trends, settings)
    alarming = last in alarms
    repeated = len(alarms) >= settings.confirmed and alarming
    if sure and (changed or repeated):
        troubles = _troubles(period, changed, repeated, robot)
        if troubles:
            sort = troubles[0].sort
            advice = words.NEXT[sort] if sort != "unknown" else UNKNOWN_NEXT
            return Line(period, "needs", chance, troubles, marked, advice)
    if alarming:
        text = "the last recording is not as before: record a second time"
        return Line(period, "again", chance, (), marked, text)
    return Line(period, "green", chance, (), marked)


UNKNOWN_NEXT = "record a motion that excites all joints, and diagnose it; then look at the joint"


def _marked(trend: Trend, count: int, settings: FleetSettings) -> Trend:
    found = trend.change
    if found is None or found.kind == "none":
        return trend
    size = abs(found.now - found.was)
    matters = size > settings.least_change * max(abs(found.now), abs(found.was))
    significant = found.chance * count <= settings.false_alarms and matters
    return Trend(trend.key, trend.time, trend.values, trend.stds, trend.temperature, found, significant)


def _troubles(period: Period, changed: Sequence[Trend], repeated: bool, robot: Robot) -> tuple[Trouble, ...]:
    """What changed among the numbers, the causes that were named since, or the joints where more is left."""
    out: dict[tuple[str, str | None], Trouble] = {}
    for trend in changed:
        effect, joint, parameter = trend.key
        found = trend.change
        if parameter == words.main_parameter(effect) and found is not None:
            since = min(found.since, _lasting(period, joint))
            out[effect, joint] = _moved(trend.key, found.was, found.now, since, robot)
    first = next((reading for reading in period.alarms), None)
    since = first.entry.time if first is not None else 0.0
    for effect, joint in sorted(period.named, key=str) if repeated else ():
        key = (effect, joint, words.main_parameter(effect))
        pairs = [reading.numbers[key][0] for reading in period.readings if key in reading.numbers]
        if (effect, joint) not in out and pairs:
            out[effect, joint] = _moved(key, pairs[0], pairs[-1], since, robot)
    troubles = sorted(out.values(), key=lambda trouble: -trouble.weight)
    if not troubles and repeated:
        troubles = _unknown(period.readings[-1], since, robot)
    return tuple(troubles)


def _lasting(period: Period, joint: str | None) -> float:
    """The time of the first of the alarms of a joint that go on to the end; infinite without any."""
    since = math.inf
    for reading in reversed(period.readings):
        if (joint or "") not in reading.changed:
            break
        since = reading.entry.time
    return since


def _moved(key: Key, was: float, now: float, since: float, robot: Robot) -> Trouble:
    effect, joint, parameter = key
    before, after = (words.amount(effect, parameter, value, robot, joint) for value in (was, now))
    text = f"{words.name_of(effect)} {after}, was {before}"
    weight = words.heaviness(effect, parameter, now - was, robot, joint)
    return Trouble(joint, text, words.sort_of(effect), since, weight, key)


def _unknown(last: Reading, since: float, robot: Robot) -> list[Trouble]:
    """Joints that changed without a cause that was named twice."""
    out = []
    for joint, why in last.changed.items():
        weight = 0.0
        if joint in robot.joint_names:
            limit = robot.joint(joint).torque_limit
            weight = last.left.get(joint, 0.0) / (limit if limit < words.UNLIMITED else 100.0)
        out.append(Trouble(joint or None, f"not as before ({why})", "unknown", since, weight))
    return out


# ------------------------------------------------------------------ robots of one type
def of_types(periods: Sequence[Period], settings: FleetSettings) -> tuple[str, ...]:
    """Robots of one type as each other's reference: a cause that most of them have is an error of the nominal
    model, and a number that is far from all others' is odd."""
    latest = list({period.machine: period for period in periods}.values())
    out = []
    for path in dict.fromkeys(period.robot for period in latest):
        own = [period for period in latest if period.robot == path and period.readings]
        if len(own) < settings.fewest_alike:
            continue
        keys = dict.fromkeys(key for period in own for key in period.readings[-1].numbers)
        for key in keys:
            effect, joint, parameter = key
            if parameter != words.main_parameter(effect):
                continue
            having = [period for period in own if key in period.readings[-1].numbers]
            where = f"{words.name_of(effect)}{f' at {joint}' if joint else ''}"
            if len(having) >= settings.alike * len(own):
                out.append(
                    f"{len(having)} of {len(own)} robots of {path.name} have {where}: the nominal model is"
                    " likely wrong for all of them"
                )
            values = np.array([period.readings[-1].numbers[key][0] for period in having])
            out += [
                f"{having[k].machine} is odd among the robots of {path.name}: {where}"
                for k in _odd(values, settings)
            ]
    return tuple(out)


def _odd(values: np.ndarray, settings: FleetSettings) -> list[int]:
    if values.size < settings.fewest_alike + 1:
        return []
    middle = float(np.median(values))
    spread = BY_MAD * float(np.median(np.abs(values - middle)))
    # what scatters less than a check would notice is no scatter
    spread = max(spread, settings.least_change * abs(middle))
    return [int(k) for k in np.flatnonzero(np.abs(values - middle) > settings.odd * spread)]
