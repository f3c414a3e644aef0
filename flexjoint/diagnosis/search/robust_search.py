"""Robust search where errors are left unexplained: on real machines many things are wrong at once.

The usual search raises the noise level of all balances where a single nominal number is implausible and a
joint is flexible. And both balances of a stiff joint depend on its link encoder: an error of 0.1 mrad times
5e6 N m/rad is more torque than most causes have. This search differs in five points:

- what a joint's motor balance leaves counts as error of its link encoder, divided by the stiffness: then the
  sum of motor and link balance, which contains no spring torque, decides;
- it looks only at joints whose link encoder and spring disagree by far more than the encoder's noise;
- an implausible nominal number raises the noise level of its own joint's balances only;
- dry friction at rest holds no more than its level;
- a cause needs the evidence of the simulation: with the numbers that the balances give, it must clearly lower
  the simulated error of its own joint. A wrong cause that only makes a balance small does not do that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import OutOfTimeError
from flexjoint.diagnosis.balances.balances import MOTOR, TwinBalances
from flexjoint.diagnosis.balances.motion import reconstruct
from flexjoint.diagnosis.comparison.compare import compared
from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.regression.recorded import Recorded
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level, degenerate, supported
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.search.trials import on_all_joints
from flexjoint.diagnosis.signals.signals import denoised
from flexjoint.effects import Planned, Site
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

Progress = Callable[[float, str], None]


class JointwiseProblem(Problem):
    """A problem in which implausible nominal numbers raise the noise level of their own joint's balances
    only."""

    def __init__(self, balances: TwinBalances, deviation: np.ndarray) -> None:
        self._deviation = deviation
        super().__init__(balances)

    @property
    def deviation(self) -> np.ndarray:
        """(rows,) standard deviation that the sensors' own noise has in each balance [N m], without the
        errors that count as noise here: what is left is compared with this in the report."""
        return self._deviation

    def plausible_level(self, y: np.ndarray) -> NoiseLevel:
        """As `Problem.plausible_level`, joint by joint."""
        base, implausibility = self.free_level(y).inflation, np.ones_like(self.level.inflation)
        here = self.at(NoiseLevel(base))
        rows = np.array([row.joint for row in self.balances.rows])
        owner = np.array(
            [-1 if n.joint is None else self.robot.joint_names.index(n.joint) for n in self.nuisance]
        )
        while True:
            far = np.abs(here.deviations(y))
            full = [
                j
                for j in range(len(self.robot.joints))
                if np.max(implausibility[rows == j], initial=0.0)
                >= self.settings.robust_search.most_inflation
            ]
            far[(owner < 0) | np.isin(owner, full) | ~np.isin(owner, rows)] = 0.0
            if not far.size or np.max(far) <= self.settings.regression.plausible:
                break
            implausibility[rows == owner[np.argmax(far)]] *= 2.0
            here = here.at(NoiseLevel(base * implausibility, implausibility.copy()))
        inflation = np.maximum(here.level.inflation, here.variances(y))
        return NoiseLevel(inflation, implausibility)


@dataclass(frozen=True)
class RobustFinding:
    """The selection with the causes that the robust search found, and the problem in which it found them."""

    problem: Problem
    selection: Selection
    notes: tuple[str, ...]


def search_robustly(
    robot: Robot,
    recording: Recording,
    problem: Problem,
    selection: Selection,
    candidates: Sequence[Candidate],
    report: Progress,
) -> RobustFinding | None:
    """The selection with further causes that the simulation confirms, where the usual search left errors
    unexplained. None: there are none, or the recording cannot drive a simulation."""
    here = blunted(robot, recording, problem, selection.best.effects)
    # at other joints the usual search had the same data
    usual = problem.settings.robust_search.disagreeing * problem.readings.noise["q"]
    denied = np.flatnonzero(here.readings.noise["q"] > usual).tolist()
    if not denied:
        return None
    search = _JointSearch(here, candidates)
    best = _still_supported(at_own_level(fit(here, selection.best.effects)))
    before = search.errors(best.effects)
    if before is None:
        return None
    rivals: dict[tuple[str, str | None], tuple[Fit, ...]] = {}
    for k in denied:
        report(k / len(robot.joints), f"searching {robot.joint_names[k]} again")
        found = search.best_of(best, before, k)
        if found is None:
            continue
        best, before, others = found
        rivals[best.effects[-1].key] = others
        beside = search.beside(best, before, k)
        if beside is not None:
            best, before = beside
            rivals[best.effects[-1].key] = ()
    if not rivals:
        return None
    best = _on_all_joints(best, candidates)
    found_first = dict(zip((e.key for e in selection.best.effects), selection.rivals, strict=False))
    together = tuple(rivals.get(e.key, found_first.get(e.key, ())) for e in best.effects)
    nothing = at_own_level(fit(here, []))
    note = "the balances alone did not decide: " + ", ".join(str(e) for e in best.effects if e.key in rivals)
    note += " named because the simulation of the joint needs it"
    return RobustFinding(here, replace(selection, best=best, nothing=nothing, rivals=together), (note,))


@dataclass(frozen=True)
class _Tried:
    """A set with a cause of one joint, and what that does to the joint."""

    fit: Fit
    errors: np.ndarray  # (n,) of the simulation
    lowers: float  # the joint's error in the simulation, by this factor
    cleared: float  # the variance left in its balances, by this one


class _JointSearch:
    """Tries the candidates of one joint after another."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate]) -> None:
        self.problem = problem
        # an effect of a sensor changes no motion, so that the simulation is no evidence for it
        self.candidates = [c for c in candidates if c.joint is not None and c.effect.site is not Site.SENSOR]

    def errors(self, effects: Sequence[Planned]) -> np.ndarray | None:
        """(n,) mean NRMSE of each joint's simulated positions; None: it cannot be simulated."""
        return simulated_errors(self.problem.robot, self.problem.readings.recording, effects)

    def cleared(self, best: Fit, trial: Fit, k: int) -> float:
        """Factor in variance by which a set leaves less in the balances of joint k."""
        rows = np.array([row.joint == k for row in self.problem.balances.rows])
        before, after = (self.problem.free_level(f.y).inflation[rows] for f in (best, trial))
        wrong = before > best.settings.search.wrong
        return float(np.exp(np.mean(np.log(before[wrong] / after[wrong])))) if np.any(wrong) else 1.0

    def best_of(
        self, best: Fit, before: np.ndarray, k: int
    ) -> tuple[Fit, np.ndarray, tuple[Fit, ...]] | None:
        """The set with the cause of joint k that lowers the joint's simulated error most, the errors with it,
        and the other sets that lower it clearly. Where the simulation does not distinguish some causes
        clearly, the one that leaves least in the balances is taken."""
        limits = best.settings.robust_search
        own = [c for c in self.candidates if c.joint == self.problem.robot.joint_names[k]]
        # an onset is searched over the whole recording, and by chance one fits something small
        scanned = [s for s in Scanner(own).scan(best) if s.removes >= limits.promising and s.since is None]
        found: list[_Tried] = []
        for scored in scanned[: limits.tried]:
            trial = at_own_level(fit(best.problem, [*best.effects, scored.planned()]))
            if degenerate(trial.problem, trial.effects[-1]):
                continue
            cleared = self.cleared(best, trial, k)
            if cleared < limits.cleared:
                continue
            errors = self.errors(trial.effects)
            if errors is None or np.any(errors > limits.disturbed * before):
                continue
            if before[k] >= limits.lowered * errors[k]:
                found.append(_Tried(trial, errors, float(before[k] / errors[k]), cleared))
        if not found:
            return None
        most = max(one.lowers for one in found)
        chosen = max(
            (one for one in found if limits.lowered * one.lowers >= most), key=lambda one: one.cleared
        )
        others = sorted((one for one in found if one is not chosen), key=lambda one: -one.lowers)
        return chosen.fit, chosen.errors, tuple(fit(chosen.fit.problem, one.fit.effects) for one in others)

    def beside(self, best: Fit, before: np.ndarray, k: int) -> tuple[Fit, np.ndarray] | None:
        """Where a dry friction was found and the nominal model lists another one on that joint: the set in
        which that one is fitted, too, and the errors with it, if this clearly improves the simulation. Of two
        dry frictions on one joint, neither is known alone."""
        limits = best.settings.robust_search
        added = best.effects[-1]
        nominal = [e for e in self.problem.nominal if e.joint == added.joint and e.effect.overrides("level")]
        if not added.effect.overrides("level") or len(nominal) != 1 or nominal[0].key == added.key:
            return None
        trial = at_own_level(fit(best.problem, [*best.effects, nominal[0]]))
        errors = self.errors(trial.effects)
        if errors is None or before[k] < limits.lowered_beside * errors[k]:
            return None
        if np.any(errors > limits.disturbed * before):
            return None
        return trial, errors


