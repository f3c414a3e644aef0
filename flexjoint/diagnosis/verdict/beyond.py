"""Causes within single joints that stand out of a machine's background, where a set leaves more than that.

The search weighs a cause against everything that is left, on all joints together, and as noise of which only
some samples are independent. On a real machine every joint has errors of its own: the friction of a light
wrist is then nothing beside what a base leaves. So every joint of which more is left than a background is
looked at by itself, and what counts is the torque that is left on blocks of time which the fit did not see
(cross-validation: Stone 1974). A cause must lower it by more than a background makes; of laws that differ by
less, the simplest is taken. Ordinary friction comes first: every machine has more or less of it than its
nominal model, and other laws would stand in for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.running.budget import Budget
from flexjoint.core.running.worker_pool import WorkerPool, worker_pool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level, degenerate, price, score
from flexjoint.diagnosis.search.history import steps_between
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Key, Selection
from flexjoint.diagnosis.verdict.unseen import (
    beyond_background,
    joint_left,
    remaining,
    unseen,
    unseen_problem,
)
from flexjoint.effects import Planned, catalogue

STAGE = "background"  # in the trace
AGAIN = 1.1  # times what was left of a joint when it was looked at, from which it is looked at again

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class JointSet:
    """The causes of one joint as they are fitted on the blocks that are seen, with what they leave on the
    others, and the other sets that differ by less than a background."""

    joint: str
    effects: tuple[Planned, ...]
    left: float  # N m, RMS of the joint's torque, ...
    balances: tuple[float, ...]  # ... and of each of its balances
    rivals: tuple[tuple[Planned, ...], ...] = ()  # of the last effect: in its place


def completed(
    selection: Selection, candidates: Sequence[Candidate], workers: int, budget: Budget, report: Progress
) -> Selection:
    """The selection with further causes of the joints of which it leaves more than a background; its trace is
    how these came about."""
    best = selection.best
    open_joints = beyond_background(remaining(unseen(best, selection.nothing)), best.settings.verdict)
    if not open_joints:
        return selection
    seen = unseen_problem(best.problem)
    shared = [*seen.shared(), *catalogue().values(), *candidates]
    selection = replace(selection, trace=())
    looked: dict[str, float] = {}  # what was left of a joint when it was looked at
    with worker_pool(shared, workers) as pool:
        while open_joints and not budget.spent:
            joints = [one.joint for one in open_joints]
            found = _each_joint(seen, selection.best.effects, joints, candidates, pool, budget, report)
            if not found:
                break
            selection = _with_found(selection, found)
            left = remaining(unseen(selection.best, selection.nothing))
            looked |= {one.joint: one.after for one in open_joints}
            looked |= {one.joint: one.after for one in left if one.joint in {new.joint for new in found}}
            # what acts on two joints may have given way to what acts on one
            open_joints = tuple(
                one
                for one in beyond_background(left, best.settings.verdict)
                if one.after > AGAIN * looked.get(one.joint, 0.0)
            )
    return selection


def _with_found(selection: Selection, found: Sequence[JointSet]) -> Selection:
    """The selection with what was found in the place of these joints' causes, at its own noise level."""
    best, changed = selection.best, {one.joint for one in found}
    others = [e for e in best.effects if e.joint not in changed]
    grown = at_own_level(fit(best.problem, [*others, *(e for one in found for e in one.effects)]))
    why = "it removes more than a background on data that its fit did not see"
    trace = (*selection.trace, *steps_between(best, grown, STAGE, "background", why))
    known = dict(zip((e.key for e in best.effects), selection.rivals, strict=False))
    rivals = {e.key: known.get(e.key, ()) if e.joint not in changed else () for e in grown.effects}
    rivals |= _rivals(grown, found)
    return replace(selection, best=grown, rivals=tuple(rivals[e.key] for e in grown.effects), trace=trace)


def _rivals(grown: Fit, found: Sequence[JointSet]) -> dict[Key, tuple[Fit, ...]]:
    """Of the last cause of each joint, the fits with another one in its place."""
    out: dict[Key, tuple[Fit, ...]] = {}
    for one in found:
        others = [e for e in grown.effects if e.joint != one.joint]
        fits = [fit(grown.problem, [*others, *effects], held=others) for effects in one.rivals]
        out[one.effects[-1].key] = tuple(sorted(fits, key=score))
    return out


def _each_joint(
    seen: Problem,
    effects: Sequence[Planned],
    joints: Sequence[str],
    candidates: Sequence[Candidate],
    pool: WorkerPool,
    budget: Budget,
    report: Progress,
) -> list[JointSet]:
    """What was found on each joint where something was."""
    found: list[JointSet] = []
    tasks = [(seen, effects, _within(candidates, joint), joint) for joint in joints]
    for k in range(0, len(tasks), pool.size):
        if budget.spent:
            break
        now = tasks[k : k + pool.size]
        report(k / len(tasks), f"looking for what is left of {', '.join(joint for *_, joint in now)}")
        found += [one for one in pool.map(_of_joint, now) if one is not None]
    return found


