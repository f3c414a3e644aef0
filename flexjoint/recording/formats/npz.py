"""NumPy archives (.npz): arrays by name. Pickled objects in them are refused."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.recording.logs.log import Log, names_in, of_arrays, unreadable
from flexjoint.recording.messages import refusal
from flexjoint.recording.table import MOST_BYTES

KIND = "NumPy archive"
SUFFIXES = (".npz",)


def read(path: Path) -> Log:
    """A log of the arrays; RecordingError says what is wrong with the file."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MOST_BYTES:
                raise refusal(path, f"more than {MOST_BYTES:g} bytes of arrays; cut the log")
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: np.asarray(content[name]) for name in content.files}
    except FlexJointError:
        raise
    except (
        OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, SyntaxError,
        NotImplementedError, TypeError, MemoryError, RuntimeError,
    ) as error:  # fmt: skip
        if "pickle" in str(error).lower():
            raise refusal(
                path, "holds pickled objects, which could run code; save plain arrays of numbers"
            ) from None
        raise unreadable(str(path), KIND, error) from None
    return of_arrays(str(path), KIND, arrays, names_in(arrays))
