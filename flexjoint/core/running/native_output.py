"""What C++ libraries write to standard error: held back, and of use in a message of one line."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence

STANDARD_ERROR = 2  # file descriptor of C and C++
READ = 4000  # bytes that are looked at


@contextlib.contextmanager
def held() -> Iterator[list[str]]:
    """Holds standard error back; on leaving, the list has the lines that came."""
    lines: list[str] = []
    sys.stderr.flush()
    try:
        shown = os.dup(STANDARD_ERROR)
    except OSError:  # it is closed
        yield lines
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), STANDARD_ERROR)
        try:
            yield lines
        finally:
            os.dup2(shown, STANDARD_ERROR)
            os.close(shown)
            file.seek(0)
            lines += file.read(READ).decode("utf-8", "replace").splitlines()


def errors(lines: Sequence[str]) -> list[str]:
    """The lines of urdfdom that say what is wrong, without those that tell where in its source."""
    return [line.removeprefix("Error:").strip() for line in lines if line.startswith("Error")]


def message(error: Exception) -> str:
    """What Pinocchio or Coal says, without where in its source."""
    return " ".join(str(error).rpartition("message:")[2].split())