def _within(candidates: Sequence[Candidate], joint: str) -> tuple[Candidate, ...]:
    return tuple(c for c in candidates if c.joint == joint and acts_within_a_joint(c.planned({})))


def _of_joint(task: tuple[Problem, Sequence[Planned], Sequence[Candidate], str]) -> JointSet | None:
    """The causes of a joint with what else stands out of its background; None where nothing does."""
    looked = _Joint(*task)
    first = looked.left_by([e for e in looked.effects if e.joint == looked.joint])
    best = looked.with_friction(first)
    while len(best.effects) < looked.limits.most_on_joint:
        larger = looked.with_another(best)
        if larger is None:
            break
        best = larger
    return None if best is first else best


class _Joint:
    """One joint of a problem of which every second block of time is seen; the others' causes as they are."""

    def __init__(
        self, seen: Problem, effects: Sequence[Planned], candidates: Sequence[Candidate], joint: str
    ) -> None:
        self.seen, self.effects, self.candidates, self.joint = seen, effects, candidates, joint
        self.others = [e for e in effects if e.joint != joint]
        self.limits = seen.settings.search
        torque = seen.torque_scale[seen.robot.joint_names.index(joint)]
        self.usual = seen.settings.verdict.background_typical * float(torque)

    def fitted(self, effects: Sequence[Planned]) -> Fit:
        """The joint's causes fitted beside those of the other joints, which are held."""
        return fit(self.seen, [*self.others, *effects], held=self.others)

    def left_by(self, effects: Sequence[Planned]) -> JointSet:
        return self.measured(self.fitted(effects))

    def measured(self, result: Fit) -> JointSet:
        own = tuple(e for e in result.effects if e.joint == self.joint)
        return JointSet(self.joint, own, *joint_left(result, self.joint))

    def stands_out(self, before: JointSet, after: JointSet) -> bool:
        """Whether what lowers the error of the joint so far is likely there."""
        size = float(np.sqrt(max(0.0, before.left**2 - after.left**2)))
        return size >= self.seen.settings.verdict.background_even * min(self.usual, after.left)

    def alike(self, one: JointSet, best: JointSet) -> bool:
        """Whether a set leaves more than another by less than a background, in any balance too: what moves
        torque from a motor to its link and back leaves their sum as it is."""
        pairs = zip((one.left, *one.balances), (best.left, *best.balances), strict=True)
        return all(left**2 <= least**2 + min(self.usual, least) ** 2 for left, least in pairs)

    def with_friction(self, first: JointSet) -> JointSet:
        """The set with ordinary friction beside its causes or, if that leaves no more, instead of them, and
        without what of it does not stand out. The set itself, if none does."""
        taken = {e.effect.name for e in first.effects}
        friction = [c for c in self.candidates if c.effect.ordinary]
        missing = self._started(first, [c for c in friction if c.effect.name not in taken])
        if not missing:
            return first
        best = self.left_by([*first.effects, *missing])
        if first.effects:
            alone = self.left_by([*(e for e in first.effects if e.effect.ordinary), *missing])
            if self.alike(alone, best):
                best = alone
        if not self.stands_out(first, best):
            return first
        kept = {e.key for e in first.effects}
        for added in [e for e in best.effects if e.key not in kept]:
            without = self.left_by([e for e in best.effects if e.key != added.key])
            if not self.stands_out(without, best):
                best = without
        return best if self.stands_out(first, best) else first

    def with_another(self, first: JointSet) -> JointSet | None:
        """The set with the simplest of the candidates that leave about least, if that stands out."""
        here = self.fitted(first.effects)
        trials: list[tuple[Fit, JointSet]] = []
        for planned in self._started(first, self.candidates)[: self.limits.polished]:
            trial = self.fitted([*first.effects, planned])
            if not degenerate(trial.problem, trial.effects[-1]) and trial.energy < here.energy:
                trials.append((trial, self.measured(trial)))
        trials = [(trial, one) for trial, one in trials if self.stands_out(first, one)]
        if not trials:
            return None
        least = min((one for _, one in trials), key=lambda one: one.left)
        near = [(trial, one) for trial, one in trials if self.alike(one, least)]
        _, chosen = min(near, key=lambda pair: (price(pair[0]), pair[1].left))
        rivals = tuple(one.effects for _, one in near if one is not chosen)
        return replace(chosen, rivals=rivals)

    def _started(self, first: JointSet, candidates: Sequence[Candidate]) -> list[Planned]:
        """Candidates beside a set at their best starts, those that remove most first. An onset is searched
        over the whole recording, and by chance one fits something small: here causes act all the time."""
        scanned = Scanner(candidates).scan(self.fitted(first.effects))
        return [replace(one, since=None).planned() for one in scanned]
