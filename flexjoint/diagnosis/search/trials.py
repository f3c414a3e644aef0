"""Sets with one effect more than the current one: fitted, dated, and judged at the noise level that they
leave. A pool of processes shares the work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.core.running.budget import Budget, within
from flexjoint.core.running.worker_pool import WorkerPool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, evaluated, fit, fit_tried
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import (
    SAME_LEVEL,
    at_own_level,
    by_joint,
    changed_balances,
    degenerate,
    only_by_implausible,
    same_level,
    score,
    supported,
    torque_shares,
)
from flexjoint.diagnosis.search.dating import date_onset, switched
from flexjoint.diagnosis.search.scan import Scored
from flexjoint.effects import Kind, Planned


def at_noise(best: Fit) -> Fit | None:
    """The set fitted at the level of the predicted noise; None where no balance is wrong and no nominal
    number is implausible, for the set was then fitted near that level already."""
    problem = best.problem
    if problem.level.implausible <= 1.0 and not np.any(problem.level.inflation > best.settings.search.wrong):
        return None
    return fit(problem.at(NoiseLevel.predicted(len(problem.balances.rows))), best.effects)


def ends_lower(bare: Fit, best: Fit) -> bool:
    """Whether a set fitted at the level of the predicted noise leaves clearly less than fitted at its own: at
    a high noise level a fit ends where little energy can be gained, and may then not come down from it."""
    before = best.problem.level
    after = best.problem.plausible_level(bare.y)
    less = np.log(before.inflation / before.implausibility) - np.log(after.inflation / after.implausibility)
    return bool(np.sum(less) > SAME_LEVEL)


def larger_sets(
    best: Fit, scanned: Sequence[tuple[Scored, ...]], bare: Fit | None, pool: WorkerPool, tried: Budget
) -> list[Fit]:
    """Sets of one more effect that the data support rather than `best`. `scanned` holds the scan of `best`
    and, where there is one, that of `bare`, the same set at the level of the predicted noise.

    The noise level of `best` may be so high that no cause improves the set visibly, not even one that leaves
    a tenth of the variance in the wrong balances, or after which no nominal number is implausible. Such sets
    are therefore judged at the level that they leave themselves, and candidates are also taken from the scan
    of `bare`. Those that come in the time `tried` are judged, the most promising ones first."""
    with within(tried):
        found, trials = _tried(best, scanned, bare, pool)
    return found if bare is None else [*found, *clearing(best, trials, bare, pool)]


def _tried(
    best: Fit, scanned: Sequence[tuple[Scored, ...]], bare: Fit | None, pool: WorkerPool
) -> tuple[list[Fit], list[Fit]]:
    """The sets that the data support at the noise level of `best`, and those that are to be judged at the
    level that they leave."""
    scored = promising(best, scanned[0])
    reached = pool.reached(_judged, [(evaluated(best), one) for one in scored])
    judged = [(None, False) if one is None else one for one in reached]
    found = [f for f, better in judged if f is not None and better]
    if bare is None:
        return found, []
    trials = [f for f, _ in judged if f is not None]
    # a set that was already fitted at the level of `best` is fitted on from there, unless its onset was
    # added or dropped meanwhile
    known = {
        (s.candidate, s.since)
        for s, (f, _) in zip(scored, judged, strict=True)
        if f is not None and (f.effects[-1].since is None) == (s.since is None)
    }
    others = [s for s in promising(bare, scanned[1]) if (s.candidate, s.since) not in known]
    lower = pool.reached(_clearer, [(best, bare, f) for f in trials])
    trials = [f if below is None else below for f, below in zip(trials, lower, strict=True)]
    return found, trials + [f for f in pool.reached(_added, [(bare, one) for one in others]) if f is not None]


def _judged(task: tuple[Fit, Scored]) -> tuple[Fit | None, bool]:
    """A set with a candidate added, and whether the data support it at the noise level of the set."""
    best, added = task[0], added_to(*task)
    return added, added is not None and supported(added, best, added.effects[-1])


def _clearer(task: tuple[Fit, Fit, Fit]) -> Fit:
    """A set of one effect more than `best`, fitted at the noise level of `best`, or fitted on at that of the
    predicted noise, whichever leaves less: at a high noise level a friction may converge to a wrong
    number."""
    best, bare, above = task
    changed = marked(above, 1)
    levels = bare.problem.variances(above.y)
    if not np.any(levels[changed] > above.settings.regression.noise_decides):
        return above
    below = fit_tried(bare.problem, above.effects, above.effects[-1])
    if degenerate(below.problem, below.effects[-1]):
        return above
    lower = cleared(best, bare.problem.variances(below.y), changed) > cleared(best, levels, changed)
    return below if lower else above


def clearing(best: Fit, trials: Sequence[Fit], bare: Fit, pool: WorkerPool) -> list[Fit]:
    """Of sets of one more effect than `best`, those that remove most of what is wrong in the balances, each
    at the noise level that it leaves. They are tried in groups, those that leave least first; once a group
    has such a set, those that leave ten times more are not tried. What acts within a joint is no rival of
    what acts within another one: these have groups of their own."""
    limits = best.settings.search
    waiting: dict[str | None, list[tuple[float, Fit]]] = {}
    for f in trials:
        share, e = cleared(best, bare.problem.variances(f.y), marked(f, 1)), f.effects[-1]
        if best.problem.level.implausible > 1.0 or share >= np.log(limits.cleared):
            waiting.setdefault(e.joint if acts_within_a_joint(e) else None, []).append((share, f))
    out: list[Fit] = []
    while waiting:
        least = {k: max(share for share, _ in group) - np.log(limits.cleared) for k, group in waiting.items()}
        first = [(k, f) for k, group in waiting.items() for share, f in group if share >= least[k]]
        found = pool.reached(_cleared_at_own_level, [(best, f) for _, f in first])
        done = {k for (k, _), f in zip(first, found, strict=True) if f is not None}
        out += [f for f in found if f is not None]
        rest = {k: [(share, f) for share, f in group if share < least[k]] for k, group in waiting.items()}
        waiting = {k: group for k, group in rest.items() if group and k not in done}
    return out


def marked(trial: Fit, last: int) -> np.ndarray:
    """(rows,) bool: the balances that the last few effects of a set change (`changed_balances`)."""
    count = len(trial.effects)
    changed = [changed_balances(trial.problem, trial.effects, k) for k in range(count - last, count)]
    return np.any(changed, axis=0)


def cleared(best: Fit, levels: np.ndarray, changed: np.ndarray) -> float:
    """By how much (mean logarithm) variances are lower than those that `best` leaves, over the balances that
    are wrong and that the added effect changes: where many joints are wrong, one cause corrects its own."""
    left, wrong = _left(best), wrong_balances(best) & changed
    return float(np.mean(np.log(left[wrong] / levels[wrong]))) if np.any(wrong) else 0.0


def wrong_balances(best: Fit) -> np.ndarray:
    """(rows,) bool: the balances of which a set leaves far more than noise."""
    return np.asarray(_left(best) > best.settings.search.wrong)


def wrong_joints(best: Fit) -> list[str]:
    """The joints of which a balance is wrong, in the robot's order."""
    rows = zip(best.problem.balances.rows, wrong_balances(best), strict=True)
    joints = {row.joint for row, wrong in rows if wrong}
    return [best.problem.robot.joint_names[joint] for joint in sorted(joints)]


