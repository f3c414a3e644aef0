"""Ordinary friction of joints of which a set leaves more than a background.

The search weighs a cause against everything that is left, on all joints together, and as noise of which only
some samples are independent. On a real machine every joint has errors of its own: the friction of a light
wrist is then nothing beside what a base leaves. But every machine has more or less Coulomb and viscous
friction than its nominal model (`Effect.ordinary`), and it is asked for by itself: joint by joint, by the
torque that is left on blocks of time which the fit did not see (cross-validation: Stone 1974). It must lower
that by more than a background makes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.running.budget import Budget
from flexjoint.core.running.worker_pool import WorkerPool, worker_pool
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level, score
from flexjoint.diagnosis.search.history import steps_between
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.verdict.unseen import (
    beyond_background,
    joint_left,
    remaining,
    unseen,
    unseen_problem,
)
from flexjoint.effects import Planned, catalogue

STAGE = "friction"  # in the trace
WHY = "it removes more than a background on data that its fit did not see"
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class JointSet:
    """The causes of one joint, fitted on the blocks that are seen, and what they leave on the others."""

    effects: tuple[Planned, ...]
    left: float  # N m, RMS of the joint's torque error, ...
    balances: tuple[float, ...]  # ... and of each of its balances


def with_friction(
    selection: Selection, candidates: Sequence[Candidate], workers: int, budget: Budget, report: Progress
) -> Selection:
    """The selection with the ordinary friction of the joints of which it leaves more than a background; its
    trace is how that came about."""
    left = remaining(unseen(selection.best, selection.nothing))
    limits = selection.best.settings.verdict
    friction = [c for c in candidates if c.effect.ordinary]
    seen = unseen_problem(selection.best.problem)
    if not friction or not beyond_background(left, limits):
        return selection
    first, selection = selection, replace(selection, trace=())
    changed: set[str] = set()  # joints
    looked: dict[str, float] = {}  # N m, what was left of a joint when it was looked at
    with worker_pool([*seen.shared(), *catalogue().values(), *friction], workers) as pool:
        while not budget.spent:
            # what acts on two joints may have given way to the friction of one: more is left of the other
            open_joints = [
                one
                for one in beyond_background(left, limits)
                if one.joint not in looked or _stands_out(seen, one, looked[one.joint])
            ]
            looked |= {one.joint: one.after for one in open_joints}
            found = _each_joint(seen, selection.best.effects, open_joints, friction, pool, budget, report)
            if not found:
                break
            larger = _joined(selection, found)
            after = remaining(unseen(larger.best, larger.nothing))
            # beside all others and their tolerances some of it may be less than it was by itself
            less = {one.joint: one.after for one in after}
            kept = [one.joint for one in open_joints if _stands_out(seen, one, less[one.joint])]
            if not found.keys() <= set(kept):
                found = {joint: found[joint] for joint in kept if joint in found}
                if not found:
                    break
                larger = _joined(selection, found)
                after = remaining(unseen(larger.best, larger.nothing))
            selection, changed, left = larger, changed | found.keys(), after
    if not changed:
        return first
    rivals = [[_beside(rival, selection.best, changed) for rival in fits] for fits in selection.rivals]
    return replace(selection, rivals=tuple(tuple(sorted(fits, key=score)) for fits in rivals))


def _joined(selection: Selection, found: dict[str, JointSet]) -> Selection:
    """The selection with what was found in the place of these joints' causes, at its own noise level."""
    best = selection.best
    others = [e for e in best.effects if e.joint not in found]
    grown = at_own_level(fit(best.problem, [*others, *(e for one in found.values() for e in one.effects)]))
    trace = (*selection.trace, *steps_between(best, grown, STAGE, "background", WHY))
    # a rival is a fit beside the causes that a joint had
    known = dict(zip((e.key for e in best.effects), selection.rivals, strict=False))
    rivals = tuple(() if e.joint in found else known.get(e.key, ()) for e in grown.effects)
    return replace(selection, best=grown, rivals=rivals, trace=trace)


