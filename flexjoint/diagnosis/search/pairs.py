"""Two causes of one joint that only together explain what is wrong with it.

A search that adds one cause at a time stops where each of two takes too little by itself to be told from what
else may be wrong: a late torque, where friction also gives way before it slips. So once no single cause is
found, each joint of which a balance is wrong is looked at two causes ahead: the best ones are tried, and
beside each of them the best further one (a beam search: Lowerre 1976).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexjoint.core.running.worker_pool import WorkerPool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level, only_by_implausible, supported
from flexjoint.diagnosis.search.scan import Scanner, Scored
from flexjoint.diagnosis.search.trials import added_to, clears, judged_levels, marked, might_clear


def wrong_joints(best: Fit) -> list[str]:
    """The joints of which a balance is wrong, and that have room for two more causes."""
    problem, limits = best.problem, best.settings.search
    wrong = problem.level.inflation / problem.level.implausibility > limits.wrong
    joints = {row.joint for row, bad in zip(problem.balances.rows, wrong, strict=True) if bad}
    names = [problem.robot.joint_names[joint] for joint in sorted(joints)]
    return [name for name in names if sum(e.joint == name for e in best.effects) + 2 <= limits.most_on_joint]


def joint_pairs(
    best: Fit,
    bare: Fit,
    scanned: Sequence[Scored],
    joints: Sequence[str],
    candidates: Sequence[Candidate],
    pool: WorkerPool,
) -> list[Fit]:
    """Sets of two more causes of one of some joints, each at the noise level that it leaves, that clear most
    of what is wrong with the joint and of which each is supported beside the other. `bare` is the set `best`
    fitted at the level of the predicted noise, and `scanned` the scan of that."""
    taken = {e.key for e in best.effects}
    tasks = []
    for joint in joints:
        own = [c for c in candidates if c.joint == joint and acts_within_a_joint(c) and c.key not in taken]
        firsts = [s for s in scanned if s.candidate.joint == joint and acts_within_a_joint(s.candidate)]
        for first in firsts[: best.settings.search.paired]:
            tasks.append((best, bare, first, tuple(c for c in own if c.key != first.candidate.key)))
    return [f for f in pool.map(_paired, tasks) if f is not None]


def _paired(task: tuple[Fit, Fit, Scored, Sequence[Candidate]]) -> Fit | None:
    """A set with a cause and the best one beside it with which it makes a pair (`_together`)."""
    best, bare, first, others = task
    one = added_to(bare, replace(first, since=None), finely=False)
    scanned = () if one is None or not others else Scanner(others).scan(one)
    for second in scanned[: best.settings.search.paired]:
        if one is not None and might_clear(best, one, second):
            both = _together(best, one, first, second)
            if both is not None:
                return both
    return None


def _together(best: Fit, one: Fit, first: Scored, second: Scored) -> Fit | None:
    """The set `one`, which has a first cause more than `best`, with a second one, at its own noise level;
    None where the two do not clear most of what is wrong, or one of them is not supported beside the other.
    What acts for a while only is no cause of such a pair: among so many starts and ends, one fits by
    chance."""
    trial = added_to(one, replace(second, since=None), finely=False)
    if trial is None:
        return None
    new = len(trial.effects) - len(best.effects)
    if not clears(best, trial.problem.variances(trial.y), marked(trial, new)):
        return None
    both = at_own_level(trial, trial.effects[-1])
    if not clears(best, judged_levels(best, both), marked(both, new)) or only_by_implausible(both, best):
        return None
    keys = {first.candidate.key, second.candidate.key}
    causes = [e for e in both.effects if e.key in keys]
    return both if all(supported(both, refit_without(both, e), e) for e in causes) else None
