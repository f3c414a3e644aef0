"""From a roster to what is known of every machine: the first recording of each is diagnosed, all others are
checked against it, and those that alarm are diagnosed, too.

A repair makes another machine of one: its next recording is a reference again. All results are kept
(units.py), so a campaign that is stopped goes on where it was, and one that is complete does nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flexjoint.diagnosis.followup.fleet.roster import Entry, Event, Roster
from flexjoint.diagnosis.followup.fleet.units import Store, Unit, unit_of
from flexjoint.diagnosis.followup.fleet.workers import Runner
from flexjoint.diagnosis.settings import USUAL, FleetSettings

Key = tuple[str, str | None, str]  # effect, joint, parameter
Content = Mapping[str, Any]
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Reading:
    """What a recording says of its machine. `changed` joints with the reason; `numbers` with standard
    errors, NaN where none is known; `left` the torque error by joint [N m]."""

    entry: Entry
    numbers: Mapping[Key, tuple[float, float]]
    left: Mapping[str, float]
    temperature: Mapping[str, float]
    changed: Mapping[str, str] = field(default_factory=dict)
    grown: frozenset[str] = frozenset()  # of these, joints of which more torque error is left
    version: str = ""

    def warmth(self, joint: str | None) -> float:
        """Temperature of a joint, of the recording where the joint has none, or NaN [deg C]."""
        if joint is not None and joint in self.temperature:
            return self.temperature[joint]
        return math.nan if self.entry.temperature is None else self.entry.temperature


@dataclass(frozen=True)
class Period:
    """A machine from one repair to the next: its reference and all readings since, by time; `named` are
    causes beyond the reference's that enough of the diagnoses after an alarm name alike."""

    machine: str
    robot: Path
    event: Event | None  # with which it begins
    readings: tuple[Reading, ...]
    unusable: tuple[tuple[Entry, str], ...]
    known: frozenset[tuple[str, str | None]] = frozenset()  # causes of the reference
    named: frozenset[tuple[str, str | None]] = frozenset()

    @property
    def alarms(self) -> tuple[Reading, ...]:
        return tuple(reading for reading in self.readings if reading.changed)


@dataclass
class _Work:
    """The units that are done, and who does the others."""

    store: Store
    runner: Runner
    report: Progress
    seconds: float = 0.0  # of processors, for what was done now
    units: int = 0

    def done(self, units: Sequence[Unit], what: str) -> dict[str, Content]:
        results = {unit.key: self.store.get(unit.key) for unit in units}
        missing = list({unit.key: unit for unit in units if results[unit.key] is None}.values())
        if not missing:
            return {key: result for key, result in results.items() if result is not None}
        self.report(0.0, what)  # the first one may take minutes
        for k, result in enumerate(self.runner(missing)):
            if not result.get("died"):
                self.store.put(result)
            results[result["key"]] = result
            self.seconds, self.units = self.seconds + float(result["seconds"]), self.units + 1
            self.report((k + 1) / len(missing), what)
        return {key: result for key, result in results.items() if result is not None}


def campaign(
    roster: Roster, store: Store, runner: Runner, settings: FleetSettings, report: Progress
) -> tuple[tuple[Period, ...], int, float]:
    """All periods of all machines; how many units were done now, and the processors' time [s] for them."""
    work = _Work(store, runner, report)
    periods = _references(_split(roster), work)
    periods = _checked(periods, work, "checking")
    periods = _searched(periods, work, settings)
    return tuple(one.period for one in periods), work.units, work.seconds


@dataclass(frozen=True)
class _Open:
    """A period in the making: `known` is the JSON of its reference's diagnosis, once there is one."""

    period: Period
    entries: tuple[Entry, ...]
    known: Content | None = None


def _split(roster: Roster) -> list[_Open]:
    out = []
    for machine in dict.fromkeys(entry.machine for entry in roster.entries):
        own = [entry for entry in roster.entries if entry.machine == machine]
        begins: list[Event | None] = [None, *(e for e in roster.events if e.machine == machine)]
        for k, event in enumerate(begins):
            start = -math.inf if event is None else event.time
            following = begins[k + 1] if k + 1 < len(begins) else None
            end = math.inf if following is None else following.time
            part = tuple(entry for entry in own if start <= entry.time < end)
            if part:
                out.append(_Open(Period(machine, part[0].robot, event, (), ()), part))
    return out


def _references(periods: list[_Open], work: _Work) -> list[_Open]:
    """The first usable recording of each, diagnosed."""
    out: list[_Open] = []
    while periods:
        units = {id(one): unit_of("diagnosis", one.entries[0].recording, one.period.robot) for one in periods}
        results = work.done(list(units.values()), "diagnosing the first recording of each robot")
        later: list[_Open] = []
        for one in periods:
            result, entry = results[units[id(one)].key], one.entries[0]
            error = result["error"] or _refused(result["content"])
            if not error:
                reading = _of_diagnosis(entry, result)
                known = frozenset((e["effect"], e["joint"]) for e in result["content"]["findings"])
                period = replace(one.period, readings=(reading,), known=known)
                out.append(_Open(period, one.entries[1:], result["content"]))
                continue
            period = replace(one.period, unusable=(*one.period.unusable, (entry, error)))
            rest = _Open(period, one.entries[1:])
            (later if rest.entries else out).append(rest)
        periods = later
    return sorted(
        out, key=lambda one: (one.period.machine, one.period.event.time if one.period.event else 0.0)
    )


