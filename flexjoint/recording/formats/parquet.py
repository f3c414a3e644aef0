"""Parquet tables of any columns."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet

from flexjoint.core.errors import FlexJointError
from flexjoint.recording.formats.text import columns_of, log_of
from flexjoint.recording.logs.log import Log, unreadable
from flexjoint.recording.table import check_size

KIND = "Parquet table"
SUFFIXES = (".parquet", ".pq")


def read(path: Path) -> Log:
    """A log of the columns that hold numbers; RecordingError says what is wrong with the file."""
    try:
        with pa.parquet.ParquetFile(path) as file:
            check_size(file.metadata.num_rows, file.metadata.num_columns, path)
            columns = columns_of(file.schema_arrow.names, lambda name: _column(file, name))
    except FlexJointError:
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(str(path), KIND, error) from None
    return log_of(path, KIND, columns)


def _column(file: pa.parquet.ParquetFile, name: str) -> pa.ChunkedArray:
    """The column of that name, the last of several; those whose names go on with a dot are read with it."""
    table = file.read([name])
    return table.column(max(k for k, other in enumerate(table.column_names) if other == name))
