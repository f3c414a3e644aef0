"""The recordings that laws are learned from, cut into stretches of time that are left out in turn.

What lies between fitted samples is foretold too easily: the machine is then in places that the fit knows, and
an error that drifts is much the same on both sides. So a stretch is a fourth of a recording in one piece.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import about_likely_links
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.settings import LearnSettings, Settings
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

FOLDS = 2  # parts of a stretch, which are left out in turn to choose a law and its smoothness
LEAST_PARTS = 2  # of a recording: what is unknown in it alone (encoder offsets) is told by the other one


@dataclass(frozen=True)
class Part:
    """A stretch of one recording, [begin, end) in seconds from its start."""

    recording: int
    begin: float
    end: float

    def holds(self, time: np.ndarray) -> np.ndarray:
        """(N,) bool: whether times from the recording's start lie in it."""
        return (time >= self.begin) & (time < self.end)


@dataclass(frozen=True)
class Evidence:
    """Recordings as regression problems with the likely causes at work, all at one noise level each."""

    robots: tuple[Robot, ...]  # nominal, with what is known to hang on it
    problems: tuple[Problem, ...]
    causes: tuple[Planned, ...]
    parts: tuple[Part, ...]

    @classmethod
    def of(
        cls,
        robots: Sequence[Robot],
        recordings: Sequence[Recording],
        causes: Sequence[Planned],
        settings: Settings,
    ) -> Evidence:
        problems = []
        for robot, recording in zip(robots, recordings, strict=True):
            problem = about_likely_links(Problem(balances_of(robot, recording, settings))).about(causes)
            problems.append(problem.at(problem.plausible_level(problem.residual(causes))))
        parts = tuple(
            part for k, problem in enumerate(problems) for part in _parts(k, problem, len(problems))
        )
        return cls(tuple(robots), tuple(problems), tuple(causes), parts)

    @property
    def limits(self) -> LearnSettings:
        return self.problems[0].settings.learn

    @property
    def too_short(self) -> float:
        """[s] the motion that it takes, where a recording has less; 0 where all are long enough."""
        least = self.limits.shortest_stretch
        short = any(part.end - part.begin < least for part in self.parts)
        return least * len(self.parts) / len(self.problems) if short else 0.0

    def residuals(self, effects: Sequence[Planned]) -> list[np.ndarray]:
        """(samples,) by recording: the whitened residual with these effects."""
        return [problem.residual(effects) for problem in self.problems]

    def at(self, levels: Sequence[NoiseLevel]) -> Evidence:
        """The same at other noise levels."""
        problems = [p.at(level) for p, level in zip(self.problems, levels, strict=True)]
        return replace(self, problems=tuple(problems))

    @cached_property
    def folds(self) -> tuple[np.ndarray, ...]:
        """(N,) by recording: which fold each white sample belongs to."""
        out = []
        for k, problem in enumerate(self.problems):
            time, own = white_time(problem), [part for part in self.parts if part.recording == k]
            edges = np.concatenate([np.linspace(p.begin, p.end, FOLDS, endpoint=False) for p in own])
            out.append(np.searchsorted(edges, time, side="right"))
        return tuple(out)

    def without(self) -> Iterator[tuple[Part, Evidence]]:
        """Every stretch, with the evidence of all others."""
        for part in self.parts:
            k = part.recording
            problems = list(self.problems)
            problems[k] = problems[k].only(~part.holds(white_time(problems[k])))
            yield part, replace(self, problems=tuple(problems))


def white_time(problem: Problem) -> np.ndarray:
    """(N,) times of white samples from the recording's start [s]."""
    return np.asarray(problem.balances.chains.t[0] + problem.time)


def read_time(problem: Problem) -> np.ndarray:
    """(N,) times of usable samples from the recording's start [s]."""
    return np.asarray(problem.balances.chains.t[problem.readings.valid])


def _parts(k: int, problem: Problem, recordings: int) -> list[Part]:
    count = max(LEAST_PARTS, -(-problem.settings.learn.stretches // recordings))
    end = float(problem.balances.chains.t[-1]) + problem.readings.period
    edges = np.linspace(0.0, end, count + 1)
    return [Part(k, float(a), float(b)) for a, b in pairwise(edges)]
