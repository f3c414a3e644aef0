"""Ctrl-C ends a command at once, also while compiled code runs that does not look at signals.

Python raises KeyboardInterrupt between two of its own instructions, and a run of a compiled model, a solver
or a reader may take seconds until the next. So a thread hears of the signal, too, and ends the process where
the main thread has not done so within a moment.
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from flexjoint.cli import streams
from flexjoint.core import files

INTERRUPTED = 130  # exit code, as shells have it
MOMENT = 0.4  # s for the main thread: to end workers, remove what was half written, and say so


@contextmanager
def ended_at_once() -> Iterator[None]:
    """Within, Ctrl-C ends the process within about half a second, whatever it is doing."""
    if os.name != "posix" or threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    over = threading.Event()
    hears, is_told = socket.socketpair()
    is_told.setblocking(False)
    before = signal.set_wakeup_fd(is_told.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(hears, over), daemon=True, name="interrupts").start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
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