def _refused(content: Content) -> str:
    return str(content["reason"]) if content["verdict"] == "refused" else ""


def _checked(periods: list[_Open], work: _Work, what: str) -> list[_Open]:
    """All recordings after the reference, against what is known."""
    units = {
        (k, i): unit_of("check", entry.recording, one.period.robot, one.known)
        for k, one in enumerate(periods)
        if one.known is not None
        for i, entry in enumerate(one.entries)
    }
    results = work.done(list(units.values()), what)
    out = []
    for k, one in enumerate(periods):
        readings, unusable = list(one.period.readings), list(one.period.unusable)
        for i, entry in enumerate(one.entries if one.known is not None else ()):
            result = results[units[k, i].key]
            if result["error"]:
                unusable.append((entry, result["error"]))
            else:
                readings.append(_of_check(entry, result))
        out.append(
            replace(one, period=replace(one.period, readings=tuple(readings), unusable=tuple(unusable)))
        )
    return out


def _searched(periods: list[_Open], work: _Work, settings: FleetSettings) -> list[_Open]:
    """Full searches where a check alarms, and the numbers of what they name in all recordings."""
    units: dict[tuple[int, int], Unit] = {}
    for k, one in enumerate(periods):
        alarms = one.period.alarms
        chosen = [*alarms[: settings.searches - 1], *alarms[settings.searches - 1 :][-1:]]
        for i, reading in enumerate(chosen):
            units[k, i] = unit_of("diagnosis", reading.entry.recording, one.period.robot)
    results = work.done(list(units.values()), "diagnosing what has changed")
    out = []
    for k, one in enumerate(periods):
        found = [results[unit.key] for (p, _), unit in units.items() if p == k]
        contents = [r["content"] for r in found if not r["error"]]
        out.append(_named(one, contents, settings))
    followed = [one for one in out if one.period.named]
    again = iter(_checked([_restarted(one) for one in followed], work, "following what was found"))
    return [_followed(one, next(again)) if one.period.named else one for one in out]


def _named(one: _Open, contents: Sequence[Content], settings: FleetSettings) -> _Open:
    """With the causes that enough diagnoses name alike, beyond those of the reference."""
    if one.known is None:
        return one
    votes: dict[tuple[str, str | None], list[Content]] = {}
    for content in contents:
        for entry in content["findings"]:
            if entry["probability"] >= USUAL.verdict.likely and entry["since"] is None:
                votes.setdefault((entry["effect"], entry["joint"]), []).append(entry)
    everywhere = {effect for effect, joint in one.period.known if joint is None}
    new = {
        key: entries[-1]
        for key, entries in votes.items()
        if len(entries) >= settings.confirmed and key not in one.period.known and key[0] not in everywhere
    }
    if not new:
        return one
    known = {**one.known, "findings": [*one.known["findings"], *new.values()]}
    return replace(one, known=known, period=replace(one.period, named=frozenset(new)))


def _restarted(one: _Open) -> _Open:
    """The period with all its usable recordings to be looked at again, its reference included."""
    entries = tuple(reading.entry for reading in one.period.readings)
    return _Open(replace(one.period, readings=(), unusable=()), entries, one.known)


def _followed(one: _Open, again: _Open) -> _Open:
    """The period's readings with the numbers of `again`."""
    better = {reading.entry: reading for reading in again.period.readings}
    readings = tuple(
        replace(reading, numbers=better[reading.entry].numbers) if reading.entry in better else reading
        for reading in one.period.readings
    )
    return replace(one, period=replace(one.period, readings=readings))


# ------------------------------------------------------------------ what a result says
def _of_diagnosis(entry: Entry, result: Content) -> Reading:
    numbers: dict[Key, tuple[float, float]] = {}
    for found in result["content"]["findings"]:
        for name, given in found["parameters"].items():
            if isinstance(given, str):
                continue
            values, stds = given["value"], given["std"]
            pairs = zip(values, stds, strict=True) if isinstance(values, list) else [(values, stds)]
            for k, (value, std) in enumerate(pairs):
                label = f"{name}[{k}]" if isinstance(values, list) else name
                numbers[found["effect"], found["joint"], label] = (float(value), _number(std))
    left = {one["joint"]: float(one["after"]) for one in result["content"]["remaining"]}
    return Reading(entry, numbers, left, result["temperature"], version=result["version"])


def _of_check(entry: Entry, result: Content) -> Reading:
    numbers: dict[Key, tuple[float, float]] = {}
    left: dict[str, float] = {}
    changed: dict[str, str] = {}
    grown: set[str] = set()
    for joint in result["content"]["joints"]:
        if joint["left"] is not None:
            left[joint["joint"]] = float(joint["left"]["after"])
        states = [f"{c['effect']} {c['state']}" for c in joint["causes"] if c["state"] in ("moved", "gone")]
        if joint["grown"]:
            grown.add(joint["joint"])
        if joint["state"] == "changed":
            changed[joint["joint"] or ""] = "; ".join([*states, joint["grown"]] if joint["grown"] else states)
        for cause in joint["causes"]:
            for name, one in cause["parameters"].items():
                key = cause["effect"], joint["joint"], name
                numbers[key] = (float(one["now"]), _number(one["now_std"]))
    return Reading(entry, numbers, left, result["temperature"], changed, frozenset(grown), result["version"])


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
