"""What a reader of a format hands over: signals as they stand in the source, and what the format says of"
" them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from flexjoint.core.errors import RecordingError, unknown
from flexjoint.recording.messages import refusal, shown

Side = Literal["link", "motor"]
MOST_NAMES = 12  # signals that a message lists
TIMES = (
    "time",
    "t",
    "timestamp",
    "timestamps",
    "time_s",
    "stamp",
    "sec",
    "seconds",
)  # usual names of a clock
ELEMENT = re.compile(r"^(?P<signal>.+)\[(?P<at>\d{1,4})\]$")
NAMES = ("joint_names", "joints", "names", "joint_order")  # usual names of a list of joints


@dataclass(frozen=True)
class Signal:
    """One signal of a source: `values` (N, k), the names of its k columns there, and of the joints that they
    belong to where the source says it. `stamps` (N,) where it has a clock of its own."""

    values: np.ndarray
    columns: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    stamps: np.ndarray | None = None


@dataclass(frozen=True)
class Documented:
    """What the documentation of a format says that a signal is."""

    channel: str
    unit: str | None  # None: the format leaves it open
    why: str
    side: Side | None = None


@dataclass(frozen=True)
class Log:
    """A source as it is: nothing of it is converted.

    Args:
        source: its path, for messages.
        format: its name, for people.
        signals: by name.
        documented: by name of a signal.
        time: the signal that holds the stamps of those without stamps of their own.
        time_unit: of that signal, where the format fixes it.
        rate: samples a second, where the format has no stamps [Hz].
        joints: names in the order of signals that name none.
        notes: what was left out, and why.
    """

    source: str
    format: str
    signals: Mapping[str, Signal]
    documented: Mapping[str, Documented] = field(default_factory=dict)
    time: str | None = None
    time_unit: str | None = None
    rate: float | None = None
    joints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def find(self, name: str) -> Signal:
        """The signal of that name, or the one column that has it or that `signal[k]` numbers from 0;
        RecordingError lists what there is."""
        if name in self.signals:
            return self.signals[name]
        if (match := ELEMENT.match(name)) and match["signal"] in self.signals:
            whole, at = self.signals[match["signal"]], int(match["at"])
            if at >= whole.values.shape[1]:
                raise refusal(
                    self.source, f"{shown(name)}: the signal has {whole.values.shape[1]} columns, from [0] on"
                )
            return _column(whole, at, name)
        for signal in self.signals.values():
            if name in signal.columns:
                return _column(signal, signal.columns.index(name), name)
        reason = unknown("signal", shown(name), [shown(s) for s in list(self.signals)[:MOST_NAMES]])
        raise refusal(self.source, str(reason))


def _column(signal: Signal, at: int, name: str) -> Signal:
    joints = (signal.joints[at],) if signal.joints else ()
    return Signal(signal.values[:, at : at + 1], (name,), joints, signal.stamps)


def of_arrays(
    source: str,
    kind: str,
    arrays: Mapping[str, np.ndarray],
    joints: Sequence[str] = (),
    documented: Mapping[str, Documented] | None = None,
) -> Log:
    """A log of named arrays, as .npz, .mat, HDF5 and .pt files hold.

    Vectors (N,) and tables (N, k) or (k, N), whose N is that of the clock where there is one; other arrays
    are left out, and noted.
    """
    clock = next((name for name in arrays if last_part(name) in TIMES and _vector(arrays[name])), None)
    count = arrays[clock].size if clock is not None else None
    signals: dict[str, Signal] = {}
    left: list[str] = []
    for name, array in arrays.items():
        table = _table(array, count)
        if last_part(name) in NAMES and table is None:
            continue
        if table is None:
            left.append(name)
        else:
            signals[name] = Signal(table)
    if not signals:
        raise refusal(source, f"holds no array of numbers over time, as expected of a log ({kind})")
    notes = (f"not over time, and not used: {named(left)}",) if left else ()
    return Log(source, kind, signals, documented or {}, time=clock, joints=tuple(joints), notes=notes)


def last_part(name: str) -> str:
    """A name without the groups and structs that it stands in, in small letters."""
    return re.split(r"[/.]", name)[-1].lower()


def names_in(arrays: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Names of joints that a file of arrays states as a list of words."""
    for name, array in arrays.items():
        if last_part(name) in NAMES and array.dtype.kind in "USO":
            words = [
                w.decode(errors="replace") if isinstance(w, bytes) else w for w in array.ravel().tolist()
            ]
            if all(isinstance(word, str) for word in words):
                return tuple(word.strip() for word in words)
    return ()


def named(names: Sequence[str]) -> str:
    """Names in a message, the first of many."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(shown(name) for name in names[:MOST_NAMES]) + more


def unreadable(source: str, kind: str, error: BaseException) -> RecordingError:
    """The refusal of a file that its format's library does not read."""
    said = " ".join(str(error).split()) or type(error).__name__
    return refusal(source, f"cannot be read as {kind}: {shown(said, 200)}")


def _vector(array: np.ndarray) -> bool:
    return array.dtype.kind in "iuf" and array.size > 1 and array.size == max(array.shape)


def _table(array: np.ndarray, count: int | None) -> np.ndarray | None:
    """(N, k) of an array of numbers over time; None of any other."""
    if array.dtype.kind not in "iuf" or array.size < 2:
        return None
    if array.ndim == 1:
        table = array[:, np.newaxis]
    elif array.ndim == 2:
        along = array.shape[1] == count if count is not None else array.shape[1] > array.shape[0]
        table = array.T if along and array.shape[0] != count else array
    else:
        return None
    return table if count is None or table.shape[0] == count else None
