"""A run against its golden file: which signals differ, when first, by how much, and what has changed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexjoint.core.errors import FlexJointError, unknown
from flexjoint.simulation.simulate import Simulation
from flexjoint.simulation.testing.golden import UNITS, About, GoldenRun, read_golden, record_golden

RECORD = "FLEXJOINT_GOLDEN"  # environment variable; "record" writes golden files anew
ROWS = 12  # of the table of the worst
CHANGES = 12  # numbers named that are not what they were
ROUND_OFF = 1e-9  # relative: a parameter within it is the same, read by another version


@dataclass(frozen=True)
class Tolerance:
    """The largest difference that passes, in the signal's unit, and why that much."""

    absolute: float
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Of one signal: the largest difference, when [s], both values there; when it first exceeds the
    tolerance [s], None where it never does; root of the mean square."""

    signal: str
    largest: float
    at: float
    golden: float
    run: float
    first: float | None
    rms: float
    tolerance: Tolerance

    @property
    def times(self) -> float:
        """The largest difference in tolerances."""
        if self.tolerance.absolute == 0.0:
            return 0.0 if self.largest == 0.0 else np.inf
        return self.largest / self.tolerance.absolute


def differences(
    run: GoldenRun, golden: GoldenRun, tolerances: Mapping[str, float | Tolerance]
) -> tuple[Difference, ...]:
    """Every signal's difference, the worst (in tolerances) first.

    Args:
        tolerances: by signal (`q.elbow`) or channel (`q`), in the signal's unit; a signal's own counts first.

    Raises:
        FlexJointError: a signal without a tolerance, a negative one, runs of other signals or times.
        UnknownNameError: a tolerance of no signal.
    """
    limits = _limits(golden, tolerances)
    _same_form(run, golden)
    found = []
    for name, expected in golden.signals.items():
        values, limit = run.signals[name], limits[name]
        gap = np.abs(values - expected)
        gap[~np.isfinite(gap)] = np.inf
        k = int(np.argmax(gap))
        beyond = np.flatnonzero(gap > limit.absolute)
        first = float(golden.time[beyond[0]]) if beyond.size else None
        found.append(
            Difference(
                signal=name,
                largest=float(gap[k]),
                at=float(golden.time[k]),
                golden=float(expected[k]),
                run=float(values[k]),
                first=first,
                rms=float(np.sqrt(np.mean(gap**2))),
                tolerance=limit,
            )
        )
    return tuple(sorted(found, key=lambda item: (-item.times, item.signal)))


def assert_golden(
    run: GoldenRun, path: str | os.PathLike[str], tolerances: Mapping[str, float | Tolerance]
) -> None:
    """Fail unless the run is that of the golden file, signal by signal within the tolerances.

    With FLEXJOINT_GOLDEN=record in the environment the file is written anew, and the test fails once, so
    that nobody takes it for a comparison. A missing file fails, too.

    Raises:
        AssertionError: what differs; settings or a robot other than the file's; no file.
        FlexJointError: see `differences`; something else than what `golden_run` gives.
    """
    __tracebackhide__ = True  # pytest then shows the caller's line
    out = Path(path)
    if not isinstance(run, GoldenRun):
        motion = "run.trajectory" if isinstance(run, Simulation) else "trajectory"
        raise FlexJointError(
            f"assert_golden: expected what golden_run gives, got a {type(run).__name__}; pass"
            f" golden_run(model, {motion}, rate=20.0), which knows the robot and the rows to keep"
        )
    wanted = os.environ.get(RECORD, "")
    if wanted not in ("", "record"):
        raise FlexJointError(f"{RECORD}: expected record or nothing, got {wanted!r}")
    if wanted:
        _limits(run, tolerances)
        record_golden(run, out)
        raise AssertionError(
            f"golden file {out} was recorded, nothing was compared: {RECORD}=record is set. Look at what"
            " changed, keep the file, and run again without it"
        )
    if not out.is_file():
        raise AssertionError(
            f"golden file {out} does not exist. Record it: run once with {RECORD}=record, or call"
            " flexjoint.testing.record_golden(run, path)"
        )
    golden = read_golden(out)
    _same_run(run.about, golden.about, out)
    found = differences(run, golden, tolerances)
    wrong = [item for item in found if item.first is not None]
    if wrong:
        raise AssertionError("\n".join(_story(out, run, golden, wrong, len(found))))


# --- checks ----------------------------------------------------------------------------------------------
def _limits(run: GoldenRun, tolerances: Mapping[str, float | Tolerance]) -> dict[str, Tolerance]:
    given = {
        name: item if isinstance(item, Tolerance) else Tolerance(float(item))
        for name, item in tolerances.items()
    }
    channels = {name.partition(".")[0] for name in run.signals}
    for name, item in given.items():
        if name not in run.signals and name not in channels:
            raise unknown("signal or channel", name, [*sorted(channels), *run.signals])
        if not item.absolute >= 0.0:
            raise FlexJointError(f"tolerance of {name}: expected a number >= 0, got {item.absolute}")
    limits = {}
    for name in run.signals:
        limit = given.get(name, given.get(name.partition(".")[0]))
        if limit is None:
            raise FlexJointError(
                f"tolerances: none for {name}; give one for it or for all of {name.partition('.')[0]}"
            )
        limits[name] = limit
    return limits


def _same_form(run: GoldenRun, golden: GoldenRun) -> None:
    if set(run.signals) != set(golden.signals):
        more = sorted(set(run.signals) - set(golden.signals))
        less = sorted(set(golden.signals) - set(run.signals))
        raise FlexJointError(
            f"the golden run has other signals: without {', '.join(more[:5]) or 'none'}, with"
            f" {', '.join(less[:5]) or 'none'} that the run lacks; record it anew or keep other signals"
        )
    same = run.time.shape == golden.time.shape and np.allclose(run.time, golden.time, rtol=0, atol=1e-9)
    if not same:
        ends = [f"{len(t)} rows from {t[0]:g} to {t[-1]:g} s" for t in (golden.time, run.time)]
        raise FlexJointError(
            f"the golden run has other times: {ends[0]}, the run {ends[1]}; simulate as long and keep the"
            " same rate, or record it anew"
        )


def _same_run(now: About, then: About, path: Path) -> None:
    """Fail where the golden file is of another robot or of other settings."""
    pairs = [("robot", then.robot, now.robot), ("physics rate", then.physics, now.physics)]
    pairs += [
        (name, then.settings.get(name, "not said"), now.settings.get(name, "not said"))
        for name in sorted({*then.settings, *now.settings})
    ]
    other = [f"  {name}: {old} then, {new} now" for name, old, new in pairs if old != new]
    if other:
        raise AssertionError(
            "\n".join([f"{path} is the golden file of another run:", *other, _again("this run is the one")])
        )


# --- words -----------------------------------------------------------------------------------------------
def _story(
    path: Path, run: GoldenRun, golden: GoldenRun, wrong: Sequence[Difference], signals: int
) -> list[str]:
    first = min(wrong, key=lambda item: item.first or 0.0)
    lines = [
        f"the run is not that of {path}: {len(wrong)} of {signals} signals differ, first {first.signal} at"
        f" {first.first:g} s",
        *_table(wrong[:ROWS]),
    ]
    if len(wrong) > ROWS:
        lines.append(f"and {len(wrong) - ROWS} more signals, all closer to their tolerance")
    reasons = {item.signal.partition(".")[0]: item.tolerance.why for item in wrong if item.tolerance.why}
    lines += [f"tolerance of {name}: {why}" for name, why in reasons.items()]
    changed = _changes(run.about, golden.about)
    if changed:
        lines += ["what has changed since it was recorded:", *changed]
    else:
        lines.append("robot, settings and versions are those of the golden file: the code has changed")
    return [*lines, _again("the change is meant")]


def _again(when: str) -> str:
    return f"If {when}: record the file anew with {RECORD}=record, look at it, keep it"


def _table(items: Sequence[Difference]) -> list[str]:
    head = ("signal", "largest", "tolerance", "times", "first at", "largest at", "golden", "run", "RMS")
    rows = [head]
    for item in items:
        unit = UNITS.get(item.signal.partition(".")[0])
        rows.append(
            (
                f"{item.signal} [{unit}]" if unit else item.signal,
                f"{item.largest:.2g}",
                f"{item.tolerance.absolute:.2g}",
                f"{item.times:.2g}",
                f"{item.first:g} s",
                f"{item.at:g} s",
                f"{item.golden:.9g}",
                f"{item.run:.9g}",
                f"{item.rms:.2g}",
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    lines = []
    for name, *numbers in rows:
        cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=True)]
        lines.append("  ".join(["", name.ljust(widths[0]), *cells]))
    return lines


def _changes(now: About, then: About) -> list[str]:
    lines = [
        f"  {name}: {then.versions.get(name, 'none')} then, {now.versions.get(name, 'none')} now"
        for name in sorted({*then.versions, *now.versions})
        if then.versions.get(name) != now.versions.get(name)
    ]
    moved = []
    for name in sorted({*then.parameters, *now.parameters}):
        old, new = then.parameters.get(name), now.parameters.get(name)
        if old is None or new is None:
            words = ["absent" if value is None else f"{value:.9g}" for value in (old, new)]
            moved.append(f"  {name}: {words[0]} then, {words[1]} now")
        elif abs(new - old) > ROUND_OFF * max(abs(old), abs(new), 1e-6):
            moved.append(f"  {name}: {old:.9g} then, {new:.9g} now")
    lines += moved[:CHANGES]
    if len(moved) > CHANGES:
        lines.append(f"  and {len(moved) - CHANGES} more numbers of the model")
    return lines
