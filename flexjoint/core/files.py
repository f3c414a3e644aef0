"""Files read within a size, and written whole or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from flexjoint.core.errors import FlexJointError

PREFIX = 40  # characters of a name that its temporary file takes over: names have an end
_unfinished: set[str] = set()  # temporary files that are being written


def remove_unfinished() -> None:
    """Remove what is half written, before the process ends without unwinding."""
    for temporary in list(_unfinished):
        with contextlib.suppress(OSError):
            os.unlink(temporary)


def read_text(path: Path, most: int) -> str:
    """The text of a file of at most `most` bytes.

    Raises as Path.read_text, and FlexJointError for a larger file, or a pipe or device, which has no end."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FlexJointError(f"{path} is no file but a pipe or device; give a file")
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise FlexJointError(
            f"{path} has more than {most} bytes, the most that is read (docs/reference/limits.md)"
        )
    return content.decode("utf-8-sig")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all (a temporary file beside it, then a rename)."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """JSON that any reader takes, whole or not at all: numbers that are not finite become null."""
    write_text(path, json.dumps(_finite(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def check_suffix(path: Path, suffixes: Sequence[str]) -> None:
    """Raise FlexJointError unless the name ends as such a file's does."""
    if path.suffix not in suffixes:
        raise FlexJointError(
            f"cannot write {path}: expected a name that ends in {' or '.join(suffixes)}, got"
            f" {path.suffix or 'no suffix'}"
        )


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; raises FlexJointError when the place cannot be written."""
    with whole_file(path) as file:
        file.write(content)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to write piece by piece, which appears under its name when all is written, or not at all.

    Raises FlexJointError when the place cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:PREFIX]}.")
    except OSError as error:
        raise FlexJointError(f"cannot write {path}: {error.strerror or error}") from None
    _unfinished.add(temporary)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise FlexJointError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        _unfinished.discard(temporary)
