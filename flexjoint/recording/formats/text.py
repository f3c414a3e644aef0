"""Delimited text: CSV, TSV, and columns between blanks, with a line of names or without."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from flexjoint.core.errors import FlexJointError
from flexjoint.recording.formats import libfranka, ur_rtde
from flexjoint.recording.logs.log import TIMES, Documented, Log, Signal, named, unreadable
from flexjoint.recording.messages import refusal
from flexjoint.recording.table import LONGEST_HEADER, MOST_BYTES, UNITS, check_size

KIND = "delimited text"
SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log")
COMMENTS = ("#", "%")
DELIMITERS = (";", "\t", ",", " ")
MOST_COMMENTS = 1000  # lines before the names
INDEXED = re.compile(r"(?P<stem>.*?[A-Za-z\])])[_.\- ]?[\[(]?(?P<index>\d{1,3})[\])]?$")
NULLS = ["", "NaN", "nan", "NA", "null", "None", "-nan"]
PART = 32_000_000  # bytes of a text that are read at once: a large one is never in memory as text
LOOSER = (  # kinds that parts of one column may have, and last the one that holds all of them
    (pa.int64(), pa.float64()),
    (pa.date32(), pa.timestamp("s"), pa.timestamp("ns")),
)


def read(path: Path) -> Log:
    """A log of a text file; RecordingError says what is wrong with it."""
    if path.stat().st_size > MOST_BYTES:
        raise refusal(path, f"more than {MOST_BYTES:g} bytes; cut the log, or write it as Parquet")
    try:
        names, skip, delimiter, comma = _layout(path)
        table = _numbers(path, names, skip, delimiter, comma)
    except FlexJointError:
        raise
    except (pa.ArrowException, OSError, ValueError, csv.Error) as error:
        raise unreadable(str(path), KIND, error) from None
    return log_of(path, KIND, table)


def log_of(path: Path, kind: str, table: dict[str, np.ndarray | None]) -> Log:
    """The log of a table's columns, None for those that hold words; known programs' tables by their names.

    The table is emptied, so that no more than one signal is in memory twice."""
    words = [name for name, column in table.items() if column is None]
    columns = {name: column for name in list(table) if (column := table.pop(name)) is not None}
    if not columns:
        raise refusal(path, "holds no column of numbers, as expected of a log")
    notes = (f"not numbers, and not used: {named(words)}",) if words else ()
    for known in (ur_rtde, libfranka):
        if known.is_one(columns):
            return known.of_columns(str(path), grouped(columns), notes)
    signals = grouped(columns)
    own = {
        name: Documented(
            name, UNITS[name] if name not in ("current", "temperature") else None, "flexjoint's own table"
        )
        for name, signal in signals.items()
        if signal.joints
    }
    clock = next(
        (name for name in signals if name.lower() in TIMES and signals[name].values.shape[1] == 1), None
    )
    if own and clock == "time":
        sides = {name: Documented(d.channel, d.unit, d.why, "link") for name, d in own.items()}
        return Log(str(path), "flexjoint's own table", signals, sides, time=clock, notes=notes)
    return Log(str(path), kind, signals, time=clock, notes=notes)


def grouped(columns: dict[str, np.ndarray]) -> dict[str, Signal]:
    """Columns as signals.

    `q_0, q_1, ...` and `q[0], q[1], ...` make the signal `q`, `<channel>.<joint>` with a channel of a
    recording the signal `<channel>`; any other column is a signal by itself. The dictionary is emptied.
    """
    stems: dict[str, list[tuple[int, str]]] = {}
    channels: dict[str, list[str]] = {}
    for name in columns:
        channel, dot, joint = name.partition(".")
        if dot and joint and channel in UNITS:
            channels.setdefault(channel, []).append(name)
        elif match := INDEXED.match(name):
            stems.setdefault(match["stem"].rstrip("_.- [("), []).append((int(match["index"]), name))
    signals: dict[str, Signal] = {}
    taken: dict[str, str] = {}  # column: its signal
    for stem, members in stems.items():
        order = sorted(members)
        first = order[0][0]
        whole = [index for index, _ in order] == list(range(first, first + len(order))) and first in (0, 1)
        if len(order) > 1 and whole and stem not in columns and stem not in channels:
            taken.update({name: stem for _, name in order})
    for channel, own_names in channels.items():
        if channel not in columns:
            taken.update(dict.fromkeys(own_names, channel))
    for name in list(columns):
        signal = taken.get(name)
        if signal is None:
            signals[name] = Signal(columns.pop(name)[:, np.newaxis], (name,))
        elif signal not in signals:
            own = channels.get(signal) or [n for _, n in sorted(stems[signal])]
            joints = tuple(n.partition(".")[2] for n in own) if signal in channels else ()
            signals[signal] = Signal(np.stack([columns.pop(n) for n in own], axis=1), tuple(own), joints)
    return signals


def header(path: Path) -> list[str]:
    """The names of the columns of a text file, as far as its first lines show them; empty where they do"
    " not."""
    try:
        return _layout(path)[0]
    except (OSError, ValueError, csv.Error):
        return []


