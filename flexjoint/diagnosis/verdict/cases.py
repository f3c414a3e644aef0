"""What the checks examine: a set of causes, its simulation, and the findings that would be reported."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, within
from flexjoint.diagnosis.refinement import refined
from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import Errors
from flexjoint.diagnosis.result import Estimation, Finding, Gain, Remaining, ResidualView, Step, Unexplained
from flexjoint.diagnosis.search.selection import Key, Selection
from flexjoint.diagnosis.verdict import verdict
from flexjoint.diagnosis.verdict.reliability import by_simulation, followed
from flexjoint.diagnosis.verdict.residuals import explained_share, residual_views, unexplained_balances
from flexjoint.diagnosis.verdict.transients import with_pushes
from flexjoint.diagnosis.verdict.unseen.noise_floor import noise_floor
from flexjoint.diagnosis.verdict.unseen.simulation import comparison
from flexjoint.diagnosis.verdict.unseen.simulation import gains as gains_of
from flexjoint.diagnosis.verdict.unseen.torques import Unseen, remaining, unseen
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

LATE = "the time allowed was over before every simulation on held-out data: gains there are not all known"

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Case:
    """A set of causes, and the steps that led to it."""

    selection: Selection
    trace: tuple[Step, ...]

    def changed(self, selection: Selection, *steps: Step) -> Self:
        """The case after some steps."""
        return replace(self, selection=selection, trace=(*self.trace, *steps))


@dataclass(frozen=True)
class SimulatedCase(Case):
    """A set, and what it gains on held-out data; None where the recording cannot drive a simulation, or the
    `budget` is spent before its end, which `late` then says."""

    robot: Robot
    recording: Recording
    problem: Problem
    measured: Gain | None = None
    budget: Budget = field(default=UNLIMITED, kw_only=True)
    late: list[str] = field(default_factory=list, kw_only=True, repr=False, compare=False)

    def changed(self, selection: Selection, *steps: Step) -> Self:
        return super().changed(selection, *steps).simulated()

    def simulated(self) -> Self:
        """The case with its set's simulation on held-out data."""
        return replace(self, measured=self.gain(self.selection.best, self.measured))

    def gain(self, best: Fit, known: Gain | None = None, nothing: Fit | None = None) -> Gain | None:
        """`comparison` of a set, in the time that is allowed."""
        try:
            with within(self.budget):
                return comparison(self.robot, self.recording, self.problem, best, known, nothing)
        except OutOfTimeError:
            self.late[:] = [LATE]
            return None


@dataclass(frozen=True)
class StatedCase(SimulatedCase):
    """A set as findings with their numbers; each is made when it is first asked for.

    `kept` says why the numbers are not refined on the simulation; if empty, they are. `spread` replaces the
    standard errors of the first recording. `workers` is the number of processes that share a refinement,
    `refining` the time after which it is given up.
    """

    kept: str = field(kw_only=True)
    workers: int = field(kw_only=True)
    spread: Mapping[Key, Errors] = field(kw_only=True)
    report: Progress = field(kw_only=True, repr=False)
    refining: Budget = field(default=UNLIMITED, kw_only=True)

    @cached_property
    def residuals(self) -> tuple[ResidualView, ...]:
        return residual_views(self.selection.best, self.selection.nothing)

    @cached_property
    def left(self) -> tuple[Unexplained, ...]:
        best = self.selection.best
        left = unexplained_balances(best, self.residuals)
        return with_pushes(left, self.residuals, best.problem.readings.start, best.settings.verdict)

    @cached_property
    def explained(self) -> float:
        return explained_share(self.selection.best, self.residuals)

    @cached_property
    def unseen(self) -> Unseen:
        return unseen(self.selection.best, self.selection.nothing)

    @cached_property
    def remaining(self) -> tuple[Remaining, ...]:
        return remaining(self.unseen)

    @cached_property
    def named(self) -> tuple[Finding, ...]:
        """The findings with the numbers of the balances."""
        gains = gains_of(self.problem, self.selection.best)
        return verdict.findings(self.selection, gains, self.unseen, self._simulated, self.spread)

    def _simulated(self, k: int, beside: int) -> float:
        """How far the simulation on held-out data supports effect k of the set."""
        if self.measured is None:
            return 0.0
        best = self.selection.best
        less = refit_without(best, best.effects[k])
        without = self.gain(less, self.measured)
        return by_simulation(self.measured, without, best.effects[k], best.settings.verdict, beside)

    @cached_property
    def estimated(self) -> tuple[tuple[Finding, ...], Estimation | None]:
        """The findings with their numbers refined on the simulation, where that is asked for and can be done,
        and how they were estimated."""
        best = self.selection.best
        if not self.named:
            return (), None
        if self.kept:
            return self.named, refined.from_balances(best, self.kept)
        self.report(0.95, "refining the numbers on the simulation")
        found, estimation = refined.refine(best, self.named, self.workers, self.refining)
        return followed(best, found, estimation), estimation

    @cached_property
    def against_noise(self) -> Gain | None:
        """What the set gains, beside what noise alone leaves in its simulation."""
        if self.measured is None:
            return None
        try:
            with within(self.budget):
                model = self.robot.extended(self.selection.best.effects)
                floor = noise_floor(model, self.problem.readings.recording)
        except OutOfTimeError:
            return self.measured
        return replace(self.measured, noise_floor=floor)

    @property
    def notes(self) -> tuple[str, ...]:
        """Why the numbers are those of the balances, where a refinement was tried."""
        estimation = self.estimated[1]
        if estimation is None or self.kept or not estimation.why:
            return ()
        return (f"numbers are those of the torque balances: {estimation.why}",)