def _left(best: Fit) -> np.ndarray:
    """(rows,) noise levels of a set without what is needed for implausible nominal numbers."""
    return np.asarray(best.problem.level.inflation / best.problem.level.implausibility)


def clears(best: Fit, levels: np.ndarray, changed: np.ndarray) -> bool:
    """Whether variances are lower by the factor from which a set is judged at its own noise level."""
    return cleared(best, levels, changed) >= float(np.log(best.settings.search.cleared))


def on_all_joints(best: Fit, candidates: Sequence[Candidate]) -> list[Fit]:
    """Sets in which a timing cause that several joints have is given to all other joints that can have it: a
    delay at two joints is probably common to all, also at joints where it is too small to be found alone."""
    groups: dict[tuple[str, tuple[object, ...]], list[Planned]] = {}
    for e in best.effects:
        if e.effect.kind is Kind.TIMING and e.joint is not None and e.since is None:
            groups.setdefault((e.effect.name, _words(e)), []).append(e)
    found = []
    for (name, words), group in groups.items():
        if len(group) == 1:
            continue
        size = group[0].effect.nulls[0].name
        mean = {size: float(np.mean([e.values[size] for e in group]))}
        taken = {e.joint for e in best.effects if e.effect.name == name}
        kin = [c for c in candidates if c.effect.name == name and tuple(w for _, w in c.words) == words]
        others = [c.planned(mean) for c in kin if c.joint not in taken]
        if others:
            found.append(fit(best.problem, [*best.effects, *others]))
    return found


def _words(planned: Planned) -> tuple[object, ...]:
    return tuple(planned.values.get(w.name) for w in planned.effect.words)