def simulated_errors(robot: Robot, recording: Recording, effects: Sequence[Planned]) -> np.ndarray | None:
    """(n,) mean NRMSE of each joint's simulated positions, of a recording on its regular clock; None: it
    cannot be simulated."""
    try:
        run = compared(FlexibleJointModel(robot.extended(effects)), recording)
    except OutOfTimeError:
        raise
    except FlexJointError:
        return None
    sizes = [
        [run.nrmse[key] for key in (f"q.{joint}", f"theta.{joint}") if key in run.nrmse]
        for joint in robot.joint_names
    ]
    return np.array([np.mean(size) if size else np.nan for size in sizes])


def _still_supported(best: Fit) -> Fit:
    """The set of the usual search without the causes that the data no longer support here, where the link
    encoders are trusted less."""
    for planned in best.effects:
        without = refit_without(best, planned)
        if len(best.effects) > 1 and not supported(best, without, planned):
            return _still_supported(at_own_level(without))
    return best


def _on_all_joints(best: Fit, candidates: Sequence[Candidate]) -> Fit:
    """The set in which a timing cause of several joints is given to all joints, where the data support that
    beside the other causes."""
    for wider in on_all_joints(best, candidates):
        refitted = at_own_level(wider)
        added = refitted.effects[len(best.effects) :]
        without = [refit_without(refitted, one) for one in added]
        if all(supported(refitted, less, one) for less, one in zip(without, added, strict=True)):
            return _on_all_joints(refitted, candidates)
    return best


