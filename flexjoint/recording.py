"""Recording: one table of measured signals over time (docs/formats.md), read, checked and written."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from flexjoint.errors import RecordingError, unknown
from flexjoint.files import write_bytes

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "q": "rad",
        "dq": "rad/s",
        "theta": "rad",
        "dtheta": "rad/s",
        "tau_t": "N m",
        "tau_m": "N m",
        "tau_motor": "N m",
        "q_ref": "rad",
        "theta_ref": "rad",
        "dtheta_ref": "rad/s",
        "tau_ff": "N m",
        "current": "A",
        "temperature": "deg C",
    }
)
MEASURED = ("q", "dq", "theta", "dtheta", "tau_t")  # what a simulation is compared on
MINIMUM_SAMPLES = 50
LEAST_PRESENT = 0.05  # of a column's rows


@dataclass(frozen=True)
class Recording:
    """Signals over time. `time` (N,) [s] strictly increasing; `columns` maps (channel, joint) to (N,),
    SI and link-referred, NaN where a sample is missing. A pair that is absent was not measured."""

    time: np.ndarray
    columns: Mapping[tuple[str, str], np.ndarray]
    name: str = "recording"

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that have any channel, in the table's order."""
        return tuple(dict.fromkeys(joint for _, joint in self.columns))

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])

    @property
    def period(self) -> float:
        """Typical sampling period [s] (median)."""
        return float(np.median(np.diff(self.time)))

    def has(self, channel: str, joint: str) -> bool:
        return (channel, joint) in self.columns

    def get(self, channel: str, joint: str) -> np.ndarray:
        """(N,) the samples, NaN where missing; UnknownNameError when it was not measured."""
        if (channel, joint) not in self.columns:
            raise unknown("channel", f"{channel}.{joint}", [f"{c}.{j}" for c, j in self.columns])
        return self.columns[channel, joint]

    def between(self, start: float, stop: float) -> Recording:
        """The part with start <= time < stop."""
        keep = (self.time >= start) & (self.time < stop)
        return Recording(
            self.time[keep], {k: v[keep] for k, v in self.columns.items()}, f"{self.name}[{start:g}:{stop:g}]"
        )


def make(
    time: np.ndarray, columns: Mapping[tuple[str, str], np.ndarray], name: str = "recording"
) -> Recording:
    """A checked recording. Raises RecordingError naming the column or row and what was expected."""
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size < MINIMUM_SAMPLES:
        raise RecordingError(f"{name}: expected at least {MINIMUM_SAMPLES} samples, got {time.size}")
    if not np.all(np.isfinite(time)):
        row = int(np.flatnonzero(~np.isfinite(time))[0])
        raise RecordingError(f"{name}: time is not a number in row {row + 1}; every row needs its time [s]")
    backwards = np.flatnonzero(np.diff(time) <= 0)
    if backwards.size:
        row = int(backwards[0])
        raise RecordingError(
            f"{name}: time must increase strictly, but goes from {time[row]:.6g} to {time[row + 1]:.6g} s"
            f" in row {row + 2}; sort or clean the table"
        )
    if not columns:
        raise RecordingError(f"{name}: no channel beside time; columns are <channel>.<joint>, e.g. q.elbow")
    checked: dict[tuple[str, str], np.ndarray] = {}
    for (channel, joint), values in columns.items():
        if channel not in UNITS:
            raise RecordingError(f"{name}: column {channel}.{joint}: {unknown('channel', channel, UNITS)}")
        array = np.asarray(values, dtype=float)
        if array.shape != time.shape:
            raise RecordingError(f"{name}: {channel}.{joint} has {array.size} samples, time has {time.size}")
        if np.any(np.isinf(array)):
            raise RecordingError(f"{name}: {channel}.{joint} holds infinite values; leave such cells empty")
        if not was_measured(array):
            raise RecordingError(
                f"{name}: column {channel}.{joint} holds {np.count_nonzero(np.isfinite(array))} numbers in"
                f" {time.size} rows; leave a channel out that was not measured"
            )
        checked[channel, joint] = array
    return Recording(time, MappingProxyType(checked), name)


def was_measured(values: np.ndarray) -> bool:
    """Whether a column (N,) holds enough numbers to count as a channel."""
    return int(np.count_nonzero(np.isfinite(values))) >= max(2, LEAST_PRESENT * values.size)


def read(source: str | os.PathLike[str]) -> Recording:
    """A recording from CSV or Parquet; RecordingError says what is wrong with the file."""
    path = Path(source)
    if not path.is_file():
        raise RecordingError(f"recording {path} does not exist; give a .csv or .parquet file")
    if path.stat().st_size == 0:
        raise RecordingError(f"recording {path} is empty; expected a table with a time column")
    try:
        if path.suffix == ".parquet":
            table = pa.parquet.read_table(path)
        elif path.suffix == ".csv":
            table = _read_csv(path)
        else:
            raise RecordingError(
                f"{path}: expected a .csv or .parquet file, got {path.suffix or 'no suffix'}"
            )
        names = table.column_names  # decoded here, so that a bad one is caught
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise RecordingError(f"{path} cannot be read as {path.suffix[1:]}: {reason}") from None
    return _from_table(table, names, path)


def _read_csv(path: Path) -> pa.Table:
    convert = pa.csv.ConvertOptions(null_values=["", "NaN", "nan", "NA", "null"], strings_can_be_null=True)
    return pa.csv.read_csv(path, convert_options=convert)


def _from_table(table: pa.Table, names: list[str], path: Path) -> Recording:
    if not names or names[0] != "time":
        first = names[0] if names else "no column"
        raise RecordingError(f"{path}: the first column must be `time` [s], got {first!r}")
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise RecordingError(f"{path}: column {sorted(repeated)[0]} stands twice; keep one")
    arrays: dict[str, np.ndarray] = {}
    for name in names:
        column = table.column(name)
        if pa.types.is_null(column.type):
            arrays[name] = np.full(len(column), np.nan)
            continue
        if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            raise RecordingError(f"{path}: column {name} holds {column.type}, expected numbers")
        arrays[name] = column.cast(pa.float64()).to_numpy(zero_copy_only=False).astype(float)
    columns: dict[tuple[str, str], np.ndarray] = {}
    for name in names[1:]:
        channel, dot, joint = name.partition(".")
        if not dot or not joint:
            raise RecordingError(f"{path}: column {name!r} is not <channel>.<joint>, e.g. q.elbow")
        columns[channel, joint] = arrays[name]
    return make(arrays["time"], columns, str(path))


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write as CSV or Parquet by the suffix; the file appears whole or not at all."""
    out = Path(path)
    data = {"time": recording.time}
    data.update({f"{channel}.{joint}": values for (channel, joint), values in recording.columns.items()})
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in data.items()})
    sink = io.BytesIO()
    if out.suffix == ".parquet":
        pa.parquet.write_table(table, sink, compression="zstd")
    elif out.suffix == ".csv":
        pa.csv.write_csv(table, sink)
    else:
        raise RecordingError(f"{out}: expected a .csv or .parquet name, got {out.suffix or 'no suffix'}")
    write_bytes(out, sink.getvalue())
