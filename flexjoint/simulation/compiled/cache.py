"""Compiled libraries by their source and content, one folder per user.

A library is code that will run with the user's rights. So the folder must belong to the user and be closed
to others (0700), no folder above it may let another user swap it, and a file in it must belong to the user
and be writable by nobody else. Where that does not hold, libraries go to a private temporary folder that
lives as long as the process.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from flexjoint.core.limits import COMPILING
from flexjoint.simulation.compiled.compiler import FLAGS, STEPS, Compiler, CompilerError, compilers

BUILD = "build."  # how the name of a build's folder begins
KEPT = COMPILING.libraries
SPACE = 16_000_000  # bytes: what a compilation of the largest model needs

log = logging.getLogger("flexjoint")


def load(source: str, compiler: Compiler | None = None) -> tuple[Compiler, ctypes.CDLL]:
    """The library of a C source, loaded, and the compiler that made it: the given one, else the first that
    succeeds. Raises CompilerError."""
    failure = CompilerError("no C compiler: install one, or pip install 'flexjoint[jit]'")
    for candidate in [compiler] if compiler is not None else compilers():
        try:
            path = library(source, candidate)
            return candidate, ctypes.CDLL(str(path))
        except CompilerError as error:
            failure = error
        except OSError as error:
            failure = CompilerError(f"{candidate.name} made a library that cannot be loaded: {error}")
    raise failure


def library(source: str, compiler: Compiler, level: Sequence[str] = STEPS) -> Path:
    """The compiled library of a C source, built at an optimisation level unless it is there, and whole.

    Safe while other processes build the same: each builds in a folder of its own and renames the result
    into place. Where the cache cannot be written it goes to a folder that lives as long as the process, with
    a warning. Raises CompilerError.
    """
    key = hashlib.sha256("\0".join([source, compiler.identity, *FLAGS, *level]).encode()).hexdigest()
    for find_place in (cache_folder, _temporary_folder):
        place = find_place()
        for path in place.glob(f"{key}.*.so"):
            whole = _whole(path)
            with contextlib.suppress(OSError):  # the cache may be one that can only be read
                os.utime(path) if whole else path.unlink()
            if whole:
                return path
        why = _unwritable(place)
        if not why:
            try:
                path = _built(source, compiler, level, place / key)
            except OSError as error:
                why = error.strerror or str(error)
            else:
                _tidy(place)
                return path
        if find_place is cache_folder:
            _say_once(f"compiled models are not kept: {place} cannot be written ({why})")
    raise CompilerError(f"no place for a compiled model: {place} cannot be written ({why})")


def _built(source: str, compiler: Compiler, level: Sequence[str], path: Path) -> Path:
    """The library, whose name is `path`, the hash of its content, and .so."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=BUILD) as build:  # 0700 by its making
        text, built = Path(build) / "program.c", Path(build) / "program.so"
        text.write_text(source, encoding="utf-8")
        compiler.compile(text, built, level)
        os.chmod(built, 0o700)
        named = path.with_name(f"{path.name}.{_hash(built)}.so")
        os.replace(built, named)
    return named


def _whole(path: Path) -> bool:
    """Whether a library is there, is the user's own, and has the content that was built. A library that lost
    its end would end the process where it is loaded."""
    if not trusted_file(path):
        return False
    try:
        return path.suffixes[-2:] == [f".{_hash(path)}", ".so"]
    except OSError:
        return False


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _unwritable(folder: Path) -> str:
    """Why nothing can be built in a folder; empty where it can."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return "it is read-only"
    free = shutil.disk_usage(folder).free
    return "" if free > SPACE else f"{free:g} bytes are free"


def _tidy(folder: Path) -> None:
    """Keep the cache from growing for ever: libraries used longest ago go, and builds that were killed."""
    ages = []
    for path in folder.glob("*.so"):
        with contextlib.suppress(OSError):  # another process took it away
            ages.append((path.stat().st_mtime, path))
    for _, path in sorted(ages, reverse=True)[KEPT:]:
        path.unlink(missing_ok=True)
    for path in folder.glob(f"{BUILD}*"):
        with contextlib.suppress(OSError):
            if time.time() - path.stat().st_mtime > COMPILING.stale_build:
                shutil.rmtree(path, ignore_errors=True)


@cache
def _say_once(message: str) -> None:
    log.warning(message)


@cache
def cache_folder() -> Path:
    """FLEXJOINT_CACHE, else flexjoint/ in XDG_CACHE_HOME (~/.cache), made if need be; a temporary one
    where that is not safe."""
    chosen = os.environ.get("FLEXJOINT_CACHE")
    if chosen:
        folder = Path(chosen)
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "flexjoint"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = folder.resolve()
        unsafe_by = unsafe(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        why = f"cannot be made ({getattr(error, 'strerror', None) or error})"
    else:
        if not unsafe_by:
            return folder
        why = f"is not safe ({unsafe_by})"
    log.warning("compiled models are not kept: %s %s; name another folder in FLEXJOINT_CACHE", folder, why)
    return _temporary_folder()


def unsafe(folder: Path) -> str:
    """Why another user could put a file into this (resolved) folder; empty when none could."""
    own = folder.lstat()
    if not stat.S_ISDIR(own.st_mode):
        return "it is no folder"
    if own.st_uid != os.getuid():
        return "it belongs to another user"
    if stat.S_IMODE(own.st_mode) & 0o077:
        return "others have access; chmod 700 it, after a look at what is in it"
    for parent in folder.parents:
        found = parent.stat()
        if found.st_uid not in (0, os.getuid()):
            return f"{parent} belongs to another user"
        if found.st_mode & 0o022 and not found.st_mode & stat.S_ISVTX:
            return f"others may write in {parent}"
    return ""


def trusted_file(path: Path) -> bool:
    """Whether the file is there, no link, the user's own, and writable by nobody else."""
    try:
        found = path.lstat()
    except OSError:
        return False
    private = not stat.S_IMODE(found.st_mode) & 0o022
    return stat.S_ISREG(found.st_mode) and found.st_uid == os.getuid() and private


def _temporary_folder() -> Path:
    return Path(_temporary().name)


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="flexjoint.")
