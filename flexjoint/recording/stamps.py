"""Time stamps as loggers write them, made into seconds that increase strictly.

What the stamps themselves show beyond doubt is repaired, and every repair is a note: whole numbers of
nanoseconds, rows that stand twice, single wrong stamps, rows out of order, stamps of arrival that several
rows share, and pieces that were joined. Everything else is refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import RecordingError
from flexjoint.core.limits import RECORDING
from flexjoint.recording.messages import refusal

Columns = Mapping[tuple[str, str], np.ndarray]

SLOWEST = 50.0  # Hz; below it neither springs nor controllers show
FASTEST_COUNTED = 2e4  # Hz; no robot is logged faster: what divides microseconds from nanoseconds
UNITS = {"nanoseconds": 1e-9, "microseconds": 1e-6, "milliseconds": 1e-3}
EPOCH = (1e9, 4e9)  # s since 1970, of the years 2001 to 2096: a clock of a computer
LATEST = RECORDING.time  # s, beyond which no time lies
PAUSE = 1.0  # s: whitening leaves a tail of half a second, so that two pieces do not see each other; or
PAUSE_PERIODS = 10.0  # sampling periods, where those are longer
PIECE = 50  # rows, as of a recording: fewer between two steps back are no piece of a recording
EVEN = 0.35  # of a period by which a step may differ from it on an even clock with jitter (`clock.JITTER`)
MOSTLY = 0.95  # share of even steps from which there is an even clock: one stamp in forty is wrong at most
NEAR = 8  # rows after a step among which those that fit the clock again are looked for
SURE = 5.0  # standard errors of a phase that changes: of jitter one step in a million shows as much
FEW = 0.05  # share of rows up to which wrong stamps are exceptions, and can be repaired one by one
MERGES = 64  # rows of one time that may complete each other: one of each channel
BURSTS = 5  # stamps of arrival, at least, that make an even clock


@dataclass(frozen=True)
class Stamped:
    """Rows with time (N,) [s] that increases strictly, their columns, and what was repaired."""

    time: np.ndarray
    columns: Columns
    notes: tuple[str, ...] = ()

    def of(self, rows: np.ndarray, *notes: str) -> Stamped:
        """Some rows (a mask or numbers), with further notes."""
        columns = {key: values[rows] for key, values in self.columns.items()}
        return Stamped(self.time[rows], columns, (*self.notes, *notes))


def pause_of(period: float) -> float:
    """Seconds between two pieces that do not see each other, at a sampling period [s]."""
    return max(PAUSE, PAUSE_PERIODS * period)


def repaired(time: np.ndarray, columns: Columns, name: str) -> Stamped:
    """The rows on a clock in seconds that increases strictly.

    Args:
        time: (N,) stamps, in seconds as floats or in a unit of its own as whole numbers; NaN or masked where
            missing.
        columns: (N,) each.

    Raises RecordingError where the stamps cannot be repaired beyond doubt.
    """
    missing = np.ma.getmaskarray(time) if isinstance(time, np.ma.MaskedArray) else np.zeros(time.shape, bool)
    raw = np.asarray(time)
    if raw.dtype.kind == "f":
        missing = missing | ~np.isfinite(raw)
    rows = Stamped(raw, dict(columns))
    if np.any(missing):
        rows = _without_unstamped(rows, missing, name)
    rows = _in_seconds(rows, name)
    if rows.time.size and np.max(np.abs(rows.time)) > LATEST:
        raise refusal(
            name, f"time reaches {np.max(np.abs(rows.time)):.3g}, expected seconds below {LATEST:g}"
        )
    rows = _once(rows)
    rows = _in_order(rows)
    wrong, joints = _backwards(rows.time)
    if np.mean(wrong) > FEW:
        raise _not_increasing(rows.time, name)
    rows = _joined(rows, wrong, joints, name)
    rows, wrong = _spread(rows, wrong, name)
    off, slips = _off_clock(rows.time, wrong)
    if slips.size:
        rows = _apart(rows, wrong | off, slips, "goes on with another phase from")
    rows = _without(rows, wrong | off)
    if np.any(np.diff(rows.time) <= 0.0):
        raise _not_increasing(rows.time, name)
    return rows


def _not_increasing(time: np.ndarray, name: str) -> RecordingError:
    row = int(np.flatnonzero(np.diff(time) <= 0.0)[0])
    return refusal(
        name,
        f"time must increase strictly, but goes from {time[row]:.6g} to {time[row + 1]:.6g} s in row"
        f" {row + 2}, and the stamps do not show how to repair that; sort or clean the table",
    )


def _without_unstamped(rows: Stamped, missing: np.ndarray, name: str) -> Stamped:
    count = int(np.count_nonzero(missing))
    if count > FEW * missing.size:
        row = int(np.flatnonzero(missing)[0])
        raise refusal(
            name,
            f"time is not a number in row {row + 1} and {count} rows in all; every row needs its time [s]",
        )
    return rows.of(~missing, f"{_rows(count)} without a time stamp left out")


# --- units ------------------------------------------------------------------------------------------------
def _in_seconds(rows: Stamped, name: str) -> Stamped:
    """Whole numbers in a unit that their size shows, exactly from the first stamp; else the stamps as
    seconds."""
    time = rows.time
    if time.size < 2 or time.dtype.kind not in "iuf":
        return Stamped(np.asarray(time, dtype=float), rows.columns, rows.notes)
    approximate = np.asarray(time, dtype=float)
    if np.max(np.abs(approximate)) > 4e18 or not np.array_equal(approximate, np.round(approximate)):
        return Stamped(approximate, rows.columns, rows.notes)
    whole = time.astype(np.int64)
    since = (whole - whole[0]).astype(float)
    steps = np.diff(since)
    ahead = steps[steps > 0.0]
    if not ahead.size:
        return Stamped(approximate, rows.columns, rows.notes)
    # where stamps repeat, as those of bursts do, the mean tells how often a row came
    bursts = np.mean(steps == 0.0) > FEW
    step = float(np.sum(ahead)) / steps.size if bursts else float(np.median(ahead))
    unit = _unit(abs(float(approximate[0])), step)
    if unit is None:
        if step > 1.0 / (UNITS["microseconds"] * FASTEST_COUNTED):
            raise refusal(
                name,
                f"time is in whole numbers, {step:.4g} apart: neither seconds nor, at {SLOWEST:g} Hz to"
                f" {FASTEST_COUNTED:g} Hz, micro- or nanoseconds; give time in seconds",
            )
        return Stamped(approximate, rows.columns, rows.notes)
    note = (
        f"time holds whole numbers, read as {unit} from the first stamp ({1.0 / (UNITS[unit] * step):.4g} Hz)"
    )
    # a division by a power of ten rounds once; a product with 1e-9 would round twice
    return Stamped(since / round(1.0 / UNITS[unit]), rows.columns, (*rows.notes, note))


def _unit(first: float, step: float) -> str | None:
    """The unit of whole numbers by the size of the first (an epoch of 1970 tells it alone) and of a step."""
    for unit, seconds in UNITS.items():
        rate = 1.0 / (seconds * step)
        epoch = EPOCH[0] < first * seconds < EPOCH[1]
        plausible = SLOWEST * (1 - 1e-9) <= rate <= FASTEST_COUNTED
        # of a thousand milliseconds or one second only an epoch decides: a table of poses has a row a second
        if plausible and (epoch or unit != "milliseconds"):
            return unit
    return None


# --- rows that stand twice, or out of order ---------------------------------------------------------------
def _once(rows: Stamped) -> Stamped:
    """Without rows that repeat the one before; rows of one time that complete each other made one."""
    same = np.flatnonzero(np.diff(rows.time) == 0.0) + 1
    if not same.size:
        return rows
    twice = np.ones(same.size, dtype=bool)
    for values in rows.columns.values():
        before, here = values[same - 1], values[same]
        twice &= (before == here) | (np.isnan(before) & np.isnan(here))
    if np.any(twice):
        keep = np.ones(rows.time.size, dtype=bool)
        keep[same[twice]] = False
        rows = rows.of(keep, f"{_rows(np.count_nonzero(twice))} left out that repeat the row before")
    merged = 0
    for _ in range(MERGES):
        again = np.concatenate([[False], np.diff(rows.time) == 0.0])
        second = np.flatnonzero(again[1:] & ~again[:-1]) + 1
        fits = np.ones(second.size, dtype=bool)
        for values in rows.columns.values():
            fits &= ~(np.isfinite(values[second - 1]) & np.isfinite(values[second]))
        second = second[fits]
        if not second.size:
            break
        columns = {}
        for key, values in rows.columns.items():
            columns[key] = values.copy()
            columns[key][second - 1] = np.where(
                np.isnan(values[second - 1]), values[second], values[second - 1]
            )
        keep = np.ones(rows.time.size, dtype=bool)
        keep[second] = False
        rows, merged = Stamped(rows.time, columns, rows.notes).of(keep), merged + second.size
    note = f"{_rows(merged)} joined with the row before, of the same time and other channels"
    return Stamped(rows.time, rows.columns, (*rows.notes, note)) if merged else rows


def _in_order(rows: Stamped) -> Stamped:
    """Sorted, where that makes the steps even and few rows were out of order."""
    back = np.diff(rows.time) < 0.0
    if not np.any(back):
        return rows
    order = np.argsort(rows.time, kind="stable")
    moved = np.count_nonzero(order != np.arange(order.size))
    steps = np.diff(rows.time[order])
    ahead = np.diff(rows.time)
    period = float(np.median(ahead[ahead > 0.0])) if np.any(ahead > 0.0) else 0.0
    # steps of half the period would be two pieces of one time, not one recording
    if np.mean(back) > FEW or np.max(np.abs(steps - period)) > EVEN * period:
        return rows
    return rows.of(order, f"{_rows(moved)} out of order sorted by time")


# --- wrong stamps and joined pieces -----------------------------------------------------------------------
def _backwards(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) rows whose single stamp is wrong, and (m,) first rows of pieces at which time steps back."""
    wrong = np.zeros(time.size, dtype=bool)
    steps = np.diff(time)
    two = 2.0 * float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    joints = []
    for k in np.flatnonzero(steps < 0.0) + 1:
        # steps over this row, if it is early, or over the one before, if that is late
        early = time[k + 1] - time[k - 1] if k + 1 < time.size else two
        late = time[k] - time[k - 2] if k > 1 else two
        if max(early, late) <= 0.0:
            joints.append(k)
        elif late <= 0.0 or (early > 0.0 and abs(early - two) <= abs(late - two)):
            wrong[k] = True
        else:
            wrong[k - 1] = True
    return wrong, np.array(joints, dtype=int)


