"""What a simulated recording would show: the odds of two hypotheses, and which effects are visible in it.

All questions to the diagnosis are asked here: its balances, its noise, its tolerances and its fits decide, so
that odds are those which `flexjoint diagnose` will find.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate, Trace, enumerate_candidates, traces
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import MEASURED, Recording, make
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import Simulation, simulate

Key = tuple[str, str | None]


@dataclass(frozen=True)
class Sensors:
    """Measured channels with the standard deviation of their noise, by (channel, joint)."""

    noise: Mapping[tuple[str, str], float]

    def has(self, channel: str, joint: str) -> bool:
        return (channel, joint) in self.noise


@dataclass(frozen=True)
class Odds:
    """Logarithm of the odds for the truth against a rival, and the rival as it comes closest: its effects,
    their free numbers (k,) and the covariance of these (k, k)."""

    log: float
    rival: tuple[Planned, ...]
    numbers: np.ndarray
    covariance: np.ndarray

    @property
    def words(self) -> tuple[object, ...]:
        return tuple(e.values.get(word.name) for e in self.rival for word in e.effect.words)


def simulated(robot: Robot, effects: Sequence[Planned], reference: Recording) -> Simulation:
    """The robot with these effects along a reference, under its own controller, without noise."""
    model = FlexibleJointModel(robot.extended(effects))
    rate = robot.rates.physics
    stride = max(1, int(np.ceil(rate / USUAL.plan.sample_rate)))
    while rate.is_integer() and rate % stride:  # a whole number of samples a second, where there is one
        stride += 1
    return simulate(model, reference, sample_rate=rate / stride)


def recorded(run: Simulation, sensors: Sensors, seed: int) -> Recording:
    """What the sensors would write down of a simulated run: their channels with their noise, and tau_m."""
    random = np.random.default_rng(seed)
    columns = {}
    for (channel, joint), values in run.measured.columns.items():
        noise = random.standard_normal(len(values))
        if channel not in MEASURED:
            columns[channel, joint] = values
        elif sensors.has(channel, joint):
            columns[channel, joint] = values + sensors.noise[channel, joint] * noise
    return make(run.measured.time, columns, run.measured.name)


class Evidence:
    """One recording of a robot, and what it says about hypotheses."""

    def __init__(self, robot: Robot, recording: Recording) -> None:
        self.robot = robot
        self.problem = Problem(balances_of(robot, recording))
        self.candidates = enumerate_candidates(self.problem)

    def odds(self, beside: Sequence[Planned], truth: Sequence[Planned], rival: Sequence[Key]) -> Odds:
        """For the truth against the best that the rival (its effects and joints) can do in its place, with
        every free number of either fitted and the tolerances of the nominal ones used up; `beside` are
        causes that both hypotheses share.

        The energy of a white residual is -2 log likelihood, up to a constant."""
        own = fit(self.problem, [*beside, *truth])
        # what filters and friction zones leave counts as noise
        level = self.problem.at(self.problem.plausible_level(own.y))
        own = fit(level, own.effects)
        others = list(own.effects[: len(beside)])
        best = fit(level, others)
        for start in self._starts(level, others, rival):
            other = fit(level, [*others, *start])
            if other.energy < best.energy:
                best = other
        free = [k for k, slot in enumerate(best.slots) if slot.effect >= len(beside)]
        numbers = np.array([best.slots[k].get(best.effects) for k in free])
        spread = np.linalg.pinv(level.product(best.tangents, best.tangents)) if free else np.zeros((0, 0))
        return Odds(
            0.5 * (best.energy - own.energy),
            best.effects[len(beside) :],
            numbers,
            spread[np.ix_(free, free)],
        )

    def _starts(self, level: Problem, others: list[Planned], rival: Sequence[Key]) -> list[list[Planned]]:
        """Where fits of the rival begin: the starts of its effects that remove most to first order."""
        if len(rival) > 1:  # one effect on several joints
            return [[c.planned(_trial(level, c, others)) for c in self._of(rival)]]
        y = level.residual(others)
        found: list[tuple[float, Planned]] = []
        for candidate in self._of(rival):
            for trace in traces(level, candidate, level.with_nominal(others), y):
                amplitude, removed = _solved(level, trace, y)
                found.append((removed, candidate.planned(trace.values(amplitude))))
        found.sort(key=lambda pair: -pair[0])
        return [[planned] for _, planned in found[: USUAL.plan.most_starts]]

    def _of(self, keys: Sequence[Key]) -> list[Candidate]:
        return [c for c in self.candidates if c.key in keys]

    def shown(self) -> dict[Key, float]:
        """Every effect of the catalogue that the sensors could see, on every joint: energy that it leaves
        beyond the tolerances at a size that matters (`material`). Below
        `VerdictSettings.detectable` it is not excited."""
        y = self.problem.residual([])
        out: dict[Key, float] = {}
        for candidate in self.candidates:
            if candidate.effect.overrides("edit_inertial"):
                continue  # its trace is fitted to a residual, and there is none
            for trace in traces(self.problem, candidate, self.problem.nominal, y):
                sizes = self._sizes(trace)
                curvature = np.diag(self.problem.product(trace.columns, trace.columns))
                seen = float(np.max(curvature * sizes**2))
                out[candidate.key] = max(out.get(candidate.key, 0.0), seen)
        return out

    def _sizes(self, trace: Trace) -> np.ndarray:
        """(k,) what a trace's columns have to be multiplied by to be of a material size."""
        if trace.kind == "whole":  # there or not: its start is its size
            return np.ones(len(trace.columns))
        units = {p.name: p.unit for p in trace.candidate.effect.params}
        sizes = [
            material(self.robot, trace.candidate.joint, units[n]) / t for n, t in trace.trial.items() if t
        ]
        return np.resize(sizes or [1.0], len(trace.columns))


