"""Recording: one table of measured signals over time, read, checked and written.

docs/reference/formats.md has its columns.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from flexjoint.core.errors import RecordingError, unknown
from flexjoint.core.files import whole_file
from flexjoint.core.limits import RECORDING
from flexjoint.core.messages import cut, shown
from flexjoint.recording.messages import refusal
from flexjoint.recording.stamps import repaired

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
LONGEST_LIST = 400  # characters of the joints that a recording prints
MINIMUM_SAMPLES = RECORDING.rows
LEAST_PRESENT = 0.05  # of a column's rows
LARGEST = RECORDING.value  # in the unit of any channel
MOST_COLUMNS = RECORDING.columns
MOST_CELLS = RECORDING.cells
MOST_BYTES = RECORDING.csv_bytes
LONGEST_HEADER = RECORDING.header_bytes
ROWS_AT_ONCE = 1_048_576  # that are written: pyarrow's own size of a row group of Parquet


@dataclass(frozen=True)
class Recording:
    """Signals over time. `time` (N,) [s] strictly increasing; `columns` maps (channel, joint) to (N,),
    SI and link-referred, NaN where a sample is missing. A pair that is absent was not measured. `notes` say
    what was repaired."""

    time: np.ndarray
    columns: Mapping[tuple[str, str], np.ndarray]
    name: str = "recording"
    notes: tuple[str, ...] = ()

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

    def __str__(self) -> str:
        channels = dict.fromkeys(channel for channel, _ in self.columns)
        rate = 1.0 / self.period if self.time.size > 1 else 0.0
        return (
            f"{shown(self.name)}: {self.duration:.4g} s at {rate:.4g} Hz, {self.time.size} samples\n"
            f"joints: {cut(', '.join(map(shown, self.joints)), LONGEST_LIST)}\n"
            f"channels: {cut(', '.join(map(shown, channels)), LONGEST_LIST)}"
        )

    def has(self, channel: str, joint: str) -> bool:
        return (channel, joint) in self.columns

    def get(self, channel: str, joint: str) -> np.ndarray:
        """(N,) the samples, NaN where missing; UnknownNameError when it was not measured."""
        if (channel, joint) not in self.columns:
            raise unknown("channel", f"{channel}.{joint}", [f"{c}.{j}" for c, j in self.columns])
        return self.columns[channel, joint]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write as CSV or Parquet by the suffix; the file appears whole or not at all."""
        write(self, path)

    def between(self, start: float, stop: float) -> Recording:
        """The part with start <= time < stop."""
        keep = (self.time >= start) & (self.time < stop)
        return Recording(
            self.time[keep],
            {k: v[keep] for k, v in self.columns.items()},
            f"{self.name}[{start:g}:{stop:g}]",
            self.notes,
        )


def make(
    time: np.ndarray, columns: Mapping[tuple[str, str], np.ndarray], name: str = "recording"
) -> Recording:
    """A checked recording.

    Args:
        time: (N,) [s], or whole numbers in a unit that their size shows; what is repaired of it is noted
            (docs/reference/formats.md).
        columns: (N,) by (channel, joint), NaN where a sample is missing.
        name: of the recording in messages.

    Raises RecordingError naming the column or row and what was expected.
    """
    stamps = time if isinstance(time, np.ma.MaskedArray) else np.asarray(time)
    if stamps.dtype.kind not in "iuf":
        stamps = np.asarray(stamps, dtype=float)
    if stamps.ndim != 1 or stamps.size < MINIMUM_SAMPLES:
        raise refusal(name, f"expected at least {MINIMUM_SAMPLES} samples, got {stamps.size}")
    if not columns:
        raise refusal(name, "no channel beside time; columns are <channel>.<joint>, e.g. q.elbow")
    check_size(stamps.size, len(columns) + 1, name)
    arrays = {key: _checked(key, values, stamps.size, name) for key, values in columns.items()}
    rows = repaired(stamps, arrays, name)
    if rows.time.size < MINIMUM_SAMPLES:
        raise refusal(name, f"expected at least {MINIMUM_SAMPLES} samples, got {rows.time.size} with a time")
    for (channel, joint), array in rows.columns.items():
        if not was_measured(array):
            count = np.count_nonzero(np.isfinite(array))
            raise refusal(
                name,
                f"column {shown(f'{channel}.{joint}')} holds {count} numbers in {array.size} rows; leave a"
                " channel out that was not measured",
            )
    return Recording(rows.time, MappingProxyType(dict(rows.columns)), name, rows.notes)