def _joined(rows: Stamped, wrong: np.ndarray, joints: np.ndarray, name: str) -> Stamped:
    """Pieces at whose beginning time steps back, one after the other."""
    if not joints.size:
        return rows
    if np.min(np.diff([0, *joints, rows.time.size])) < PIECE:
        raise _not_increasing(rows.time, name)
    return _apart(rows, wrong, joints, "steps back in")


def _apart(rows: Stamped, wrong: np.ndarray, joints: np.ndarray, how: str) -> Stamped:
    """Pieces that begin at some rows, with pauses between them."""
    steps = np.diff(rows.time)
    pause = pause_of(float(np.median(steps[steps > 0.0])))
    time = rows.time.copy()
    edges = [*joints, rows.time.size]
    for begin, end in itertools.pairwise(edges):
        before = time[begin - 1] if not wrong[begin - 1] else time[begin - 2]
        first = begin if not wrong[begin] else begin + 1
        time[begin:end] += before + pause - time[first]
    note = (
        f"time {how} {_rows(joints.size)} (the first is row {joints[0] + 1}): {joints.size + 1} pieces are"
        f" put one after the other, {pause:g} s apart"
    )
    return Stamped(time, rows.columns, (*rows.notes, note))


def _off_clock(time: np.ndarray, wrong: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) rows whose single stamp is early, late or that of a neighbour, and (m,) rows from which on a clock
    that is even otherwise has another phase: there two pieces were joined."""
    out = np.zeros(time.size, dtype=bool)
    good = np.flatnonzero(~wrong)
    t = time[good]
    steps = np.diff(t)
    if not np.any(steps > 0.0):
        return out, np.zeros(0, dtype=int)
    period = float(np.median(steps[steps > 0.0]))
    short = steps < (1.0 - EVEN) * period
    if np.mean(np.abs(steps - period) < EVEN * period) < MOSTLY or np.mean(short) > FEW:
        short = steps <= 0.0  # a clock without an even period: its stamps are as they are
    slips = []
    for k in (np.flatnonzero(short) + 1).tolist():
        if out[good[k]] or out[good[k - 1]]:
            continue
        after = np.arange(k, min(t.size, k + NEAR))
        late, error = _phase_step(t, k)
        if abs(late - (steps[k - 1] - period)) < 0.5 * EVEN * period and abs(late) > SURE * error:
            slips.append(good[k])
            continue
        # of the two the one is wrong without which the steps are even, and with it what follows off the clock
        next_fits = k + 1 < t.size and abs(t[k + 1] - t[k - 1] - 2.0 * period) < EVEN * period
        last_fits = k >= 2 and abs(t[k] - t[k - 2] - 2.0 * period) < EVEN * period
        if last_fits and not next_fits:
            out[good[k - 1]] = True
            continue
        out[good[k]] = True
        for j in after[1:]:
            if next_fits or abs(t[j] - t[k - 1] - (j - k + 1) * period) < EVEN * period:
                break
            out[good[j]] = True
    return out, np.array(slips, dtype=int)


def _phase_step(time: np.ndarray, k: int) -> tuple[float, float]:
    """By how much an even clock's phase changes at stamp k [s], and the standard error of that: by regression
    of the stamps around on their number and a step. Not known within a piece's length of either end."""
    if k < PIECE or k + PIECE > time.size:
        return 0.0, np.inf
    near = np.arange(k - PIECE, k + PIECE)
    terms = np.column_stack([np.ones(near.size), near - k, near >= k]).astype(float)
    stamps = time[near] - time[k]
    numbers = np.linalg.lstsq(terms, stamps, rcond=None)[0]
    missed = stamps - terms @ numbers
    variance = float(missed @ missed) / (near.size - terms.shape[1])
    return float(numbers[2]), float(np.sqrt(variance * np.linalg.inv(terms.T @ terms)[2, 2]))


