"""Each joint of which a set leaves more than a background, by itself.

The usual search weighs a cause against everything that is left, on all joints together, and as noise of which
only some samples are independent. On a real machine every joint has errors of its own: what is wrong with a
light wrist is then nothing beside what a base leaves. So in the end each such joint is looked at by itself,
beside the causes of the others as they are. A set of causes for it is kept if it lowers the joint's torque
error by more than a background makes, on blocks of time that its fit did not see (cross-validation: Stone
1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.running.budget import Budget, OutOfTimeError, checkpoint, within
from flexjoint.core.running.worker_pool import WorkerPool, worker_pool
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.recorded import Recorded
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.history import steps_between
from flexjoint.diagnosis.search.rivals import Rivals
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import Settings, VerdictSettings
from flexjoint.diagnosis.verdict.unseen.torques import (
    Unseen,
    joint_left,
    joint_uncorrected,
    unseen,
    unseen_problem,
)
from flexjoint.effects import Planned, catalogue

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class JointSet:
    """The causes of one joint, what they leave on blocks that their fit did not see, and their rivals."""

    effects: tuple[Planned, ...]
    left: float  # N m, RMS of the joint's torque error, ...
    balances: tuple[float, ...]  # ... and of each of its balances
    rivals: tuple[tuple[tuple[Planned, ...], ...], ...] = ()  # by effect: sets with another one in its place


@dataclass(frozen=True)
class Question:
    """Which causes of one joint explain what the set `best` leaves of it?"""

    best: Fit
    seen: Problem  # the blocks that fits see
    candidates: tuple[Candidate, ...]  # of the joint
    joint: Remaining

    @property
    def others(self) -> list[Planned]:
        return [e for e in self.best.effects if e.joint != self.joint.joint]

    @property
    def own(self) -> list[Planned]:
        return [e for e in self.best.effects if e.joint == self.joint.joint]

    def clears(self, new: JointSet) -> bool:
        """Whether a set clears the joint's torque, or one of its balances, by more than a background, and
        makes none of them worse; nor far worse the joint's torque beside the nominal numbers as they are,
        which an extended model has. With all numbers of a joint off together a wrong torque fits: what it
        moves is then too light, and rubs too little."""
        old, joint = self.measured(self.own), self.joint
        if not clears(joint, (old.left, *old.balances), (new.left, *new.balances), self.seen.settings):
            return False
        sets = (self.own, new.effects)
        before, after = (joint_uncorrected(self.seen, [*self.others, *own], joint.joint) for own in sets)
        return after <= self.seen.settings.verdict.spoilt * before

    def measured(self, own: Sequence[Planned]) -> JointSet:
        """A set of causes of the joint, fitted beside those of other joints as they are."""
        others = self.others
        result = fit(self.seen, [*others, *own], held=others)
        left, balances = joint_left(result, self.joint.joint)
        return JointSet(tuple(e for e in result.effects if e.joint == self.joint.joint), left, balances)


@dataclass(frozen=True)
class Stage:
    """A way to look for causes of one joint."""

    name: str  # in the trace
    what: str  # for which is looked, in what is reported of the progress
    why: str  # a cause is added
    tries: Callable[[Candidate], bool]
    open_joints: Callable[[Unseen], tuple[Remaining, ...]]  # that it looks at
    find: Callable[[Question], JointSet | None]  # a function of a module; None: nothing stands out
    holds: Callable[[Remaining, Unseen, Unseen], bool]  # what was found of a joint, beside all others


LATE = "the time allowed was over before each joint of which much is left was looked at by itself"


def joint_by_joint(
    selection: Selection,
    candidates: Sequence[Candidate],
    stage: Stage,
    workers: int,
    budget: Budget,
    report: Progress,
) -> Selection:
    """The selection with what a stage finds on the joints that are open; its trace is how that came about.
    Where the `budget` is spent before that, with what whole rounds found until then; `left_out` says so."""
    candidates = [c for c in candidates if stage.tries(c)]
    if not candidates:
        return selection
    looked = _Looked(selection)
    with within(budget):
        try:
            _look(looked, candidates, stage, workers, report)
        except OutOfTimeError:
            found = looked.selection
            return replace(found, left_out=tuple(dict.fromkeys((*found.left_out, LATE))))
    return looked.selection


@dataclass
class _Looked:
    """The selection after the last round."""

    selection: Selection


def _look(
    looked: _Looked, candidates: Sequence[Candidate], stage: Stage, workers: int, report: Progress
) -> None:
    """One round after another, until none finds anything."""
    first = looked.selection
    checkpoint()
    data, seen = unseen(first.best, first.nothing), unseen_problem(first.best.problem)
    if not stage.open_joints(data):
        return
    selection = replace(first, trace=())
    left: dict[str, float] = {}  # N m, of a joint when it was looked at
    shared = [*seen.shared(), *first.best.problem.shared(), *catalogue().values(), *candidates]
    with worker_pool(shared, workers) as pool:
        while True:
            # what acts on two joints may have given way to a cause of one: more is left of the other
            open_joints = [
                one
                for one in stage.open_joints(data)
                if one.joint not in left or stands_out(seen, one, left[one.joint])
            ]
            left |= {one.joint: one.after for one in open_joints}
            questions = [
                Question(selection.best, seen, tuple(c for c in candidates if c.joint == one.joint), one)
                for one in open_joints
            ]
            found = _answers(questions, stage, pool, report)
            if not found:
                break
            larger = _joined(selection, found, stage)
            after = unseen(larger.best, larger.nothing)
            # beside all others and their tolerances some of it may be less than it was by itself
            kept = [one.joint for one in open_joints if stage.holds(one, data, after)]
            if not found.keys() <= set(kept):
                found = {joint: found[joint] for joint in kept if joint in found}
                if not found:
                    break
                larger = _joined(selection, found, stage)
                after = unseen(larger.best, larger.nothing)
            selection, data = larger, after
            looked.selection = larger


def _answers(
    questions: Sequence[Question], stage: Stage, pool: WorkerPool, report: Progress
) -> dict[str, JointSet]:
    """The causes of each joint where some were found."""
    found: dict[str, JointSet] = {}
    for k in range(0, len(questions), pool.size):
        now = questions[k : k + pool.size]
        report(k / len(questions), f"looking for {stage.what} of {', '.join(q.joint.joint for q in now)}")
        for question, answer in zip(now, pool.map(stage.find, now), strict=True):
            if answer is not None:
                found[question.joint.joint] = answer
    return found


def _joined(selection: Selection, found: dict[str, JointSet], stage: Stage) -> Selection:
    """The selection with what was found in the place of these joints' causes, at its own noise level."""
    best = selection.best
    others = [e for e in best.effects if e.joint not in found]
    grown = at_own_level(fit(best.problem, [*others, *(e for one in found.values() for e in one.effects)]))
    trace = (*selection.trace, *steps_between(best, grown, stage.name, "background", stage.why))
    known = dict(zip((e.key for e in grown.effects), selection.rivals_beside(grown), strict=True))
    for one in found.values():
        known |= {e.key: Rivals(grown, e.key, ()) for e in one.effects}
        for e, sets in zip(one.effects, one.rivals, strict=False):
            known[e.key] = Rivals.of(grown, e.key, [[*others, *own] for own in sets])
    rivals = tuple(known[e.key] for e in grown.effects)
    return replace(selection, best=grown, rivals=rivals, trace=trace)


def clears(joint: Remaining, before: Sequence[float], after: Sequence[float], settings: Settings) -> bool:
    """Whether the torque of a joint or one of its balances [N m, RMS of what is left] is lower by more than a
    background makes, and none is higher by more."""
    usual = settings.verdict.background_typical * joint.torque
    pairs = list(zip(before, after, strict=True))
    if any(now**2 > then**2 + min(usual, then) ** 2 for then, now in pairs):
        return False
    return any(_stands_out(joint.torque, then, now, settings.verdict) for then, now in pairs)


def stands_out(problem: Recorded, before: Remaining, after: float) -> bool:
    """Whether causes that leave so much of a joint are likely there. What causes of other joints have made
    worse on this one is no evidence of them."""
    least = min(before.before, before.after)
    return _stands_out(before.torque, least, after, problem.settings.verdict)


def _stands_out(torque: float, before: float, after: float, limits: VerdictSettings) -> bool:
    size = float(np.sqrt(max(0.0, before**2 - after**2)))
    return size >= limits.background_even * min(limits.background_typical * torque, after)