def might_clear(best: Fit, rival: Fit, added: Sequence[Planned], removes: float) -> bool:
    """Whether two effects may remove most of what is wrong in `best` once they are fitted: those `added` to
    another set, or one and the last effect of that set, which `removes` so much energy to first order.
    Always, where they may free `best` of implausible nominal numbers."""
    limits = best.settings.search
    if best.furthest > best.settings.regression.implausible:
        return True
    problem, effects = rival.problem, [*rival.effects, *added]
    shares = [torque_shares(problem, effects, k) for k in range(len(effects) - 2, len(effects))]
    changed = wrong_balances(best) & np.any(np.array(shares) > 0.0, axis=0)
    left = problem.rest_by_row(best.y)[changed]
    needed = (
        problem.energy(rival.y)
        - problem.energy(best.y)
        + (1.0 - 1.0 / limits.cleared) * float(np.sum(left**2))
    )
    return removes >= limits.unfitted**2 * needed


def _cleared_at_own_level(task: tuple[Fit, Fit]) -> Fit | None:
    """A set of one more effect than `best` at the noise level that it leaves, if the data support it there
    and if that level is clearly lower, or no nominal number is implausible any more."""
    best, trial = task
    refitted = settled(trial, trial.effects[-1])
    relieved = best.problem.level.implausible > 1.0 and refitted.problem.level.implausible <= 1.0
    if not relieved and not clears(best, judged_levels(best, refitted), marked(refitted, 1)):
        return None
    without = fit_tried(refitted.problem, best.effects, trial.effects[-1])
    better = supported(refitted, without, refitted.effects[-1]) and not only_by_implausible(refitted, best)
    return refitted if better else None


def judged_levels(best: Fit, larger: Fit) -> np.ndarray:
    """(rows,) noise levels of a larger set by which it is judged beside `best`: the part of the inflation
    that both need for implausible numbers has another cause than what was added."""
    needed = np.minimum(larger.problem.level.implausibility, best.problem.level.implausibility)
    return np.asarray(larger.problem.level.inflation / needed)


def on_one_level(fits: Sequence[Fit], pool: WorkerPool) -> list[Fit]:
    """The fits, all at the lowest of their noise levels, without those that are far worse there."""
    if not fits:
        return []
    lowest = min((f.problem for f in fits), key=lambda w: float(np.sum(np.log(w.level.inflation))))
    energies = [lowest.energy(f.y) for f in fits]
    most = lowest.settings.search.far_worse * min(energies)
    kept = [f for f, energy in zip(fits, energies, strict=True) if energy <= most]
    there = [np.array_equal(f.problem.level.inflation, lowest.level.inflation) for f in kept]
    above = [(lowest, f.effects) for f, same in zip(kept, there, strict=True) if not same]
    moved = iter(pool.map(_refitted, above))
    return [f if same else next(moved) for f, same in zip(kept, there, strict=True)]


def _refitted(task: tuple[Problem, Sequence[Planned]]) -> Fit:
    return evaluated(fit(*task))


def sought_again(result: Fit, effect: Planned, pool: WorkerPool) -> Fit:
    """The set with an effect fitted again from all its start values, if a shape parameter of it has left the
    range of these (a creep so slow that it acts as a spring): far outside, the energy is flat and no fit
    leads back. The set itself, if that does not lower the energy."""
    scales = [p.name for p in effect.effect.params if p.null is None and p.low > 0.0]
    lengths = [name for name in scales if name != effect.effect.repeats]  # whose starts what is left gives
    starts = result.problem.starts(effect.effect, effect.joint)
    looked = {name: [start[name] for start in starts if name in start] for name in lengths}
    astray = result.settings.search.astray
    if not any(_astray(float(effect.values[name]), places, astray) for name, places in looked.items()):
        return result
    shapes = dict.fromkeys(
        tuple((name, start[name]) for name in lengths if name in start) for start in starts
    )
    others = [e for e in result.effects if e is not effect]
    trials = [[*others, effect.with_values(dict(shape))] for shape in shapes]
    fits = pool.map(_refitted, [(result.problem, trial) for trial in trials])
    best = min(fits, key=lambda f: f.energy)
    return best if best.energy < result.energy - result.settings.search.chance else result


def _astray(value: float, looked: Sequence[float], factor: float) -> bool:
    return bool(looked) and not min(looked) / factor <= value <= max(looked) * factor


