"""Processes that share the work: order, what they know by reference, errors, one that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from flexjoint.core.errors import ModelError
from flexjoint.core.running.budget import Budget, OutOfTimeError, within
from flexjoint.core.running.worker_pool import WORKERS, WorkerPool, one_thread, worker_pool, workers_of


class Known:
    """Something large that every process has."""

    def __init__(self) -> None:
        self.numbers = np.arange(10.0)

    def times(self, factor: float) -> tuple[float, int]:
        return factor * float(self.numbers.sum()), os.getpid()

    def itself(self, _: object) -> Known:
        return self


def whoami(_: object) -> int:
    return os.getpid()


def inverse(x: float) -> float:
    return 1.0 / x


@pytest.mark.parametrize("count", [1, 2, 4])
def test_results_are_in_order_and_the_work_is_shared(count: int) -> None:
    known = Known()
    with worker_pool([known], count) as processes:
        for shared_out in (processes.each, processes.map):
            out = shared_out(known.times, [float(k) for k in range(11)])
            assert [value for value, _ in out] == [45.0 * k for k in range(11)]
            assert shared_out(whoami, []) == []
        out = processes.each(known.times, [float(k) for k in range(11)])
        assert len({process for _, process in out}) == count
        assert [process for _, process in out[count:]] == [process for _, process in out[:-count]]
        assert out[0][1] == os.getpid()


def pause(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def test_whoever_is_free_takes_the_next_item() -> None:
    with worker_pool([], 2) as processes:
        done = processes.map(pause, [0.5, *8 * [0.01]])
    assert sorted(done.count(one) for one in set(done)) == [1, 8]


def test_more_items_than_can_wait_are_shared_out_beforehand() -> None:
    with worker_pool([], 2) as processes:
        many = [float(k) for k in range(1, 20001)]
        assert processes.map(inverse, many) == [1.0 / x for x in many]


def test_what_is_shared_comes_back_as_itself() -> None:
    known = Known()
    with worker_pool([known], 2) as processes:
        assert all(one is known for one in processes.map(known.itself, [0, 1, 2]))


@pytest.mark.parametrize("wrong", [0, 1])
def test_an_error_is_raised_where_it_is_asked_for(wrong: int) -> None:
    with worker_pool([], 2) as processes:
        items = [2.0, 2.0]
        items[wrong] = 0.0
        with pytest.raises(ZeroDivisionError):
            processes.map(inverse, items)
        assert processes.map(inverse, [2.0, 4.0]) == [0.5, 0.25]  # no answer is left over


def test_a_killed_process_is_done_without() -> None:
    with worker_pool([], 2) as processes:
        other = processes.each(whoami, [0, 1])[1]
        assert other != os.getpid()
        os.kill(other, signal.SIGKILL)
        assert processes.map(inverse, [2.0, 4.0, 8.0]) == [0.5, 0.25, 0.125]
        assert processes.size == 1


def test_nobody_is_left_behind() -> None:
    with worker_pool([], 3) as processes:
        others = processes.each(whoami, [0, 1, 2])[1:]
    for process in others:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


LONG = """
import os, time
from flexjoint.core.running.worker_pool import worker_pool

def rest(_):
    print(os.getpid(), flush=True)
    time.sleep(0.05)

with worker_pool([], 2) as processes:
    processes.map(rest, range(2000))
"""


def test_nobody_works_on_for_a_process_that_was_killed() -> None:
    """A hundred seconds of work are left when it is ended; a worker ends with the item that it has."""
    with subprocess.Popen([sys.executable, "-c", LONG], stdout=subprocess.PIPE, text=True) as asker:
        assert asker.stdout is not None
        seen = {asker.pid}
        while len(seen) < 2:
            seen.add(int(asker.stdout.readline()))
        asker.terminate()
        asker.communicate(timeout=30)  # over when no process can write any more


def test_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(WORKERS, raising=False)
    assert workers_of(3) == 3
    assert workers_of(None) == len(os.sched_getaffinity(0))
    monkeypatch.setenv(WORKERS, "2")
    assert workers_of(None) == 2
    for wrong in ("0", "two", "-1"):
        monkeypatch.setenv(WORKERS, wrong)
        with pytest.raises(ModelError, match=f"{WORKERS}: expected a whole number from 1, got {wrong!r}"):
            workers_of(None)
    with pytest.raises(ModelError, match="got 0"):
        workers_of(0)


def test_crews_beside_each_other_end() -> None:
    """One that is forked later inherits the pipes of those before it."""
    first = WorkerPool([])
    first.fork(1)
    second = WorkerPool([])
    second.fork(1)
    first.dismiss()
    second.dismiss()


def test_linear_algebra_takes_one_thread_whatever_the_environment_says() -> None:
    @one_thread
    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    with threadpool_limits(limits=2, user_api="blas"):
        outside = [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]
        assert outside and set(outside) == {2}
        assert set(threads()) == {1}


def test_an_interrupt_during_a_fork_is_not_lost() -> None:
    """Python prints what its hooks around a fork raise, and goes on."""
    armed = [True]

    def interrupt() -> None:
        if armed and armed.pop():
            signal.raise_signal(signal.SIGINT)  # to this thread, before the next instruction
            sum(range(1000))  # the interpreter looks at signals between instructions

    os.register_at_fork(after_in_parent=interrupt)
    made = WorkerPool([])
    # a shell has what it starts in the background ignore Ctrl-C
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            made.fork(1)
        assert made.size == 2  # known, so that it is dismissed
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        made.dismiss()
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("count", [1, 3])
def test_work_ends_between_two_items_when_its_time_is_over(count: int) -> None:
    items = [1.0, 2.0, 4.0, 8.0, 5.0, 10.0]
    with worker_pool([], count) as processes:
        with within(Budget(0.0)):
            with pytest.raises(OutOfTimeError):
                processes.map(inverse, items)
            with pytest.raises(OutOfTimeError):
                processes.each(inverse, items)
            assert processes.reached(inverse, items) == [None] * 6
        with within(Budget(3600.0)):
            assert processes.reached(inverse, items) == [1.0 / x for x in items]
            with pytest.raises(ZeroDivisionError):
                processes.reached(inverse, [0.0] * 6)
        assert processes.map(inverse, items) == [1.0 / x for x in items]


def test_what_was_reached_in_time_is_kept() -> None:
    now = iter([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    with worker_pool([], 1) as processes, within(Budget(4.0, now.__next__)):
        # asked once for the others' time, and before each item
        assert processes.reached(inverse, [1.0, 2.0, 4.0, 8.0]) == [1.0, 0.5, None, None]