def _layout(path: Path) -> tuple[list[str], int, str, bool]:
    """Names of the columns, lines before the numbers, the delimiter, and whether decimals have a comma."""
    lines: list[str] = []
    with path.open(encoding="utf-8-sig", newline="") as file:
        for _ in range(MOST_COMMENTS):
            line = file.readline(LONGEST_HEADER)
            if len(line) == LONGEST_HEADER:
                raise refusal(
                    path, f"a line of more than {LONGEST_HEADER} characters; expected columns of numbers"
                )
            if not line:
                break
            lines.append(line)
            if len(lines) > 1 and not _empty(line) and not _empty(lines[-2]):
                break
    rows = [k for k, line in enumerate(lines) if not _empty(line)]
    if len(rows) < 2:
        raise refusal(path, "expected a line of names and lines of numbers, got fewer than two lines")
    first, second = lines[rows[0]], lines[rows[1]]
    delimiter = next((d for d in DELIMITERS if d in second.strip()), ",")
    fields, numbers = _split(first, delimiter), _split(second, delimiter)
    comma = delimiter in (";", "\t") and "," in second and "." not in second
    commented = [
        k
        for k in range(rows[0])
        if lines[k].strip() and len(_split(_bare(lines[k]), delimiter)) == len(numbers)
    ]
    if all(_is_number(field, comma) for field in fields):
        names = _split(_bare(lines[commented[-1]]), delimiter) if commented else []
        names = names or [f"column_{k + 1}" for k in range(len(fields))]
        return _unique(names), rows[0], delimiter, comma
    return _unique(fields), rows[0] + 1, delimiter, comma


def _bare(line: str) -> str:
    return line.strip().lstrip("".join(COMMENTS)).strip()


def _empty(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(COMMENTS)


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    (fields,) = csv.reader([line.strip("\r\n")], delimiter=delimiter, skipinitialspace=True)
    return [field.strip() for field in fields]


def _is_number(field: str, comma: bool) -> bool:
    try:
        float(field.replace(",", ".") if comma else field or "nan")
    except ValueError:
        return False
    return True


def _unique(names: Sequence[str]) -> list[str]:
    """Names of which none stands twice: the second `q` becomes `q#2`."""
    out: list[str] = []
    for name in names:
        own, count = name, 1
        while own in out:
            count += 1
            own = f"{name}#{count}"
        out.append(own)
    return out


def _numbers(
    path: Path, names: list[str], skip: int, delimiter: str, comma: bool
) -> dict[str, np.ndarray | None]:
    """(N,) floats or whole numbers by name, None of columns that hold words."""
    check_size(0, len(names), path)
    chunks: dict[str, list[pa.Array]] = {name: [] for name in names}
    for part in _parts(path):
        content = part
        if delimiter == " ":  # several blanks count as one, which the reader of CSV does not know
            content, skip = _with_single_blanks(part, skip), 0
        if content and not content.isspace():
            table = pa.csv.read_csv(
                pa.BufferReader(content),
                read_options=pa.csv.ReadOptions(column_names=names, skip_rows=skip),
                parse_options=pa.csv.ParseOptions(delimiter=delimiter),
                convert_options=pa.csv.ConvertOptions(
                    null_values=NULLS, strings_can_be_null=True, decimal_point="," if comma else "."
                ),
            )
            for name in names:
                chunks[name] += [_without_words(chunk) for chunk in table.column(name).chunks]
        skip = 0
    return columns_of(names, lambda name: _one_kind(chunks.pop(name)))


def _parts(path: Path) -> Iterator[bytes]:
    """The text of a file, in parts that end with a line."""
    with path.open("rb") as file:
        while content := file.read(PART):
            yield content + file.readline()


def _with_single_blanks(content: bytes, skip: int) -> bytes:
    """Lines without the first ones, empty ones and comments, one blank between two fields."""
    lines = content.decode("utf-8-sig").splitlines()[skip:]
    return "\n".join(" ".join(line.split()) for line in lines if not _empty(line)).encode()


def _without_words(chunk: pa.Array) -> pa.Array:
    """The chunk; of words one that holds as many empty ones, since no word is used."""
    kind = chunk.type
    return (
        pa.nulls(len(chunk), pa.string()) if pa.types.is_string(kind) or pa.types.is_binary(kind) else chunk
    )


def _one_kind(chunks: list[pa.Array]) -> pa.ChunkedArray:
    """Chunks of one column as one, of the kind that the whole column has."""
    kinds = {chunk.type for chunk in chunks if not pa.types.is_null(chunk.type)} or {pa.null()}
    if len(kinds) == 1:
        kind = kinds.pop()
    else:
        kind = next((of[-1] for of in LOOSER if kinds <= set(of)), pa.string())
    if pa.types.is_string(kind):
        return pa.chunked_array([pa.nulls(len(chunk), kind) for chunk in chunks], kind)
    return pa.chunked_array([chunk.cast(kind, safe=False) for chunk in chunks], kind)


def columns_of(
    names: Sequence[str], column: Callable[[str], pa.ChunkedArray]
) -> dict[str, np.ndarray | None]:
    """Numbers by name (`numbers_of`) of columns that are asked for one after the other, so that no more than
    one is in memory twice."""
    out = {}
    for name in names:
        out[name] = numbers_of(column(name))
        pa.default_memory_pool().release_unused()
    return out


def numbers_of(column: pa.ChunkedArray) -> np.ndarray | None:
    """(N,) floats, or whole numbers where none is missing; dates as nanoseconds; None of words."""
    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        whole = pa.timestamp("ns", kind.tz) if pa.types.is_timestamp(kind) else pa.duration("ns")
        column, kind = column.cast(whole).cast(pa.int64()), pa.int64()
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_integer(kind) and column.null_count == 0:
        return np.array(column.to_numpy())
    if pa.types.is_floating(kind) or pa.types.is_integer(kind):
        return np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    return None
