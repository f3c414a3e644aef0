"""Standard output and error as the commands use them: one line for a message, whatever it quotes."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
import warnings
from collections.abc import Iterator

from flexjoint.core.messages import LONGEST_LINE, one_line

WHO = "flexjoint: "  # in front of each line

_ended = threading.Lock()  # held when the interrupt of this run was told


def say(message: object) -> None:
    """One line on standard error, as far as there is one."""
    with contextlib.suppress(OSError, ValueError):
        print(f"{WHO}{one_line(message, LONGEST_LINE - len(WHO))}", file=sys.stderr, flush=True)


def say_interrupted() -> None:
    """That Ctrl-C ended the command: once, whoever comes first."""
    if _ended.acquire(blocking=False):
        say("interrupted")


class _Sayer(logging.Handler):
    """What the package logs, said as warnings are."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"warning: {record.getMessage()}")


@contextlib.contextmanager
def plain() -> Iterator[None]:
    """Streams that take every character, and are there even where they were closed; warnings, logged ones
    included, as one line on standard error, without the place in the code."""
    with contextlib.suppress(RuntimeError):  # it was not held
        _ended.release()
    with contextlib.ExitStack() as stack:
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name)
            if stream is None:
                stream = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
                setattr(sys, name, stream)
                stack.callback(setattr, sys, name, None)
            elif hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
        stack.enter_context(warnings.catch_warnings())
        warnings.showwarning = lambda message, *_rest: say(f"warning: {message}")
        sayer, log = _Sayer(logging.WARNING), logging.getLogger("flexjoint")
        log.addHandler(sayer)
        stack.callback(log.removeHandler, sayer)
        yield


def abandon_output() -> None:
    """Send what is still to be printed nowhere: nobody reads it, or it cannot be written."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
