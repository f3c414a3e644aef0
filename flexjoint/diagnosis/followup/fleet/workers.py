"""Units shared by workers: local processes, or those of a Dask cluster. A worker that dies loses nothing but
the unit that it had, which is tried again."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import forkserver, get_context, resource_tracker
from typing import Any

from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.diagnosis.followup.fleet.units import SCHEMA, Unit, perform, release

PATIENCE = "5s"  # for a scheduler to answer
AHEAD = 2  # units a worker that are handed out ahead of time

Result = dict[str, Any]
Runner = Callable[[Sequence[Unit]], Iterator[Result]]


def local(workers: int, restarts: int) -> Runner:
    """Processes of this machine; 1: this one."""

    def run(units: Sequence[Unit]) -> Iterator[Result]:
        if workers == 1:
            yield from map(perform, units)
            return
        waiting = iter(units)
        while True:
            # a worker that dies takes its pool along. Which unit killed it is not known, so the few that were
            # under way are then done one by one
            under_way: list[Unit] = []
            yield from _in_pool(waiting, workers, under_way)
            if not under_way:
                return
            for unit in under_way:
                yield _alone(unit, restarts)

    return run


def _in_pool(waiting: Iterator[Unit], workers: int, under_way: list[Unit]) -> Iterator[Result]:
    """Results until nothing waits, or a worker dies: `under_way` then holds the units without a result."""
    with _pool(workers) as pool:
        futures: dict[Future[Result], Unit] = {}

        def hand_out(count: int) -> None:
            for unit in islice(waiting, count):
                try:
                    futures[pool.submit(perform, unit)] = unit
                except BrokenProcessPool:  # another one died meanwhile
                    under_way.append(unit)
                    return

        hand_out(AHEAD * workers)
        while futures:
            done, _ = wait(futures, return_when=FIRST_COMPLETED)
            for future in done:
                unit = futures.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    under_way.append(unit)
                    continue
                if not under_way:
                    hand_out(1)
                yield result
            if under_way:
                under_way += futures.values()
                return


def _alone(unit: Unit, restarts: int) -> Result:
    for _ in range(restarts + 1):
        with _pool(1) as pool, suppress(BrokenProcessPool):
            return pool.submit(perform, unit).result()
    return died(unit)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes, which are killed where nobody waits for their results any more."""
    context = get_context("forkserver" if sys.platform == "linux" else "spawn")
    if sys.platform == "linux":  # a server imports what takes long once, and has no threads when it forks
        context.set_forkserver_preload(["flexjoint.diagnosis.followup.fleet.units"])
        resource_tracker.ensure_running()  # which the server starts, too, and unblocks signals with
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            forkserver.ensure_running()  # it and its workers leave Ctrl-C, which all of a terminal get, to us
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        try:
            yield pool
        except BaseException:
            # the server first: it may be importing yet, and would start workers after us
            server = getattr(forkserver._forkserver, "_forkserver_pid", None)
            if sys.platform == "linux" and server is not None:
                with suppress(ProcessLookupError):
                    os.kill(server, signal.SIGKILL)
            for process in list(pool._processes.values()):
                process.kill()
            raise


def cluster(address: str, restarts: int) -> Runner:
    """The workers of a Dask scheduler (tcp://host:8786), which must see the recordings under the same paths.

    Raises MissingExtraError without distributed, FlexJointError where no scheduler answers."""
    try:
        import distributed
    except ImportError:
        raise MissingExtraError("distributed", "fleet") from None

    def run(units: Sequence[Unit]) -> Iterator[Result]:
        try:
            client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise FlexJointError(
                f"no Dask scheduler answers at {address}: {error}; start one with `dask scheduler`"
            ) from None
        with client:
            futures = {
                client.submit(perform, unit, key=f"flexjoint-{unit.key}", pure=True, retries=restarts): unit
                for unit in units
            }
            for future in distributed.as_completed(list(futures), loop=client.loop):
                unit = futures.pop(future)
                yield future.result() if future.status == "finished" else died(unit)

    return run


def died(unit: Unit) -> Result:
    """The result of a unit whose workers died again and again."""
    return {
        "schema": SCHEMA,
        "key": unit.key,
        "kind": unit.kind,
        "version": release(),
        "error": "the worker died each time: too little memory?",
        "died": True,
        "seconds": 0.0,
    }
