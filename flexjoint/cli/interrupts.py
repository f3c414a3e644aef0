"""Ctrl-C ends a command at once, also while compiled code runs that does not look at signals.

Python raises KeyboardInterrupt between two of its own instructions, and a run of a compiled model, a solver
or a reader may take seconds until the next. So a thread hears of the signal, too, and ends the process where
the main thread has not done so within a moment. And a library may swallow the exception and raise another one
(CasADi's, of what it converts when it is raised), so that it is known whether one was raised.
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

from flexjoint.cli import streams
from flexjoint.core import files

INTERRUPTED = 130  # exit code, as shells have it
MOMENT = 0.4  # s for the main thread: to end workers, remove what was half written, and say so


@contextmanager
def ended_at_once() -> Iterator[Callable[[], bool]]:
    """Within, Ctrl-C ends the process within about half a second, whatever it is doing. Gives whether it came
    already."""
    came, usual = threading.Event(), signal.getsignal(signal.SIGINT)
    if (
        os.name != "posix"
        or threading.current_thread() is not threading.main_thread()  # signals are that one's
        or usual is not signal.default_int_handler  # who ignores them is not to hear of them
    ):
        yield came.is_set
        return

    def raises(number: int, frame: FrameType | None) -> None:
        came.set()
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, raises)
    over = threading.Event()
    hears, is_told = socket.socketpair()
    is_told.setblocking(False)
    before = signal.set_wakeup_fd(is_told.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(hears, over), daemon=True, name="interrupts").start()
    try:
        yield came.is_set
    finally:
        signal.set_wakeup_fd(before)
        signal.signal(signal.SIGINT, usual)
        over.set()
        with suppress(OSError):
            is_told.shutdown(socket.SHUT_RDWR)
        is_told.close()


def end_now(code: int) -> NoReturn:
    """End without freeing memory, which takes seconds of a large recording on a busy machine; temporary
    folders are removed."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code)


def _listen(hears: socket.socket, over: threading.Event) -> None:
    with hears:
        while told := hears.recv(1):
            if told[0] == signal.SIGINT:
                if not over.wait(MOMENT):
                    _leave()
                return


def _leave() -> None:
    """End here and now: no worker, no half-written file, one line."""
    import multiprocessing  # takes a while, and most commands fork nothing

    workers = multiprocessing.active_children()
    for worker in workers:
        worker.kill()
    for worker in workers:
        worker.join(MOMENT)
    files.remove_unfinished()
    streams.say_interrupted()
    os._exit(INTERRUPTED)
