"""Two causes of one joint that only together explain what is wrong with it.

A search that adds one cause at a time stops where each of two takes too little by itself to be told from what
else may be wrong: a late torque, where friction also gives way before it slips. So once no single cause is
found, each joint of which a balance is wrong is looked at two causes ahead: the best ones are tried, and
beside each of them the best further ones (a beam search: Lowerre 1976).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.core.running.budget import checkpoint
from flexjoint.core.running.worker_pool import WorkerPool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import at_own_level, only_by_implausible, supported
from flexjoint.diagnosis.search.rivals import Key
from flexjoint.diagnosis.search.scan import Scanner, Scored
from flexjoint.diagnosis.search.trials import added_to, cleared, clears, judged_levels, marked, might_clear


def joint_pairs(
    best: Fit,
    bare: Fit,
    scanned: Sequence[Scored],
    joints: Sequence[str],
    candidates: Sequence[Candidate],
    pool: WorkerPool,
) -> list[Fit]:
    """Sets with the two causes of one of some joints that clear most of what is wrong with it, each at the
    noise level that it leaves. `bare` is the set `best` fitted at the level of the predicted noise, and
    `scanned` the scan of that. Joints without room for two more causes are left out."""
    tasks, most = [], best.settings.search.most_on_joint
    for joint in joints:
        if sum(e.joint == joint for e in best.effects) + 2 > most:
            continue
        own = tuple(c for c in candidates if c.joint == joint and acts_within_a_joint(c))
        firsts = [s for s in scanned if s.candidate.joint == joint and acts_within_a_joint(s.candidate)]
        tasks.append((best, bare, tuple(firsts[: best.settings.search.paired]), own))
    return [f for f in pool.map(_pair, tasks) if f is not None]


def _pair(task: tuple[Fit, Fit, Sequence[Scored], Sequence[Candidate]]) -> Fit | None:
    """The pair of causes of a joint that clears most of what is wrong with it, at the noise level that it
    leaves; None where none clears enough there, or has two causes of which each is supported beside the
    other."""
    best, bare, firsts, candidates = task
    trials = _trials(best, bare, firsts, candidates)
    shares = [cleared(best, bare.problem.variances(f.y), _new(best, f)) for _, f in trials]
    for share, (keys, trial) in sorted(zip(shares, trials, strict=True), key=lambda one: -one[0]):
        if share < np.log(best.settings.search.cleared):
            break
        both = at_own_level(trial, trial.effects[-1])
        if not clears(best, judged_levels(best, both), _new(best, both)) or only_by_implausible(both, best):
            continue
        causes = [e for e in both.effects if e.key in keys]
        if all(supported(both, refit_without(both, e), e) for e in causes):
            return both
    return None


def _trials(
    best: Fit, bare: Fit, firsts: Sequence[Scored], candidates: Sequence[Candidate]
) -> list[tuple[set[Key], Fit]]:
    """Sets with one of some causes and one of the best of the joint beside it, fitted at the level of the
    predicted noise, with the keys of the two. What acts for a while only is no cause of a pair: among so many
    starts and ends, one fits by chance."""
    out: list[tuple[set[Key], Fit]] = []
    for first in firsts:
        checkpoint()
        one = added_to(bare, replace(first, since=None), finely=False)
        if one is None:
            continue
        taken = {e.key for e in one.effects}
        scanned = Scanner([c for c in candidates if c.key not in taken]).scan(one)
        for second in scanned[: best.settings.search.paired]:
            keys = {first.candidate.key, second.candidate.key}
            if any(keys == known for known, _ in out) or not might_clear(best, one, second):
                continue
            trial = added_to(one, replace(second, since=None), finely=False)
            if trial is not None:
                out.append((keys, trial))
    return out


def _new(best: Fit, larger: Fit) -> np.ndarray:
    """(rows,) bool: the balances that the effects change that a larger set has at its end."""
    return marked(larger, len(larger.effects) - len(best.effects))