def _without(rows: Stamped, wrong: np.ndarray) -> Stamped:
    """Without rows that have a wrong stamp: whether their samples came at the stamp or at the clock's tick is
    not known, and a missing sample does less harm than one at a wrong time."""
    if not np.any(wrong):
        return rows
    first = int(np.flatnonzero(wrong)[0])
    note = (
        f"{_rows(np.count_nonzero(wrong))} left out whose time stamp is early, late or that of a neighbour"
        f" (the first is row {first + 1})"
    )
    return rows.of(~wrong, note)


# --- bursts -----------------------------------------------------------------------------------------------
def _spread(rows: Stamped, wrong: np.ndarray, name: str) -> tuple[Stamped, np.ndarray]:
    """Rows that share stamps of arrival, on the even clock that those show."""
    good = np.flatnonzero(~wrong)
    shared = int(np.count_nonzero(np.diff(rows.time[good]) == 0.0))
    if shared <= FEW * good.size:
        return rows, wrong
    rows = rows.of(good)
    time = rows.time
    last = np.append(np.flatnonzero(np.diff(time) > 0.0), time.size - 1)  # of each burst: the freshest row
    gaps = np.diff(time[last])
    usual = float(np.median(gaps)) if gaps.size else 0.0
    edges = np.concatenate([[0], np.flatnonzero(gaps > 3.0 * usual) + 1, [last.size]])
    out = np.empty(time.size)
    begin = 0
    for first, end in itertools.pairwise(edges):
        ends = last[first:end]
        stretch = np.arange(begin, ends[-1] + 1)
        if ends.size < BURSTS:
            raise _unclear(shared, time.size, name)
        period, at = np.polyfit(ends - begin, time[ends] - time[begin], 1)
        late = time[ends] - time[begin] - period * (ends - begin) - at
        # a burst that came later than the next one should is no even clock: rows are missing
        if not np.max(np.abs(late)) < max(2.0 * period, usual):
            raise _unclear(shared, time.size, name)
        # a stamp can be late but not early: the earliest ones are the clock's
        out[stretch] = time[begin] + at + float(np.min(late)) + period * (stretch - begin)
        begin = int(ends[-1]) + 1
    note = (
        f"{_rows(shared)} share the stamp of another, as in bursts: all are put on the even clock that the"
        f" stamps show ({1.0 / np.median(np.diff(out)):.4g} Hz)"
    )
    return Stamped(out, rows.columns, (*rows.notes, note)), np.zeros(time.size, dtype=bool)


def _unclear(shared: int, count: int, name: str) -> RecordingError:
    return refusal(
        name,
        f"time must increase strictly, but {shared} of {count} rows have the stamp of another row, and no"
        " even clock explains the stamps; log a time for each sample",
    )


def _rows(count: int | np.integer) -> str:
    return f"{count} row{'' if count == 1 else 's'}"
