"""Which machines a benchmark holds: parts, each drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexjoint_benchmark import BenchmarkError
from flexjoint_benchmark.planting.cases import (
    INEXACT,
    Case,
    healthy_cases,
    inexact_cases,
    sensor_cases,
    single_case,
)
from flexjoint_benchmark.planting.catalogue import BEYOND, CATALOGUE
from flexjoint_benchmark.planting.dirty.case import Dirty
from flexjoint_benchmark.planting.dirty.dirty import dirty

PARTS = {
    "clean": "one cause, and nominal numbers that are exact, claimed to 2 %",
    "inexact": "one cause beside nominal numbers that are off by 1 to 3 %, damping by 3 to 9 %",
    "sensors": "one cause, seen with some channels only, on ragged time, or through a noisy controller",
    "dirty": "one to three large causes above a background of small errors, nominal numbers off by 2 to 10 %",
    "unknown": "a large effect of no catalogue above such a background",
    "healthy": "nothing, nominal numbers exact or off by 1 to 3 %",
}
EVERY = (*CATALOGUE, *BEYOND)
SECONDS = 12.0  # of clean, inexact and healthy recordings
OTHERS = 100_000  # numbers of dirty machines from here on: those below are of the project's own study


@dataclass(frozen=True)
class Task:
    """A machine and its recording, with all that is true of it."""

    part: str
    case: Case

    def made(self) -> tuple[Any, dict[str, Any]]:
        """The recording, and the truth of the case."""
        recorded = self.case.train()
        told = self.case.measured(recorded) if isinstance(self.case, Dirty) else self.case.truth()
        return recorded, {"part": self.part, "joints": list(recorded.real.joints), **told}


def drawn(parts: tuple[str, ...], count: int, seed: int) -> Iterator[Task]:
    """`count` tasks of each part, in an order that does not tell it; BenchmarkError for other parts."""
    if unknown := [part for part in parts if part not in PARTS]:
        raise BenchmarkError(f"unknown parts {', '.join(unknown)}; there are {', '.join(PARTS)}")
    rng = np.random.default_rng([seed, 1])
    order = rng.permutation([part for part in parts for _ in range(count)])
    waiting = {part: _of_part(part, count, seed) for part in parts}
    for part in order:
        yield Task(str(part), next(waiting[str(part)]))


def _of_part(part: str, count: int, seed: int) -> Iterator[Case]:
    rng = np.random.default_rng([seed, 2, list(PARTS).index(part)])
    first = OTHERS + 1000 * seed
    if part in ("dirty", "unknown"):
        kind = "causes" if part == "dirty" else part
        return (dirty(kind, first + k) for k in range(count))
    if part == "clean":
        effects = [str(effect) for effect in rng.permutation(EVERY)]
        return (
            replace(
                single_case(f"benchmark_{k}", effects[k % len(effects)], first + k // len(effects)),
                seconds=SECONDS,
            )
            for k in range(count)
        )
    makers: dict[str, Callable[[int], list[Case]]] = {
        "inexact": lambda k: [case for case in inexact_cases(k) if case.effects],
        "sensors": sensor_cases,
        "healthy": _healthy,
    }
    return _repeated(makers[part], count, first, rng)


def _healthy(seed: int) -> list[Case]:
    return [
        replace(case, inexact=inexact, seconds=SECONDS)
        for case in healthy_cases(seed)
        for inexact in (0.0, INEXACT)
    ]


def _repeated(
    maker: Callable[[int], list[Case]], count: int, seed: int, rng: np.random.Generator
) -> Iterator[Case]:
    """`count` cases of a maker, each list of it shuffled, and a new list where one is not enough."""
    left = count
    while left > 0:
        cases = maker(seed)
        for k in rng.permutation(len(cases))[:left]:
            yield cases[k]
        left -= len(cases)
        seed += 1
