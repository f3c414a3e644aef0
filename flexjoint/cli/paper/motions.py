"""Motions that several tables and pictures look at: each computed once, many at once by all processors."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from flexjoint.core.running.progress import Report, silent
from flexjoint.core.running.worker_pool import worker_pool, workers_of

Call = tuple[Callable[..., Any], tuple[Any, ...]]  # a function and its arguments, which can be hashed

_known: dict[Call, Any] = {}


def motion(function: Callable[..., Any], *arguments: Any) -> Any:
    """What the function gives for these arguments, computed when it is first asked for."""
    call = (function, arguments)
    if call not in _known:
        _known[call] = function(*arguments)
    return _known[call]


def prepare(calls: Sequence[Call], cost: Callable[[Call], float], report: Report = silent) -> None:
    """Compute what is not known yet, each process about as much of the cost as the others."""
    asked = sorted({call for call in calls if call not in _known}, key=cost, reverse=True)
    job = _Job(asked, [cost(call) for call in asked], report)
    with worker_pool([job], min(workers_of(None), max(1, len(asked)))) as pool:
        # this process has many small ones, and so tells how far all are
        shares = sorted(job.shares(pool.size), key=len, reverse=True)
        for places, found in zip(shares, pool.map(job.share, shares), strict=True):
            _known.update(zip([asked[k] for k in places], found, strict=True))


class _Job:
    """Calls by their places, so that only these are sent to other processes."""

    def __init__(self, calls: Sequence[Call], costs: Sequence[float], report: Report) -> None:
        self.calls, self.costs, self.report = calls, costs, report
        self.asked_by = os.getpid()

    def shares(self, count: int) -> list[list[int]]:
        """Of each process: the dearest call that is left goes to the one that has least to do."""
        out: list[list[int]] = [[] for _ in range(count)]
        load = [0.0] * count
        for place, cost in enumerate(self.costs):
            least = load.index(min(load))
            out[least].append(place)
            load[least] += cost
        return out

    def share(self, places: Sequence[int]) -> list[Any]:
        """The results of some calls; the progress of this process stands for that of all."""
        whole, done, found = sum(self.costs[k] for k in places), 0.0, []
        for k in reversed(places):  # what is cheap soon tells how fast it goes
            if os.getpid() == self.asked_by:
                self.report(done / whole, "simulating")
            function, arguments = self.calls[k]
            found.append(function(*arguments))
            done += self.costs[k]
        return found[::-1]