def material(robot: Robot, joint: str | None, unit: str) -> float:
    """The size of a parameter that anybody would want to know of: a share of a usual torque of the joint,
    at usual speeds and travels. It does not depend on a motion, so that better motions show more."""
    plan, share = USUAL.plan, USUAL.verdict.seen_share
    if joint is None:
        return share
    own = robot.joint(joint)
    load = plan.usual_torque * (own.torque_limit if np.isfinite(own.torque_limit) else plan.usual_limit)
    torque = share * load
    stiffness = own.drive.K if np.isfinite(own.drive.K) else load / plan.usual_travel
    by_unit = {
        "N m": torque,
        "N m s/rad": torque / plan.usual_speed,
        "N m s^2/rad^2": torque / plan.usual_speed**2,
        "N m/rad": torque / plan.usual_travel,
        "N m/rad^3": torque * (stiffness / load) ** 3,
        "rad": torque / stiffness,
        "s": plan.usual_delay,
    }
    return float(by_unit.get(unit, share))


def pair(first: Odds, second: Odds) -> float:
    """Log odds of two recordings together, whose rival must explain both with one set of numbers: the sum,
    and what it costs to bring the rival's two sets of numbers together. Nominal numbers may differ between
    the two recordings, so that the odds are too low rather than too high."""
    total = first.log + second.log
    if not first.numbers.size or first.numbers.shape != second.numbers.shape or first.words != second.words:
        return total
    apart = first.numbers - second.numbers
    return total + 0.5 * float(apart @ np.linalg.pinv(first.covariance + second.covariance) @ apart)


def _solved(level: Problem, trace: Trace, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Amplitudes of a trace's columns and the energy that they remove from y, to first order."""
    curvature, force = level.product(trace.columns, trace.columns), level.against(trace.columns, y)
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-12))
    scaled = curvature / np.outer(size, size) + 1e-9 * np.eye(len(size))
    amplitude = -np.linalg.solve(scaled, force / size) / size
    if trace.kind == "whole":  # an effect that is there or not, not one of any size
        amplitude = np.clip(amplitude, 0.0, 1.5)
    return amplitude, float(-2.0 * amplitude @ force - amplitude @ curvature @ amplitude)


def _trial(level: Problem, candidate: Candidate, others: Sequence[Planned]) -> Mapping[str, object]:
    y = level.residual(others)
    found = [
        (_solved(level, trace, y), trace) for trace in traces(level, candidate, level.with_nominal(others), y)
    ]
    (amplitude, _), trace = max(found, key=lambda pair: pair[0][1])
    return trace.values(amplitude)
