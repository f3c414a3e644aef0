"""Diagnosis: what a simulation gets wrong, and why.

recording -> are the data right? -> readings -> motion -> balances -> whitening -> selection -> verdict
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from flexjoint.core.errors import RecordingError, unknown
from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, within
from flexjoint.core.running.worker_pool import one_thread, workers_of
from flexjoint.diagnosis.balances.balances import TwinBalances, balances_of
from flexjoint.diagnosis.balances.usable import refusal
from flexjoint.diagnosis.data import check
from flexjoint.diagnosis.regression.deviations import about_likely_links
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import Errors
from flexjoint.diagnosis.result import DataFinding, Diagnosis, Finding, Remaining, Step, Unexplained
from flexjoint.diagnosis.result.wording import effect_name, signal_name
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates
from flexjoint.diagnosis.search.history import steps_between
from flexjoint.diagnosis.search.robust_search import JointwiseProblem, search_robustly
from flexjoint.diagnosis.search.robust_together import confirmed
from flexjoint.diagnosis.search.selection import Key, Selection, select
from flexjoint.diagnosis.search.together import combine
from flexjoint.diagnosis.settings import USUAL, Settings, VerdictSettings
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.diagnosis.verdict import checks, verdict
from flexjoint.diagnosis.verdict.cases import Case, SimulatedCase, StatedCase
from flexjoint.diagnosis.verdict.experiment import advice
from flexjoint.diagnosis.verdict.joints.by_itself import joint_by_joint
from flexjoint.diagnosis.verdict.joints.friction import FRICTION
from flexjoint.diagnosis.verdict.joints.search import JOINT_SEARCH
from flexjoint.diagnosis.verdict.residuals import explained_share, residual_views, unexplained_balances
from flexjoint.diagnosis.verdict.review import notes, reviewed
from flexjoint.diagnosis.verdict.unseen.torques import standing_out
from flexjoint.effects import catalogue
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording, expect_several
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot, expect

NO_EFFECT = "no effect in the catalogue explains it"
BEATS = "beats the sensors' noise and the model's own tolerances"
SEARCHED = 0.92  # share of the progress that the searches are
ROBUST_LATE = "the time allowed was over before the robust search, where that is needed, was done"

Progress = Callable[[float, str], None]


@one_thread
def diagnose(
    robot: Robot,
    recordings: Recording | Sequence[Recording],
    *,
    progress: Progress | None = None,
    excluded: frozenset[str] = frozenset(),
    payloads: Sequence[KnownPayload | None] = (),
    refine: bool = True,
    check_data: bool = True,
    workers: int | None = None,
    settings: Settings = USUAL,
    budget: Budget = UNLIMITED,
) -> Diagnosis:
    """Name what the nominal model gets wrong on the recordings; measure the gain on held-out blocks of the
    first, whose residuals and onsets are the ones reported.

    Args:
        robot: the nominal model with its tolerances.
        recordings: one or several; several are explained together, by one set of causes and numbers.
        progress: called with a share in [0, 1] and what is being done.
        excluded: names of effects that are left out of the catalogue.
        payloads: what was added to the robot in each recording and is known (None: nothing); empty: nothing
            in any. It is part of that recording's nominal model; the causes are common to all.
        refine: whether the numbers of the causes are refined on the simulation itself (one recording).
        check_data: whether signs, zeros, units and names that cannot be right end the diagnosis (verdict
            refused, `Diagnosis.data` says which); without, they are listed, and it goes on regardless.
        workers: processes that share the search, FLEXJOINT_WORKERS or one per core by default; the bits are
            the same for any number.
        settings: the numbers that decide (docs/reference/settings.md).
        budget: the time that it may take. What is looked at of a recording is then no more than a search
            takes in that time, and what is not yet done when it is over is left out; notes say so.

    Raises:
        ModelError: fewer than one worker.
        RecordingError: the recording cannot be used with this robot, or not one payload for each.
        UnknownNameError: an excluded name is no effect, or a payload's joint is none of the robot's.
    """
    task = _Task(excluded, workers_of(workers), settings, progress or (lambda _share, _what: None), budget)
    robots, recordings = _checked(robot, recordings, excluded, payloads)
    data = _data_errors(robots, recordings, settings)
    if data and check_data:
        return _with_wrong_data(robots[0], data)
    recordings, cut = excerpts(robots[0], recordings, budget.seconds)
    task.report(0.0, "preparing the balances")
    refused, balances = _balanced(robots[0], recordings[0], settings)
    if refused:
        return Diagnosis(
            "refused", refused, notes=cut, robot=robots[0].name, prismatic=robots[0].prismatic, data=data
        )
    problem = about_likely_links(Problem(balances))
    candidates = enumerate_candidates(problem, excluded)
    first = _searched(problem, candidates, task.part(0, len(recordings)))
    case, spread, common = _combined(first, robots, recordings, task)
    task.report(0.92, "measuring the gain on held-out data")
    case = reviewed(_simulated(case, robots[0], recordings[0], problem, task), checks.SIMULATION)
    case, robust = _searched_robustly(case, candidates, robots, recordings, task)
    case = reviewed(_joint_by_joint(case, candidates, len(recordings), task), checks.SIMULATION)
    stated = reviewed(_stated(case, spread, refine, len(recordings), task), checks.FINDINGS)
    known = _known(recordings, payloads)
    checked = [notes(stated.trace[a:b]) for a, b in pairwise((0, len(first.trace), len(case.trace), None))]
    left_out = stated.selection.left_out
    said = (*left_out, *checked[0], *common, *cut, *known, *checked[1], *robust, *checked[2])
    return replace(_diagnosis(stated, candidates, said, task), data=data)


@dataclass(frozen=True)
class _Task:
    """What is asked of every recording."""

    excluded: frozenset[str]
    workers: int
    settings: Settings
    report: Progress
    budget: Budget

    def part(self, k: int, count: int) -> _Task:
        """The task for one of `count` recordings, with its share of the progress and of the time."""
        share = SEARCHED / count
        budget = self.budget.part(self.settings.search.time * (k + 1) / count)
        return replace(self, report=_part(self.report, k * share, share), budget=budget)


def _checked(
    robot: Robot,
    recordings: Recording | Sequence[Recording],
    excluded: frozenset[str],
    payloads: Sequence[KnownPayload | None],
) -> tuple[list[Robot], list[Recording]]:
    """The nominal robot of each recording, and the recordings with the torques of their currents."""
    robot, recordings = expect(robot, "diagnose"), expect_several(recordings, "diagnose")
    _check_names(excluded)
    robots = _loaded(robot, recordings, payloads)
    return robots, [of_robot(robot, recording) for recording in recordings]


def _data_errors(
    robots: Sequence[Robot], recordings: Sequence[Recording], settings: Settings
) -> tuple[DataFinding, ...]:
    """What of the data cannot be right; what is wrong with the robot itself is said once."""
    found: list[DataFinding] = []
    for robot, recording in zip(robots, recordings, strict=True):
        new = check.data_errors(robot, recording, settings.data)
        found += [f for f in new if f.columns or all(f.text != other.text for other in found)]
    return tuple(found)


def _with_wrong_data(robot: Robot, data: tuple[DataFinding, ...]) -> Diagnosis:
    """No verdict on the machine: any cause that is named would stand for the error of the data."""
    more = f", and {len(data) - 1} more errors of the data" if len(data) > 1 else ""
    reason = f"the data cannot be right: {data[0].text}{more}"
    rigid = all(joint.rigid for joint in robot.joints)
    return Diagnosis("refused", reason, robot=robot.name, prismatic=robot.prismatic, rigid=rigid, data=data)


def _balanced(robot: Robot, recording: Recording, settings: Settings) -> tuple[str, TwinBalances]:
    """The balances of a recording, and why they cannot carry a verdict; empty when they can."""
    balances = balances_of(robot, recording, settings)
    return refusal(balances), balances


def _searched(problem: Problem, candidates: Sequence[Candidate], task: _Task) -> Case:
    """The set of causes that explains a recording by itself, as far as its balances support it."""
    selection = select(problem, candidates, task.report, workers=task.workers, budget=task.budget)
    case = Case(selection, selection.trace)
    return reviewed(reviewed(case, checks.BALANCES), checks.NAMES)


def _combined(
    first: Case, robots: Sequence[Robot], recordings: Sequence[Recording], task: _Task
) -> tuple[Case, Mapping[Key, Errors], tuple[str, ...]]:
    """The set that explains all recordings, standard errors from all of them, and notes."""
    if len(recordings) == 1:
        return first, {}, ()
    selections = [first.selection]
    for k, recording in enumerate(recordings[1:], start=1):
        refused, balances = _balanced(robots[k], recording, task.settings)
        if refused:
            raise RecordingError(f"{recording.name} cannot be diagnosed together with the others: {refused}")
        problem = about_likely_links(Problem(balances))
        candidates = enumerate_candidates(problem, task.excluded)
        selections.append(_searched(problem, candidates, task.part(k, len(recordings))).selection)
    together = combine(selections)
    steps = steps_between(
        first.selection.best, together.selection.best, "recordings", "common set", "for all recordings"
    )
    left_out = tuple(dict.fromkeys(one for selection in selections for one in selection.left_out))
    selection = replace(together.selection, left_out=left_out)
    return Case(selection, (*first.trace, *steps)), together.errors, together.notes


def _simulated(
    case: Case, robot: Robot, recording: Recording, problem: Problem, task: _Task
) -> SimulatedCase:
    budget = task.budget.part(task.settings.search.looking_time)
    return SimulatedCase(case.selection, case.trace, robot, recording, problem, budget=budget).simulated()


def _searched_robustly(
    case: SimulatedCase,
    candidates: Sequence[Candidate],
    robots: Sequence[Robot],
    recordings: Sequence[Recording],
    task: _Task,
) -> tuple[SimulatedCase, tuple[str, ...]]:
    """The case with causes that the simulation confirms, that of every recording, where only implausible
    nominal numbers would explain an error of the first, and notes."""
    budget = task.budget.part(task.settings.search.looking_time)
    if budget.spent:
        return case, (ROBUST_LATE,)
    if case.measured is None or not _undecided(case.selection):
        return case, ()
    report = _part(task.report, SEARCHED, 0.02)
    try:
        with within(budget):
            again = search_robustly(
                case.robot, case.recording, case.problem, case.selection, candidates, report
            )
            if again is not None and len(recordings) > 1:
                again = confirmed(again, case.selection, robots[1:], recordings[1:])
    except OutOfTimeError:
        return case, (ROBUST_LATE,)
    if again is None:
        return case, ()
    why = "the simulation of the joint needs it"
    steps = steps_between(
        case.selection.best, again.selection.best, "robust search", "simulation of the joint", why
    )
    found = replace(case, problem=again.problem, selection=again.selection, trace=(*case.trace, *steps))
    return found.simulated(), again.notes


def _joint_by_joint(
    case: SimulatedCase, candidates: Sequence[Candidate], count: int, task: _Task
) -> SimulatedCase:
    """The case with what is found on the joints of which it leaves much, of the only recording: ordinary
    friction, and what a search of such a joint by itself finds. Where link encoders are not trusted, the
    robust search has looked at each joint by itself already."""
    if count > 1:
        return case
    selection, report = case.selection, _part(task.report, SEARCHED + 0.02, 0.01)
    trusted = not isinstance(case.problem, JointwiseProblem)
    trace: tuple[Step, ...] = ()
    for stage in (FRICTION, JOINT_SEARCH) if trusted else (FRICTION,):
        before, budget = selection, task.budget.part(task.settings.search.looking_time)
        selection = joint_by_joint(selection, candidates, stage, task.workers, budget, report)
        trace += selection.trace if selection.best is not before.best else ()
    found = replace(case, selection=selection, trace=(*case.trace, *trace))
    return found if selection.best is case.selection.best else found.simulated()


def _stated(
    case: SimulatedCase, spread: Mapping[Key, Errors], refine: bool, count: int, task: _Task
) -> StatedCase:
    kept = "several recordings share their numbers" if count > 1 else ""
    return StatedCase(
        case.selection,
        case.trace,
        case.robot,
        case.recording,
        case.problem,
        case.measured,
        kept=kept if refine else "no refinement was asked for",
        workers=task.workers,
        spread=spread,
        report=task.report,
        refining=task.budget,
        budget=case.budget,
        late=case.late,
    )


def _diagnosis(
    case: StatedCase,
    candidates: Sequence[Candidate],
    said: tuple[str, ...],
    task: _Task,
) -> Diagnosis:
    """What a reviewed case says."""
    selection, best = case.selection, case.selection.best
    named, estimation = case.estimated
    limits, joints = task.settings.verdict, case.remaining
    found = verdict.merged(named, candidates, best)
    rigid = all(joint.rigid for joint in case.robot.joints)
    shaped = standing_out(joints, limits)
    kind, reason = _verdict(found, case.left, case.explained, shaped, limits, rigid, bool(selection.left_out))
    blind = verdict.not_excited(selection, candidates)
    task.report(1.0, "done")
    return Diagnosis(
        verdict=kind,  # type: ignore[arg-type]
        reason=reason,
        findings=found,
        unexplained=case.left,
        remaining=joints,
        not_excited=blind,
        within_tolerance=verdict.within_tolerance(best),
        comparison=case.against_noise,
        next_experiment=advice(case.robot, case.recording, found, case.left, blind),
        ranking=verdict.ranking(selection),
        residuals=case.residuals,
        explained=case.explained,
        notes=(*said, *case.late, *case.notes, *verdict.not_believed(best), *verdict.to_state(best, found)),
        energy=(
            float(np.mean(selection.nothing.problem.level.inflation)),
            float(np.mean(best.problem.level.inflation)),
        ),
        estimation=estimation,
        trace=(*case.trace, *_kept(found)),
        robot=case.robot.name,
        prismatic=case.robot.prismatic,
        rigid=rigid,
    )


def _kept(found: Sequence[Finding]) -> tuple[Step, ...]:
    """The last steps: joints' findings that are one of the robot's, and those that are reported."""
    out = []
    for f in found:
        for member in f.members:
            shared = f"{member} is one cause of the robot, which all its joints with the sensor share"
            text = shared if f.joint is None else f"{member}: {effect_name(f.effect)} {f.note}"
            out.append(
                Step(
                    "verdict",
                    "merged",
                    f.effect,
                    member.joint,
                    (f.effect, None),
                    "shared",
                    f.probability,
                    text,
                )
            )
        text = f"{f.planned if f.joint else f.effect} is reported with probability {f.probability:.2f}"
        out.append(Step("verdict", "kept", f.effect, f.joint, None, "verdict", f.probability, text))
    return tuple(out)


def _check_names(excluded: frozenset[str]) -> None:
    for name in excluded:
        if name not in catalogue():
            raise unknown("effect", name, catalogue())


def _loaded(
    robot: Robot, recordings: Sequence[Recording], payloads: Sequence[KnownPayload | None]
) -> list[Robot]:
    """The nominal robot of each recording."""
    if payloads and len(payloads) != len(recordings):
        raise RecordingError(
            f"expected a known payload, or None, for each of {len(recordings)} recordings,"
            f" got {len(payloads)}"
        )
    return [robot if load is None else load.on(robot) for load in payloads or [None] * len(recordings)]


def _known(recordings: Sequence[Recording], payloads: Sequence[KnownPayload | None]) -> tuple[str, ...]:
    return tuple(
        f"{recording.name} was recorded with a known payload of {payload}"
        for recording, payload in zip(recordings, payloads, strict=False)
        if payload is not None
    )


def _undecided(selection: Selection) -> bool:
    """Whether an error is left and only implausible nominal numbers would explain it."""
    best = selection.best
    if best.problem.level.implausible <= best.settings.robust_search.begins:
        return False
    residuals = residual_views(best, selection.nothing)
    left = unexplained_balances(best, residuals)
    enough = best.settings.verdict.explained
    return bool(left) and (not best.effects or explained_share(best, residuals) < enough)


def _part(report: Progress, begin: float, share: float) -> Progress:
    """Progress of a part of the work."""
    return lambda done, what: report(begin + share * done, what)


def _verdict(
    found: Sequence[Finding],
    left: Sequence[Unexplained],
    explained: float,
    joints: Sequence[Remaining],
    settings: VerdictSettings,
    rigid: bool,
    late: bool,
) -> tuple[str, str]:
    there = any(f.probability >= settings.likely for f in found)
    named = "the causes named" if there else "the causes found, none of them likely,"
    share = f"{named} explain {100.0 * explained:.0f} % of the error above sensor noise"
    if there and not joints:
        return "causes", share if explained >= settings.explained else f"{share}; the rest has no clear shape"
    if found and joints:
        worst = max(joints, key=lambda joint: joint.after / joint.torque)
        return (
            "unexplained",
            f"{named} leave {worst.after:.3g} N m at {worst.joint},"
            f" {100.0 * worst.after / worst.torque:.0f} % of its torque; it depends most on"
            f" {signal_name(worst.against, rigid)}",
        )
    if found:
        return "unexplained", f"{share}, but what they leave has a shape: another cause may stand behind them"
    if left or joints:
        none = "the time allowed was over before a cause was found" if late else NO_EFFECT
        return "unexplained", f"the error is beyond noise and tolerances, but {none}"
    return "healthy", f"nothing {'that was looked at in the time allowed ' if late else ''}{BEATS}"
