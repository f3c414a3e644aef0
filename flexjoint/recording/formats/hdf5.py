"""HDF5 files: data sets by their path. Data sets that point into other files are left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.recording.logs.log import Log, names_in, of_arrays, unreadable
from flexjoint.recording.messages import refusal
from flexjoint.recording.table import MOST_CELLS

KIND = "HDF5 file"
SUFFIXES = (".h5", ".hdf5", ".hdf")


def read(path: Path) -> Log:
    """A log of the data sets; RecordingError says what is wrong with the file, MissingExtraError that h5py is
    not installed."""
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "hdf5") from None
    arrays: dict[str, np.ndarray] = {}
    cells = 0

    def visit(name: str, item: Any) -> None:
        nonlocal cells
        if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual or item.ndim not in (1, 2):
            return
        cells += item.size
        if cells > MOST_CELLS:
            raise refusal(path, f"more than {MOST_CELLS:g} numbers; cut the log")
        if item.dtype.kind in "iuf":
            arrays[name] = np.asarray(item[()])
        elif h5py.check_string_dtype(item.dtype) is not None:
            arrays[name] = np.asarray(item.asstr(errors="replace")[()], dtype=str)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except FlexJointError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise unreadable(str(path), KIND, error) from None
    return of_arrays(str(path), KIND, arrays, names_in(arrays))