def blunted(robot: Robot, recording: Recording, first: Recorded, effects: Sequence[Planned]) -> Problem:
    """The recording's problem with link encoders whose noise is as large as what the motors' balances leave
    beside these effects, divided by the stiffness."""
    balances, readings = first.balances, first.readings
    residual = balances.residual(first.with_nominal(effects))
    noise = np.array(readings.noise["q"], dtype=float)
    for row, series in zip(balances.rows, balances.time_series(residual), strict=True):
        joint = robot.joints[row.joint]
        if row.balance == MOTOR and not joint.rigid and np.isfinite(readings.q[row.joint, 0]):
            off = float(np.std(series[readings.valid])) / joint.drive.K
            noise[row.joint] = max(noise[row.joint], off)
    usual = readings.settings
    resting = replace(  # before a real joint slides it creeps
        usual.balances,
        most_at_rest=usual.robust_search.most_at_rest,
        least_rest_speed=usual.balances.rest_speed,
    )
    blunt = replace(readings, noise={**readings.noise, "q": noise}, settings=replace(usual, balances=resting))
    # an error that is no noise must not be filtered out of the torque that a friction holds
    twins = TwinBalances(
        reconstruct(robot, blunt, recording),
        reconstruct(robot, denoised(blunt), recording),
        denoised_rest=False,
    )
    return JointwiseProblem(twins, first.deviation)