def _beside(rival: Fit, best: Fit, changed: set[str]) -> Fit:
    """A rival of a cause, fitted again beside the causes that joints which have `changed` have now."""
    *others, last = rival.effects
    new = [e for e in best.effects if e.joint in changed]
    kept = [e for e in others if e.joint not in changed]
    return fit(best.problem, [*kept, *new, last], held=new)


def _stands_out(problem: Problem, before: Remaining, after: float) -> bool:
    """Whether friction that leaves so much of a joint is likely there. What causes of other joints have made
    worse on this one is no evidence of it."""
    size = float(np.sqrt(max(0.0, min(before.before, before.after) ** 2 - after**2)))
    limits = problem.settings.verdict
    return size >= limits.background_even * min(limits.background_typical * before.torque, after)


def _each_joint(
    seen: Problem,
    effects: Sequence[Planned],
    joints: Sequence[Remaining],
    friction: Sequence[Candidate],
    pool: WorkerPool,
    budget: Budget,
    report: Progress,
) -> dict[str, JointSet]:
    """The causes with friction of each joint where some was found."""
    found: dict[str, JointSet] = {}
    tasks = [(seen, effects, [c for c in friction if c.joint == one.joint], one) for one in joints]
    for k in range(0, len(tasks), pool.size):
        if budget.spent:
            break
        now = tasks[k : k + pool.size]
        report(k / len(tasks), f"looking for friction of {', '.join(one.joint for *_, one in now)}")
        for (*_, one), new in zip(now, pool.map(_of_joint, now), strict=True):
            if new is not None:
                found[one.joint] = new
    return found


def _of_joint(task: tuple[Problem, Sequence[Planned], Sequence[Candidate], Remaining]) -> JointSet | None:
    """The causes of a joint with ordinary friction beside them or, if that leaves no more, instead of them,
    without what of it does not stand out; None where none does. Causes of other joints are held."""
    seen, effects, candidates, joint = task
    others = [e for e in effects if e.joint != joint.joint]
    own = [e for e in effects if e.joint == joint.joint]

    def measured(own: Sequence[Planned]) -> JointSet:
        result = fit(seen, [*others, *own], held=others)
        left, balances = joint_left(result, joint.joint)
        return JointSet(tuple(e for e in result.effects if e.joint == joint.joint), left, balances)

    missing = _started(fit(seen, [*others, *own], held=others), candidates)
    if not missing:
        return None
    best = measured([*own, *missing])
    if own:
        alone = measured([*(e for e in own if e.effect.ordinary), *missing])
        if _alike(seen, joint, alone, best):
            best = alone
    for added in missing:
        if not _stands_out(seen, joint, best.left):
            return None
        without = measured([e for e in best.effects if e.key != added.key])
        if not _stands_out(seen, replace(joint, after=without.left), best.left):
            best = without
    kept = any(e.key in {one.key for one in missing} for e in best.effects)
    return best if kept and _stands_out(seen, joint, best.left) else None


def _started(here: Fit, candidates: Sequence[Candidate]) -> list[Planned]:
    """Candidates that a set has not, at their best starts beside it. An onset is searched over the whole
    recording, and by chance one fits something small: here friction acts all the time."""
    taken = {e.key for e in here.effects}
    scanned = Scanner([c for c in candidates if c.key not in taken]).scan(here)
    return [replace(one, since=None).planned() for one in scanned]


def _alike(problem: Problem, joint: Remaining, one: JointSet, best: JointSet) -> bool:
    """Whether a set leaves more than another by less than a background, in any balance too: what moves torque
    from a motor to its link and back leaves their sum as it is."""
    usual = problem.settings.verdict.background_typical * joint.torque
    pairs = zip((one.left, *one.balances), (best.left, *best.balances), strict=True)
    return all(left**2 <= least**2 + min(usual, least) ** 2 for left, least in pairs)