def _checked(key: tuple[str, str], values: np.ndarray, count: int, name: str) -> np.ndarray:
    """(N,) the numbers of a column."""
    channel, joint = key
    column = shown(f"{channel}.{joint}")
    if channel not in UNITS:
        raise refusal(name, f"column {column}: {unknown('channel', shown(channel), UNITS)}")
    array = np.asarray(values, dtype=float)
    if array.shape != (count,):
        raise refusal(name, f"{column} has {array.size} samples, time has {count}")
    if np.any(np.isinf(array)):
        raise refusal(name, f"{column} holds infinite values; leave such cells empty")
    largest = float(np.max(np.abs(array), initial=0.0, where=np.isfinite(array)))
    if largest > LARGEST:
        raise refusal(
            name,
            f"{column} reaches {largest:.3g} {UNITS[channel]}, beyond {LARGEST:g}: no sensor shows that;"
            " leave such cells empty",
        )
    return array


def check_size(rows: int, columns: int, name: object) -> None:
    """Raise RecordingError for a table that is larger than any recording is."""
    if columns > MOST_COLUMNS:
        raise refusal(
            name, f"{columns} columns, expected at most {MOST_COLUMNS}; leave out what is no channel"
        )
    if rows * columns > MOST_CELLS:
        raise refusal(
            name,
            f"{rows} rows of {columns} columns, expected at most {MOST_CELLS:g} cells; cut the recording, or"
            " leave channels out",
        )


def expect(given: object, verb: str) -> Recording:
    """The recording that was handed to a function; RecordingError says what to call where it is something
    else."""
    if isinstance(given, Recording):
        return given
    if isinstance(given, str | os.PathLike):
        kind = f"the text {str(given)!r}; read it with read_recording({str(given)!r})"
    else:
        kind = f"a {type(given).__name__}; read one with read_recording(path)"
    raise RecordingError(f"{verb}: expected a recording, got {kind}")


def expect_several(given: object, verb: str) -> tuple[Recording, ...]:
    """The recordings that were handed to a function, one or a sequence of them; see `expect`."""
    if isinstance(given, Sequence) and not isinstance(given, str):
        if not given:
            raise RecordingError(f"{verb}: no recording given; expected at least one")
        return tuple(expect(item, verb) for item in given)
    return (expect(given, verb),)


def was_measured(values: np.ndarray) -> bool:
    """Whether a column (N,) holds enough numbers to count as a channel."""
    return int(np.count_nonzero(np.isfinite(values))) >= max(2, LEAST_PRESENT * values.size)


def read(source: str | os.PathLike[str]) -> Recording:
    """A recording from CSV or Parquet; RecordingError says what is wrong with the file."""
    path = Path(source)
    try:
        there = path.is_file()
    except (OSError, ValueError):  # a name too long, or with a zero byte
        there = False
    if not there:
        raise refusal(f"recording {path}", "does not exist; give a .csv or .parquet file", " ")
    if path.stat().st_size == 0:
        raise refusal(f"recording {path}", "is empty; expected a table with a time column", " ")
    try:
        if path.suffix == ".parquet":
            with pa.parquet.ParquetFile(path) as file:
                check_size(file.metadata.num_rows, file.metadata.num_columns, path)
                names = list(file.schema_arrow.names)
                return _from_columns(names, lambda name: file.read([name]).column(name), path)
        if path.suffix != ".csv":
            raise refusal(path, f"expected a .csv or .parquet file, got {shown(path.suffix) or 'no suffix'}")
        table = read_csv(path)
        return _from_columns(table.column_names, table.column, path)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise refusal(path, f"cannot be read as {path.suffix[1:]}: {reason}", " ") from None


def read_parquet(path: Path) -> pa.Table:
    """A Parquet file whose size and columns are within the limits; raises RecordingError."""
    with pa.parquet.ParquetFile(path) as file:
        check_size(file.metadata.num_rows, file.metadata.num_columns, path)
        return file.read()