def promising(current: Fit, scanned: Sequence[Scored], needed: float = 0.0) -> list[Scored]:
    """The candidates that deserve a full fit: their gain to first order is near that of the best one, and
    near the energy that a rival needs (`needed`), and their torque may be large enough to be named. What acts
    within a joint is no rival of what acts elsewhere: where none is needed, each joint's best one is tried,
    however many explain more of other joints."""
    limits, taken = current.settings.search, by_joint(current.effects)
    scanned = [
        s for s in scanned if s.candidate.joint is None or taken[s.candidate.joint] < limits.most_on_joint
    ]
    if not scanned:
        return []
    most = scanned[0].removes  # to first order, which may be less than `needed`
    enough = max(limits.promising * most, limits.alternative_share * min(needed, most), limits.chance)
    count = limits.alternatives if needed > 0.0 else limits.polished
    near = [scored for scored in scanned[:count] if scored.removes >= enough]
    if needed == 0.0:
        tried = {s.candidate.joint for s in near if acts_within_a_joint(s.candidate)}
        for s in scanned[len(near) :]:
            within_a_joint = acts_within_a_joint(s.candidate)
            if s.removes >= enough and within_a_joint and s.candidate.joint not in tried:
                tried.add(s.candidate.joint)
                near.append(s)
    return [scored for scored in near if might_matter(current, scored)]


def might_matter(current: Fit, scored: Scored) -> bool:
    """Whether an effect may be large enough to be named once it is fitted: a small torque that explains
    little does not become a large one."""
    limits = current.settings.search
    certain = limits.certain if scored.since is None else limits.certain_dated
    if scored.removes >= limits.unfitted**2 * certain:
        return True
    effects = [*current.effects, scored.planned()]
    shares = torque_shares(current.problem, effects, len(effects) - 1)
    return bool(np.max(shares) >= limits.unfitted * current.problem.robot.tolerance.torque)


def polish(
    current: Fit, scanned: Sequence[Scored], needed: float, pool: WorkerPool, but: tuple[str, str | None]
) -> list[Fit]:
    """The most promising candidates fitted together with the current set, and dated; all `but` the one with
    that key, in whose place they are tried."""
    others = [s for s in promising(current, scanned, needed) if s.candidate.key != but]
    fits = pool.map(_polished, [(current, scored) for scored in others])
    return [f for f in fits if f is not None]


def _polished(task: tuple[Fit, Scored]) -> Fit | None:
    added = added_to(*task)
    return None if added is None else evaluated(added)


def _added(task: tuple[Fit, Scored]) -> Fit | None:
    return added_to(*task, finely=False)  # `settled` dates those that clear most of what is wrong


def added_to(current: Fit, scored: Scored, finely: bool = True) -> Fit | None:
    """A set with a candidate added, fitted and dated, causes within other joints as they are; None where its
    fitted numbers mean nothing (`degenerate`). `finely`: as of `switched`."""
    planned = scored.planned()
    fitted = switched(date_onset(fit_tried(current.problem, [*current.effects, planned], planned)), finely)
    fitted = instead_of_listed(fitted, fitted.effects[-1])
    return None if degenerate(current.problem, fitted.effects[-1]) else fitted


def both_added_to(current: Fit, pair: Sequence[Planned]) -> Fit | None:
    """A set with two effects of one joint added, fitted together; None where fitted numbers of either mean
    nothing (`degenerate`)."""
    fitted = fit_tried(current.problem, [*current.effects, *pair], pair[0])
    for key in (e.key for e in pair):
        fitted = instead_of_listed(fitted, next(e for e in fitted.effects if e.key == key))
    added = [e for e in fitted.effects if e.key in {one.key for one in pair}]
    return None if any(degenerate(current.problem, e) for e in added) else fitted


def instead_of_listed(fitted: Fit, added: Planned) -> Fit:
    """The set with a law that has a state of its own in the place of one that the nominal model lists and
    that it contains (a friction that gives way, of a dry one), if that is better: the two do not add up to it
    with any numbers, so that beside the listed one, as it is, little of the law is seen."""
    law, others = added.effect, [e for e in fitted.effects if e is not added]
    taken = {e.key for e in others}
    listed = [
        e
        for e in fitted.problem.nominal
        if law.states and e.joint == added.joint and e.effect.name in law.contains and e.key not in taken
    ]
    if not listed or added.since is not None:
        return fitted
    own = listed[0]
    gone = replace(own.with_values({p.name: p.null for p in own.effect.nulls}), nominal=False)
    whole = added.with_values({p.name: own.values[p.name] for p in law.nulls if p.name in own.values})
    instead = fit_tried(fitted.problem, [*others, gone, whole], whole)
    return instead if score(instead) < score(fitted) else fitted


def settled(result: Fit, tried: Planned | None = None) -> Fit:
    """The set at the noise level that it leaves itself (`at_own_level`), its last effect dated there: an
    onset is found no better than the noise level lets it."""
    refitted = at_own_level(result, tried)
    last, same = refitted.effects[-1], same_level(refitted.problem.level, result.problem.level)
    if last.since is None or (same and not last.switches):
        return refitted
    dated = switched(refitted) if last.switches else date_onset(refitted)
    return refitted if dated is refitted else at_own_level(dated, tried)
