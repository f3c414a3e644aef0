"""Files read within a size, and written whole or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

from flexjoint.core.errors import FlexJointError

PREFIX = 40  # characters of a name that its temporary file takes over: names have an end
_unfinished: set[str] = set()  # temporary files and folders that are being written
_held: ContextVar[list[tuple[str, Path]] | None] = ContextVar("held", default=None)  # whole, yet unnamed


def remove_unfinished() -> None:
    """Remove what is half written, before the process ends without unwinding."""
    for temporary in list(_unfinished):
        with contextlib.suppress(OSError):
            _remove(temporary)


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


def check_folder(path: Path, folder: Path) -> None:
    """Raise FlexJointError unless `path` could be written in a folder, which is made where it is missing."""
    folder = folder.absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:  # what the rights say does not hold on every disk, nor for every user
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError:
        raise FlexJointError(
            f"cannot write {path}: no file can be made in {folder}; choose another place"
        ) from None


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; raises FlexJointError when the place cannot be written."""
    with whole_file(path) as file:
        file.write(content)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to write piece by piece, which appears under its name when all is written, or not at all.

    Raises FlexJointError when the place cannot be written."""
    held = _held.get()
    with _as_refusal(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:PREFIX]}.")
    _unfinished.add(temporary)
    try:
        with _as_refusal(path):
            with os.fdopen(handle, "wb") as file:
                yield file
            os.chmod(temporary, 0o644)
            if held is None:
                os.replace(temporary, path)
            else:
                held.append((temporary, path))
    finally:
        if held is None or (temporary, path) not in held:
            _remove(temporary)


@contextlib.contextmanager
def all_or_none() -> Iterator[None]:
    """Files written within appear together when the last one is whole; where one fails, none does, and what
    was there before stays. Within another one they appear with that one's.

    Raises FlexJointError when one of the places cannot be written."""
    if _held.get() is not None:
        yield
        return
    held: list[tuple[str, Path]] = []
    before = _held.set(held)
    try:
        yield
        _named(held)
    finally:
        _held.reset(before)
        for temporary, _ in held:
            _remove(temporary)


def _named(held: Sequence[tuple[str, Path]]) -> None:
    """Give whole files their names. Where one cannot have it (a folder took its place meanwhile) those before
    give theirs back to what was there."""
    done: list[tuple[Path, str | None]] = []  # and what was there, under another name
    before: list[str] = []
    try:
        for temporary, path in held:
            with _as_refusal(path):
                kept = _kept(path) if len(held) > 1 else None
                before += [] if kept is None else [kept]
                os.replace(temporary, path)
                done.append((path, kept))
    except BaseException:
        for path, kept in reversed(done):
            with contextlib.suppress(OSError):
                path.unlink() if kept is None else os.replace(kept, path)
        raise
    finally:
        for kept in before:
            _remove(kept)


def _kept(path: Path) -> str | None:
    """A second name of a file, beside it, or a copy where a disk knows no second names; None: there is no
    such file."""
    if not path.is_file():
        return None
    handle, kept = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:PREFIX]}.")
    os.close(handle)
    _unfinished.add(kept)
    try:
        os.unlink(kept)
        os.link(path, kept, follow_symlinks=False)
    except OSError:
        shutil.copy2(path, kept)
    return kept


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A new folder to write into, which appears under its name when all is written, or not at all.

    Raises FlexJointError when the place cannot be written, or holds something."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise FlexJointError(f"{path} is not empty; give the name of a new folder")
    if path.is_mount():
        raise FlexJointError(f"cannot write {path}: it is a disk of its own; give a new folder in it")
    check_folder(path, path.parent)
    with _as_refusal(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name[:PREFIX]}.")
    _unfinished.add(temporary)
    try:
        with _as_refusal(path):
            yield Path(temporary)
            os.chmod(temporary, 0o755)
            if path.exists():  # and empty
                path.rmdir()
            os.replace(temporary, path)
    finally:
        _remove(temporary)


@contextlib.contextmanager
def _as_refusal(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise FlexJointError(f"cannot write {path}: {error.strerror or error}") from None


def _remove(temporary: str) -> None:
    if os.path.isdir(temporary):
        shutil.rmtree(temporary, ignore_errors=True)
    else:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
    _unfinished.discard(temporary)
