"""Compiled libraries by their content, one folder per user.

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
import stat
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from flexjoint.simulation.compiled.compiler import FLAGS, Compiler, CompilerError, compilers

KEPT = 500  # libraries: some tens of kilobytes each, up to a megabyte for a humanoid

log = logging.getLogger("flexjoint")


def load(source: str, compiler: Compiler | None = None) -> tuple[Compiler, ctypes.CDLL]:
    """The library of a C source, loaded, and the compiler that made it: the given one, else the first that
    succeeds. Raises CompilerError."""
    failure = CompilerError("no C compiler: install one, or pip install 'flexjoint[jit]'")
    for candidate in [compiler] if compiler is not None else compilers():
        try:
            return candidate, ctypes.CDLL(str(library(source, candidate)))
        except CompilerError as error:
            failure = error
    raise failure


def library(source: str, compiler: Compiler, further: Sequence[str] = ()) -> Path:
    """The compiled library of a C source, built with further flags unless it is there.

    Safe while other processes build the same: each builds in a folder of its own and renames the result
    into place. Raises CompilerError.
    """
    folder = cache_folder()
    key = hashlib.sha256("\0".join([source, compiler.identity, *FLAGS, *further]).encode()).hexdigest()
    path = folder / f"{key}.so"
    if trusted_file(path):
        os.utime(path)
        return path
    with tempfile.TemporaryDirectory(dir=folder, prefix="build.") as build:  # 0700 by its making
        text, built = Path(build) / "program.c", Path(build) / "program.so"
        text.write_text(source, encoding="utf-8")
        compiler.compile(text, built, further)
        os.chmod(built, 0o700)
        os.replace(built, path)
    _forget_the_oldest(folder)
    return path


def _forget_the_oldest(folder: Path) -> None:
    """Keep the cache from growing for ever: the libraries used longest ago go."""
    ages = []
    for path in folder.glob("*.so"):
        with contextlib.suppress(OSError):  # another process took it away
            ages.append((path.stat().st_mtime, path))
    for _, path in sorted(ages, reverse=True)[KEPT:]:
        path.unlink(missing_ok=True)


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
        why = unsafe(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        why = str(error)
    if not why:
        return folder
    log.warning("compiled models are not kept: %s is not safe (%s)", folder, why)
    return Path(_temporary().name)


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


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="flexjoint.")