def read_csv(path: Path) -> pa.Table:
    """A CSV whose size and columns are within the limits; raises RecordingError."""
    if path.stat().st_size > MOST_BYTES:
        raise refusal(path, f"more than {MOST_BYTES:g} bytes; cut the recording, or write it as Parquet")
    with path.open("rb") as file:
        header = file.readline(LONGEST_HEADER)
    if len(header) == LONGEST_HEADER:
        raise refusal(path, f"its first line has more than {LONGEST_HEADER} bytes; expected names of columns")
    check_size(0, header.count(b",") + 1, path)
    convert = pa.csv.ConvertOptions(null_values=["", "NaN", "nan", "NA", "null"], strings_can_be_null=True)
    return pa.csv.read_csv(path, convert_options=convert)


def _from_columns(names: Sequence[str], column: Callable[[str], pa.ChunkedArray], path: Path) -> Recording:
    """The recording of columns, which are asked for by name, one after the other: of a large file no more is
    in memory than that of one."""
    if not names or names[0] != "time":
        first = repr(shown(names[0])) if names else "no column"
        raise refusal(path, f"the first column must be `time` [s], got {first}")
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise refusal(path, f"column {shown(repeated[0])} appears twice; keep one")
    columns: dict[tuple[str, str], np.ndarray] = {}
    for name in names[1:]:
        channel, dot, joint = name.partition(".")
        if not dot or not joint:
            raise refusal(path, f"column '{shown(name)}' is not <channel>.<joint>, e.g. q.elbow")
        columns[channel, joint] = _numbers(column(name), name, path)
    return make(_stamps(column("time"), path), columns, str(path))


def _numbers(column: pa.ChunkedArray, name: str, path: Path) -> np.ndarray:
    """(N,) floats, NaN where a cell is empty. Whole numbers above 2^53 are rounded."""
    if pa.types.is_null(column.type):
        return np.full(len(column), np.nan)
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise refusal(path, f"column {shown(name)} holds {shown(column.type)}, expected numbers")
    numbers = np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    del column
    pa.default_memory_pool().release_unused()
    return numbers


def _stamps(column: pa.ChunkedArray, path: Path) -> np.ndarray:
    """(N,) stamps: floats, or whole numbers as they are (masked where missing), since a float holds no
    nanoseconds of today."""
    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        column, kind = (
            column.cast(pa.timestamp("ns") if pa.types.is_timestamp(kind) else pa.duration("ns")),
            None,
        )
        column = column.cast(pa.int64())
    elif not pa.types.is_integer(kind):
        return _numbers(column, "time", path)
    missing = column.is_null().to_numpy(zero_copy_only=False)
    whole = column.fill_null(0).to_numpy(zero_copy_only=False)
    return np.ma.MaskedArray(whole, missing) if np.any(missing) else np.array(whole)


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write as CSV or Parquet by the suffix; the file appears whole or not at all."""
    write_pieces([recording], path)


def write_pieces(pieces: Iterable[Recording], path: str | os.PathLike[str]) -> None:
    """Write recordings with the same columns, one after the other, as one; the file appears whole or not at
    all. They are asked for one by one."""
    out = Path(path)
    if out.suffix not in WRITERS:
        raise refusal(out, f"expected a .csv or .parquet name, got {shown(out.suffix) or 'no suffix'}")
    with whole_file(out) as file, contextlib.ExitStack() as stack:
        writer = None
        for piece in pieces:
            for begin in range(0, piece.time.size, ROWS_AT_ONCE):
                table = _table(piece, slice(begin, begin + ROWS_AT_ONCE))
                if writer is None:
                    writer = stack.enter_context(WRITERS[out.suffix](file, table.schema))
                writer.write_table(table)


def _table(recording: Recording, rows: slice) -> pa.Table:
    """Some rows of a recording."""
    data = {"time": recording.time}
    data.update({f"{channel}.{joint}": values for (channel, joint), values in recording.columns.items()})
    return pa.table({name: pa.array(values[rows], from_pandas=True) for name, values in data.items()})


WRITERS: Mapping[str, Callable[[IO[bytes], pa.Schema], Any]] = MappingProxyType(
    {
        ".csv": pa.csv.CSVWriter,
        ".parquet": lambda file, schema: pa.parquet.ParquetWriter(file, schema, compression="zstd"),
    }
)
