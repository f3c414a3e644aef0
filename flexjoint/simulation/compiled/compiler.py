"""C compilers: the system's, else the one that PyPI's ziglang brings."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from flexjoint.core.errors import FlexJointError
from flexjoint.core.limits import COMPILING
from flexjoint.core.messages import shown

# No contraction to fused multiply-adds: results are those of the operations as written, on any machine. GCC's
# register allocator would colour a graph of conflicts, which takes a third of all time for so long a straight
# line, whose code comes out longer; Clang ignores this.
FLAGS = (
    "-std=c99",
    "--param=ira-max-conflict-table-size=0",
    "-ffp-contract=off",
    "-march=native",
    "-fno-sanitize=undefined",
    "-fvisibility=hidden",
    "-fPIC",
    "-shared",
)

STEPS = ("-O2",)  # of the largest model an eighth quicker than -O1, and compiled in no more time
# For functions that are called some ten thousand times. GCC clears the upper halves of AVX registers only
# with -fexpensive-optimizations, which -O2 has; else sin and cos of the C library run at half speed.
FUNCTIONS = ("-O1", "-fexpensive-optimizations")

log = logging.getLogger("flexjoint")


class CompilerError(FlexJointError):
    """No C compiler, or one that fails."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler as a command line, and what its output depends on (version, processor)."""

    name: str
    command: tuple[str, ...]
    identity: str

    def compile(self, source: Path, library: Path, level: Sequence[str] = STEPS) -> None:
        """Compile a C file to a shared library, at an optimisation level; raises CompilerError with what the
        compiler said."""
        command = [*self.command, *FLAGS, *level, source.name, "-o", str(library), "-lm"]
        try:
            with subprocess.Popen(
                command,
                cwd=source.parent,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                start_new_session=True,  # so that it ends with all that it has started
            ) as process:
                try:
                    said = self._waited(process)
                except BaseException:
                    with contextlib.suppress(ProcessLookupError):
                        os.killpg(process.pid, signal.SIGKILL)
                    raise
        except OSError as error:
            raise CompilerError(f"{self.name} cannot be run: {error}") from None
        if process.returncode:
            last = (said.strip().splitlines() or ["no message"])[-1]
            raise CompilerError(f"{self.name} failed with {process.returncode}: {shown(last, 200)}")

    def _waited(self, process: subprocess.Popen[str]) -> str:
        """What the compiler said on standard error; after a while a line says what is waited for."""
        try:
            return process.communicate(timeout=COMPILING.note)[1]
        except subprocess.TimeoutExpired:
            log.warning("%s compiles a model; waiting for at most %g s", self.name, COMPILING.longest)
        try:
            return process.communicate(timeout=COMPILING.longest - COMPILING.note)[1]
        except subprocess.TimeoutExpired:
            raise CompilerError(
                f"{self.name} did not compile a model in {COMPILING.longest:g} s; try another one (CC=gcc),"
                " or --engine pin"
            ) from None


def candidates() -> list[tuple[str, tuple[str, ...]]]:
    """Names and command lines that may be compilers, the preferred one first."""
    found = []
    system = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(system[0]):
        found.append((system[0], tuple(system)))
    if importlib.util.find_spec("ziglang") is not None:
        found.append(("ziglang", (sys.executable, "-m", "ziglang", "cc")))
    return found


@cache
def compilers() -> tuple[Compiler, ...]:
    """Those of `candidates` that run here. Windows has none: the checks on the cache are POSIX's."""
    if os.name != "posix":
        return ()
    working = []
    for name, command in candidates():
        identity = _identity(command)
        if identity is not None:
            working.append(Compiler(name, command, identity))
    return tuple(working)


def _identity(command: tuple[str, ...]) -> str | None:
    """Version and predefined macros: these tell the processor that -march=native means."""
    try:
        version = _said([*command, "--version"])
        macros = _said([*command, "-march=native", "-dM", "-E", "-x", "c", os.devnull])
    except (OSError, subprocess.SubprocessError):
        return None
    return "\n".join([platform.machine(), *platform.libc_ver(), version, macros])


def _said(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=COMPILING.asked, check=True)
    return done.stdout
