"""Processes that share the work of a search. Threads do not help: the work is many small arrays, and the
interpreter lets one thread at a time between them.

A process is forked once and holds what was there then. What is sent to and fro refers to that by its place,
and is small: fits, and what was found of candidates.
"""

from __future__ import annotations

import io
import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from flexjoint.core.errors import ModelError
from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, checkpoint, here, within

WORKERS = "FLEXJOINT_WORKERS"  # environment variable: processes, instead of one per core

Item = TypeVar("Item")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")


class WorkerPool:
    """This process and those that it has forked, each asked for its share of some items: the results do not
    depend on how many there are."""

    def __init__(self, shared: Iterable[object]) -> None:
        self._shared = list(shared)
        self._places = {id(one): place for place, one in enumerate(self._shared)}
        self._others: list[tuple[BaseProcess, Connection]] = []
        self._waiting = _Numbers()  # of items that nobody has taken; made when others are forked
        self._asker: int | None = None  # process of which this one was forked

    @property
    def size(self) -> int:
        return 1 + len(self._others)

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """`function` of every item, in order; whoever is free takes the next one. The function is one of a
        module, or a method of something shared.

        Raises what the function raises, and OutOfTimeError between two items where the time of the work
        (`flexjoint.core.running.budget.within`) is over; a process that was killed is done without."""
        return self._succeeded(self._asked(function, items))

    def reached(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result | None]:
        """The same as far as the time of the work goes: None in the place of what it did not suffice for."""
        found = self._asked(function, items)
        return self._succeeded([None if _late(one) else one for one in found])

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """The same, with item k always asked of process k modulo their number, which may remember what it
        made for the last one."""
        return self._succeeded(self._by_each(function, items))

    def _by_each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result | _Failed]:
        parts = [range(k, len(items), self.size) for k in range(self.size)]
        return self._shared_out(function, items, parts)

    def _asked(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result | _Failed]:
        """`function` of every item, of whoever is free."""
        if not self._others or len(items) > _Numbers.MOST:
            return self._by_each(function, items)
        self._waiting.put(len(items))
        return self._shared_out(function, items, [None] * self.size)

    @staticmethod
    def _succeeded(found: Sequence[Result | _Failed]) -> list[Result]:
        out: list[Result] = []
        for one in found:
            if isinstance(one, _Failed):
                raise one.error
            out.append(one)
        return out

    def _shared_out(
        self, function: Callable[[Item], Result], items: Sequence[Item], parts: Sequence[range | None]
    ) -> list[Result | _Failed]:
        """`function` of every item; of each process those of its part, or any that nobody has taken."""
        asked, left = self._others if len(items) > 1 else [], here().left
        for (_, pipe), part in zip(asked, parts[1:], strict=False):
            self._send(pipe, (function, items, part, left))
        out: dict[int, Any] = {}
        try:
            out |= self._done(function, items, parts[0])
        except BaseException:
            self.dismiss()  # answers that nobody waits for would be taken for those to the next question
            raise
        for other in list(asked):
            try:
                out |= self._received(other[1])
            except (EOFError, OSError):
                self._others.remove(other)
        lost = [k for k in range(len(items)) if k not in out]  # of a process that was killed
        out |= self._done(function, items, lost)
        return [out[k] for k in range(len(items))]

    def _done(
        self, function: Callable[[Item], Result], items: Sequence[Item], part: Iterable[int] | None
    ) -> dict[int, Result | _Failed]:
        """`function` by item, of those of a part, or of any that nobody has taken. After one that fails all
        others are left alone, as if they had failed, too."""
        out: dict[int, Result | _Failed] = {}
        for k in self._waiting if part is None else part:
            if self._asker is not None and os.getppid() != self._asker:
                raise SystemExit(1)  # it was killed, and nobody waits for an answer
            failed = next((one for one in out.values() if isinstance(one, _Failed)), None)
            try:
                if failed is None:
                    checkpoint()
                out[k] = failed or function(items[k])
            except Exception as error:  # raised again by who asked
                out[k] = _Failed(error)
        return out

    def _send(self, pipe: Connection, message: object) -> None:
        buffer = io.BytesIO()
        _Pickler(buffer, self._places).dump(message)
        try:
            pipe.send_bytes(buffer.getbuffer())
        except OSError:
            pipe.close()  # it was killed: nobody reads

    def _received(self, pipe: Connection) -> Any:
        return _Unpickler(io.BytesIO(pipe.recv_bytes()), self._shared).load()

    def fork(self, count: int) -> None:
        """Fork `count` more processes."""
        context = multiprocessing.get_context("fork")
        if count:
            self._waiting.open()
        for _ in range(count):
            here, there = context.Pipe()
            process = context.Process(target=self._serve, args=(there, here), daemon=True)
            with warnings.catch_warnings(), interrupts_held():
                # other threads' locks do not concern a process that only computes and answers
                warnings.simplefilter("ignore", DeprecationWarning)
                process.start()
                there.close()
                self._others.append((process, here))

    def _serve(self, pipe: Connection, other_end: Connection) -> None:
        """Answer until nobody asks any more."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks ends it
        asker = multiprocessing.parent_process()
        self._asker = asker.pid if asker else None
        other_end.close()
        for _, inherited in self._others:
            inherited.close()
        self._others = []
        while True:
            try:
                function, items, part, left = self._received(pipe)
            except (EOFError, OSError):
                return
            with within(Budget(left) if math.isfinite(left) else UNLIMITED):
                answer = self._done(function, items, part)
            self._send(pipe, answer)
            del function, items, part, answer

    def dismiss(self) -> None:
        for process, pipe in self._others:
            process.kill()  # it holds nothing that must be put away, and may be in the midst of its share
            process.join()
            pipe.close()
        self._others = []
        self._waiting.close()


@dataclass(frozen=True)
class _Failed:
    """In the place of a result."""

    error: Exception


def _late(one: object) -> bool:
    """Whether the time was over before something was done."""
    return isinstance(one, _Failed) and isinstance(one.error, OutOfTimeError)


class _Numbers:
    """Numbers from 0 that several processes take, each once. They wait in a pipe, of which a process that is
    killed holds no lock."""

    BYTES = 4  # of a number: a pipe gives so few to one reader only
    MOST = 65536 // BYTES  # that a pipe holds

    def __init__(self) -> None:
        self._ends: tuple[int, ...] = ()

    def open(self) -> None:
        if not self._ends:
            self._ends = os.pipe()
            os.set_blocking(self._ends[0], False)

    def put(self, count: int) -> None:
        """Numbers below `count`, where none is left over."""
        os.write(self._ends[1], b"".join(k.to_bytes(self.BYTES, "little") for k in range(count)))

    def __iter__(self) -> Iterator[int]:
        while True:
            try:
                taken = os.read(self._ends[0], self.BYTES)
            except BlockingIOError:
                return
            yield int.from_bytes(taken, "little")

    def close(self) -> None:
        for end in self._ends:
            os.close(end)
        self._ends = ()


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C takes effect on leaving: what is raised in Python's own hooks around a fork is printed and lost,
    and the work would go on."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    came: list[tuple[int, FrameType | None]] = []
    usual = signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if came and callable(usual):
        usual(*came[0])


@contextmanager
def worker_pool(shared: Iterable[object], count: int) -> Iterator[WorkerPool]:
    """A pool of `count` processes, this one included, that know `shared` by reference."""
    made = WorkerPool(shared)
    try:
        made.fork(count - 1)
        yield made
    finally:
        made.dismiss()


def one_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The function with linear algebra (BLAS) in one thread a process, whatever the environment says.

    Processes share the work; threads cost more than they save on small arrays, and may change the bits."""

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def workers_of(asked: int | None) -> int:
    """How many processes to use: as many as asked for, FLEXJOINT_WORKERS, or one per core; one where
    processes cannot be forked safely.

    Raises ModelError when fewer than one are asked for."""
    if asked is None and WORKERS in os.environ:
        text = os.environ[WORKERS]
        if not text.isdecimal() or int(text) < 1:
            raise ModelError(f"{WORKERS}: expected a whole number from 1, got {text!r}")
        asked = int(text)
    if asked is not None and asked < 1:
        raise ModelError(f"workers: expected a whole number from 1, got {asked}")
    if sys.platform != "linux" or multiprocessing.current_process().daemon:
        return 1
    return len(os.sched_getaffinity(0)) if asked is None else asked


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, places: dict[int, int]) -> None:
        super().__init__(file, protocol=5)
        self._places = places

    def persistent_id(self, obj: object) -> int | None:
        return self._places.get(id(obj))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, shared: Sequence[object]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, place: int) -> object:
        return self._shared[place]
