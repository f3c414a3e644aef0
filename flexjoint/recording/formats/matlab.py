"""MATLAB files (.mat): variables by name, fields of structs as `struct.field`.

Files of version 7.3 are HDF5 and are read as such.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.recording.formats import hdf5
from flexjoint.recording.logs.log import Log, names_in, of_arrays, unreadable
from flexjoint.recording.messages import refusal
from flexjoint.recording.table import MOST_BYTES

KIND = "MATLAB file"
SUFFIXES = (".mat",)
DEEPEST = 5  # structs in structs


def read(path: Path) -> Log:
    """A log of the arrays; RecordingError says what is wrong with the file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if path.stat().st_size > MOST_BYTES:
        raise refusal(path, f"more than {MOST_BYTES:g} bytes; cut the log")
    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3
        return hdf5.read(path)
    except (
        MatReadError, OSError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError,
        MemoryError,
        AttributeError, UnboundLocalError, UnicodeDecodeError, zlib.error, struct.error,
    ) as error:  # fmt: skip
        raise unreadable(str(path), KIND, error) from None
    arrays = dict(_arrays(content, "", 0))
    return of_arrays(str(path), KIND, arrays, names_in(arrays))


def _arrays(content: Mapping[str, Any], before: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            if depth < DEEPEST:
                yield from _arrays(value, f"{before}{name}.", depth + 1)
        elif isinstance(value, np.ndarray | list):
            array = np.asarray(value) if isinstance(value, np.ndarray) else _of_list(value)
            yield f"{before}{name}", array


def _of_list(value: list[Any]) -> np.ndarray:
    """An array of a cell, of words where all are."""
    words = all(isinstance(item, str) for item in value)
    return np.array(value, dtype=str if words else object) if words else np.empty(0)
