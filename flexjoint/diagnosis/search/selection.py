"""Which set of effects explains the recording: scan, fit the best, add, exchange, prune, date. criteria.py
holds the criteria that an effect must meet.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, here, within
from flexjoint.core.running.worker_pool import WorkerPool, worker_pool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, evaluated, fit, fit_tried, refit_without
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.regression.uncertainty import standard_errors
from flexjoint.diagnosis.result import Step
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.criteria import (
    at_own_level,
    contradicted,
    degenerate,
    makes_room,
    only_by_implausible,
    price,
    score,
    stands_in,
    supported,
    unexplained_energy,
)
from flexjoint.diagnosis.search.history import steps_between
from flexjoint.diagnosis.search.pairs import joint_pairs, pairs_instead
from flexjoint.diagnosis.search.rivals import Key, Rivals
from flexjoint.diagnosis.search.scan import Scanner, Scored
from flexjoint.diagnosis.search.trials import (
    at_noise,
    date_onset,
    ends_lower,
    larger_sets,
    on_all_joints,
    on_one_level,
    polish,
    settled,
    sought_again,
    wrong_joints,
)
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Effect, Planned, Site, catalogue

STAGE = "search"  # in the trace
PRUNED = "beside the others it no longer explains its price"
COMMON = "what every drive has takes most of the error of several joints"
ALIKE = "several joints have it by one value"
PAIRED = "with another cause it explains what neither explains alone"
LEFT_OUT = (
    "the time allowed was over during the search: further causes were not looked for, and not every cause was"
    " compared with its rivals"
)

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Selection:
    """The chosen set with its fit, the first scan, and the alternatives to each chosen effect."""

    best: Fit
    nothing: Fit  # no effect beyond the nominal model
    scan: tuple[Scored, ...]  # of the nominal model, best start of each candidate
    last_scan: tuple[Scored, ...]  # of the chosen set: what was looked for beyond it
    rivals: tuple[Sequence[Fit], ...]  # per chosen effect: fits with another in its place, best first
    explains: Mapping[Key, float] = field(default_factory=dict)  # energy, where it is of several recordings
    trace: tuple[Step, ...] = ()  # how the set came about
    left_out: tuple[str, ...] = ()  # what the time allowed was too short for

    def rivals_beside(self, best: Fit) -> tuple[Rivals, ...]:
        """The rivals of each effect of another set, beside that set; none of an effect that is new in it."""
        known = {
            e.key: Rivals.known(self.best, e.key, fits)
            for e, fits in zip(self.best.effects, self.rivals, strict=True)
        }
        return tuple(
            known[e.key].beside(best) if e.key in known else Rivals(best, e.key, ()) for e in best.effects
        )


@dataclass(frozen=True)
class Search:
    """The scanner of candidates, and the processes that share the work. `cut` is no longer empty when the
    time was over before something that would have been done."""

    scanner: Scanner
    pool: WorkerPool
    budget: Budget = UNLIMITED
    trying: float = USUAL.search.trying_time  # share of the time after which no further set is tried
    cut: list[str] = field(default_factory=list)

    def goes_on(self) -> bool:
        """Whether there is time for another set; asked where there is one to try."""
        if self.budget.part(self.trying).spent:
            self.stopped()
        return not self.cut

    def stopped(self) -> None:
        """The time was over. Work within the time of others is theirs to end."""
        if not self.budget.limited:
            raise OutOfTimeError
        self.cut.append(LEFT_OUT)

    def scan(self, current: Fit, replaced: Planned) -> tuple[Scored, ...]:
        """Candidates for the place of an effect. Where an angle was not measured but computed from the
        nominal model, it carries errors of one joint to the others, and candidates of all joints are
        scanned."""
        blind = bool(current.problem.motion.missing)
        return self.scanner.scan(current, self.pool, None if blind else replaced)


def select(
    problem: Problem,
    candidates: Sequence[Candidate],
    report: Progress,
    start: Sequence[Planned] = (),
    workers: int = 1,
    budget: Budget = UNLIMITED,
) -> Selection:
    """Forward selection with full refits, exchanges and pruning; `start` seeds the set. Any number of
    `workers` (processes) gives the same bits. When the time of a `budget` is over the set is taken as it
    was after the last step that is whole."""
    scanner = Scanner(candidates)
    with worker_pool([*problem.shared(), *catalogue().values(), *candidates, scanner], workers) as processes:
        if not budget.limited:
            return _select(problem, Search(scanner, processes), report, start)
        with within(budget):
            trying = problem.settings.search.trying_time
            return _select(problem, Search(scanner, processes, budget, trying), report, start)


@dataclass
class _Found:
    """The set after the last step that is whole, and how it came about."""

    best: Fit
    seen: set[frozenset[Key]]  # sets; no other is tried twice
    scans: list[tuple[Scored, ...]] = field(default_factory=list)  # of every set that was looked beyond
    trace: list[Step] = field(default_factory=list)
    rivals: dict[Key, tuple[Fit, ...]] = field(default_factory=dict)
    looked: set[frozenset[Key]] = field(default_factory=set)  # sets beyond which two causes were looked for

    def takes(self, best: Fit, check: str, why: str) -> None:
        """Another set takes its place."""
        self.trace += steps_between(self.best, best, STAGE, check, why)
        self.best = best

    def exchanges(self, search: Search, places: Sequence[Planned], everywhere: bool = True) -> None:
        best, rivals = exchange(search, self.best, places, everywhere)
        self.takes(best, "exchange", "the set with it scores better")
        if everywhere:
            self.rivals = dict(zip((e.key for e in best.effects), rivals, strict=True))

    def pruned(self, grown: Fit, search: Search, standing: Mapping[Key, frozenset[Key]]) -> Fit | None:
        """A larger set without what is not supported in it (`prune`); None where that leads back to a set
        that was seen."""
        pruned = prune(grown, search.pool, standing)
        return None if _keys(pruned) in self.seen else pruned

    def paired(self, search: Search, bare: Fit) -> Fit | None:
        """The set with two more causes on each joint that only so is explained (`joint_pairs`); None where
        there is none. The causes of other joints matter, too: what they leave of these holds the nominal
        numbers that all have in common."""
        best, pool = self.best, search.pool
        if _keys(best) in self.looked:
            return None
        self.looked.add(_keys(best))
        sets = joint_pairs(best, bare, wrong_joints(best), search.scanner, pool)
        if not sets:
            return None
        alike = on_one_level(sets, pool)
        return _with_other_joints(choose(alike), alike, sets, pool)


def _select(problem: Problem, search: Search, report: Progress, start: Sequence[Planned]) -> Selection:
    with within(UNLIMITED):  # of what is handed over
        nothing = at_own_level(fit(problem, []))
        best = at_own_level(fit(problem, start)) if start else nothing
    # a cause may enter at the noise level of its own set and be dropped again at that of the whole set
    found = _Found(best, {_keys(best)})
    try:
        _look(found, search, report)
    except OutOfTimeError:
        search.stopped()
    first, last = (found.scans[0], found.scans[-1]) if found.scans else ((), ())
    rivals = tuple(found.rivals.get(e.key, ()) for e in found.best.effects)
    left_out = tuple(dict.fromkeys(search.cut))
    return Selection(found.best, nothing, first, last, rivals, trace=tuple(found.trace), left_out=left_out)


def _look(found: _Found, search: Search, report: Progress) -> None:
    """Grow, prune and exchange until nothing is better. Each step is taken as a whole, or not at all where
    the time is over in its midst."""
    compared: dict[Key, frozenset[Key]] = {}  # effects with their rivals, and what was beside them then
    while True:
        _grow(found, search, report)
        found.takes(prune(found.best, search.pool), "price", PRUNED)
        report(0.9, "comparing rival causes")
        places = [e for e in found.best.effects if compared.get(e.key) != _neighbours(found.best, e)]
        before = found.best
        found.exchanges(search, places)
        compared = {e.key: _neighbours(found.best, e) for e in found.best.effects}
        # beside what was exchanged another cause may be seen
        if _keys(found.best) not in found.seen | {_keys(before)}:
            found.seen.add(_keys(found.best))
            continue
        best, bare = found.best, at_noise(found.best)
        if bare is not None and has_room(best):
            joints = wrong_joints(best)
            pairs = on_one_level(pairs_instead(best, bare, joints, search.scanner, search.pool), search.pool)
            pair = prune(choose(pairs), search.pool) if pairs else best
            if pairs and _keys(pair) not in found.seen and _still_better(pair, best):
                found.takes(pair, "pair instead", "the pair clears what was wrong")
                found.seen.add(_keys(pair))
                continue
        if len(places) < len(best.effects):  # in the end the rivals of all effects are those of the final set
            found.exchanges(search, best.effects)
            compared = {e.key: _neighbours(found.best, e) for e in found.best.effects}
            if _keys(found.best) not in found.seen:
                found.seen.add(_keys(found.best))
                continue
        break


def _grow(found: _Found, search: Search, report: Progress) -> None:
    """Add causes one by one, as long as the data support another one; sets that were seen are not tried
    again."""
    standing: dict[Key, frozenset[Key]] = {}  # effects that were found supported, and what was beside them
    rubbed: frozenset[Key] | None = None  # the loads beside which ordinary friction was looked for
    common_beside: frozenset[Key] | None = None  # those beside which causes of one value were looked for
    while has_room(found.best) and search.goes_on():
        best = found.best
        report(len(best.effects) / (len(best.effects) + 2.0), f"looking for cause {len(best.effects) + 1}")
        bare = at_noise(best)
        if bare is not None and ends_lower(bare, best):
            best = found.best = at_own_level(bare)
        both = search.scanner.scans([best] if bare is None else [best, bare], search.pool)
        found.scans.append(both[0])
        loads = frozenset(e.key for e in best.effects if e.effect.site is Site.BODY)
        common = None if rubbed == loads else with_ordinary(best, both[0], search.pool)
        rubbed = loads
        if common is not None and _keys(common) not in found.seen:
            found.takes(common, "ordinary friction", COMMON)
            found.seen.add(_keys(common))
            continue
        larger = _larger(best, both, bare, search)
        candidates = search.scanner.candidates
        wider = on_one_level(larger, search.pool) or on_all_joints(best, candidates)
        grown = _best_at_own_level(best, wider)
        if grown is not None:
            grown = _with_other_joints(grown, wider, larger, search.pool)
        why = ("price", "it explains more than its price")
        alike = with_common(best, both[-1], search.pool) if common_beside != loads else []
        common_beside = loads
        if alike:
            others = [] if grown is None else [grown]
            chosen = choose(on_one_level([*others, *alike], search.pool))
            if _keys(chosen) not in {_keys(f) for f in others}:
                grown, why = at_own_level(chosen), ("one value", ALIKE)
        pruned = None if grown is None else found.pruned(grown, search, standing)
        if pruned is None and bare is not None:
            grown, why = found.paired(search, bare), ("pair", PAIRED)
            pruned = None if grown is None else found.pruned(grown, search, standing)
        if grown is None or pruned is None:
            break
        older = _keys(best)
        found.takes(grown, *why)
        found.takes(pruned, "price", PRUNED)
        found.seen.add(_keys(pruned))
        standing = {e.key: _neighbours(pruned, e) for e in pruned.effects}
        newest = {e.joint for e in pruned.effects if e.key not in older}
        asked = [e for e in pruned.effects if e.joint in newest and e.key in older]
        found.exchanges(search, asked, everywhere=False)


def _larger(best: Fit, both: Sequence[tuple[Scored, ...]], bare: Fit | None, search: Search) -> list[Fit]:
    """`larger_sets`, of the most promising ones as many as the time allows."""
    if not search.budget.limited:
        return larger_sets(best, both, bare, search.pool, here())
    larger = larger_sets(best, both, bare, search.pool, search.budget.part(search.trying))
    search.goes_on()  # says it where the time for them is over
    return larger


def with_ordinary(best: Fit, scanned: Sequence[Scored], pool: WorkerPool) -> Fit | None:
    """The set with those ordinary causes (`Effect.ordinary`) that the data support on the joints of which
    they take most of the error; None where there are not several of these. Every machine has more or less
    friction than its nominal model, and rotors of which a description says nothing: on a real arm they are
    wrong on all joints at once, and each other cause is seen beside them only, unless it is a load that hides
    them."""
    have = {(name, e.joint) for e in best.effects for name in (e.effect.name, *e.effect.contains)}
    ordinary = [
        replace(s, since=None).planned()
        for s in scanned
        if s.candidate.effect.ordinary and s.candidate.key not in have
    ]
    if not ordinary:
        return None
    problem, names = best.problem, best.problem.robot.joint_names
    rubbing = at_own_level(fit(problem, [*best.effects, *ordinary]))
    before, after = (problem.variances(one.y) for one in (best, rubbing))
    share = best.settings.search.ordinary_share**2
    joints = {
        names[row.joint]
        for row, b, a in zip(problem.balances.rows, before, after, strict=True)
        if a < share * b
    }
    if len(joints) <= 1:
        return None
    older = _keys(best)
    kept = [e for e in rubbing.effects if e.key in older or e.joint in joints]
    if len(kept) < len(rubbing.effects):
        rubbing = at_own_level(fit(problem, kept))
    left = prune(rubbing, pool)
    several = len({e.joint for e in left.effects if e.key not in older}) > 1
    return left if several and score(left) < score(fit(left.problem, best.effects)) else None


def with_common(best: Fit, scanned: Sequence[Scored], pool: WorkerPool) -> list[Fit]:
    """Sets with a cause that several joints often have by one value (`Effect.common`) on all joints of which
    it explains something certain, where the data support it on several of them by about one value: what is
    late has one clock, and motors of one type have one torque constant. Only causes that no joint has yet."""
    certain, names = best.settings.search.certain, best.problem.robot.joint_names
    taken = {e.effect.name for e in best.effects}
    groups: dict[object, list[Planned]] = {}
    for s in scanned:
        effect = s.candidate.effect
        if effect.common and effect.name not in taken and s.removes >= certain:
            groups.setdefault((effect.name, s.candidate.words), []).append(replace(s, since=None).planned())
    older, found = _keys(best), []
    for group in groups.values():
        if len(group) == 1:
            continue
        group.sort(key=lambda e: names.index(str(e.joint)))
        together = at_own_level(fit(best.problem, [*best.effects, *group]))
        # the others are asked only where that leaves a common cause, which is seldom
        alike = _of_one_value(prune(together, pool, among={e.key for e in group}), older)
        if alike is not None and (alike := _of_one_value(prune(alike, pool), older)) is not None:
            found.append(alike)
    return found


def _of_one_value(result: Fit, older: frozenset[Key]) -> Fit | None:
    """The set without those of its new effects of one law that are not about as large as the others, or as
    large as their standard errors let them be; None where less than two are left."""
    share, limits = result.settings.search.one_value, result.settings.verdict
    while True:
        added = [k for k, e in enumerate(result.effects) if e.key not in older]
        if len(added) <= 1:
            return None
        spread, size = standard_errors(result), result.effects[added[0]].effect.nulls[0].name
        values = np.array([float(result.effects[k].values[size]) for k in added])
        errors = np.array([spread[k][size][0] for k in added])
        usual = float(np.median(values))
        beyond = np.abs(values - usual) - np.maximum(limits.same * errors, share * abs(usual))
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0.0:
            return result
        result = at_own_level(refit_without(result, result.effects[added[worst]]))


def _with_other_joints(grown: Fit, found: Sequence[Fit], larger: Sequence[Fit], pool: WorkerPool) -> Fit:
    """The set with the best of the other sets' causes on each other joint as well: one round serves all
    joints, as a cause that acts within its joint does not replace one on another joint. A load acts on many
    joints, and may replace causes on all of them: of those on one noise level (`found`) only sets that are
    better than the best one with a load count, of the others (`larger`) only where none has a load."""
    joints, others, older = {grown.effects[-1].joint}, [], _keys(grown)
    loaded = not all(acts_within_a_joint(f.effects[-1]) for f in [grown, *larger])
    apart = (
        [] if loaded else [f for own in _by_joint(larger) for f in sorted(on_one_level(own, pool), key=score)]
    )
    inflation, implausibility = grown.problem.level.inflation, grown.problem.level.implausibility
    for trial in [grown, *sorted(found, key=score), *apart]:
        e = trial.effects[-1]
        if not acts_within_a_joint(e):
            break
        if e.joint not in joints:
            joints.add(e.joint)
            # a law in the place of a listed one brings that one's change along
            others += [one for one in trial.effects if one.joint == e.joint and one.key not in older]
            # at the level that it leaves there: at a high one the fit would lose what it found
            inflation = np.minimum(inflation, trial.problem.level.inflation)
    if not others:
        return grown
    there = grown.problem.at(NoiseLevel(inflation, implausibility))
    return at_own_level(fit(there, [*grown.effects, *others]))


def _by_joint(sets: Sequence[Fit]) -> list[list[Fit]]:
    """Sets by the joint of their last effect."""
    groups: dict[str | None, list[Fit]] = {}
    for f in sets:
        groups.setdefault(f.effects[-1].joint, []).append(f)
    return list(groups.values())


def _best_at_own_level(best: Fit, found: Sequence[Fit]) -> Fit | None:
    """The best of some sets at the noise level that it leaves; if it is better than `best` there only because
    of implausible nominal numbers, the next best one. None where that is so for all."""
    waiting = list(found)
    while waiting:
        chosen = choose(waiting)
        refitted = settled(chosen)
        if not only_by_implausible(refitted, best):
            return refitted
        waiting = [f for f in waiting if f is not chosen]
    return None


def has_room(best: Fit) -> bool:
    """Whether a set may have another cause beside what every drive has."""
    limits, count = best.settings.search, sum(not e.effect.ordinary for e in best.effects)
    return count < max(limits.most_effects, limits.most_a_joint * len(best.problem.robot.joints))


def _keys(result: Fit) -> frozenset[Key]:
    return frozenset(e.key for e in result.effects)


def _neighbours(result: Fit, effect: Planned) -> frozenset[Key]:
    """The effects of a set on which the rivals of one of them depend: all, or of an effect that acts within
    its joint, those on that joint and those that act on other joints, too."""
    own = acts_within_a_joint(effect)
    return frozenset(
        e.key for e in result.effects if not own or e.joint == effect.joint or not acts_within_a_joint(e)
    )


def choose(fits: Sequence[Fit]) -> Fit:
    """The set with the best score, or a simpler one whose score is worse by little (`granted`)."""
    best = min(fits, key=score)
    bare = best.problem.energy(best.problem.residual([]))
    close = score(best) + granted([best], bare - best.energy)
    return min((f for f in fits if score(f) <= close), key=lambda f: (price(f), score(f)))


def granted(fits: Sequence[Fit], explained: float) -> float:
    """Energy by which a simpler set may be worse than these fits of the best set (one for each recording): a
    small share of the energy that they leave unexplained, plus the share of the explained energy that
    filtering makes uncertain."""
    limits = fits[0].settings.search
    share = limits.filtered_reconstructed if any(f.problem.motion.missing for f in fits) else limits.filtered
    return limits.unexplained_share * sum(unexplained_energy(f) for f in fits) + share * max(0.0, explained)


def exchange(
    search: Search, result: Fit, places: Sequence[Planned], everywhere: bool = True
) -> tuple[Fit, tuple[tuple[Fit, ...], ...]]:
    """Try other candidates in the place of some effects, and keep those that score better. Returns the set
    and, for each of its effects, the fits with a rival in its place, best first. After an exchange all
    effects are asked, or only those that it touches if not `everywhere`: then rivals of the others may be
    those of a set before. When the time is over the others are not asked."""
    rivals: dict[Key, tuple[Fit, ...]] = {}
    waiting = [e.key for e in places]
    exchanges = 0  # bounded, so that two equals do not alternate for ever
    while waiting and not search.cut:
        key = waiting.pop(0)
        replaced = next((e for e in result.effects if e.key == key), None)
        if replaced is None or makes_room(replaced, result):
            continue
        try:
            result, fits = _rivals_of(search, result, replaced)
            swapped = choose([result, *fits])
            if swapped is not result and exchanges < result.settings.search.most_exchanges:
                exchanges += 1
                refitted = at_own_level(swapped)
                if _still_better(refitted, result):
                    before, result = result, prune(refitted, search.pool)
                    waiting = [
                        e.key
                        for e in result.effects
                        if everywhere or e.key in waiting or _neighbours(result, e) != _neighbours(before, e)
                    ]
                    continue
        except OutOfTimeError:
            search.stopped()
            break
        rivals[key] = tuple(sorted(fits, key=score))
    return result, tuple(rivals.get(e.key, ()) for e in result.effects)


def _rivals_of(search: Search, result: Fit, replaced: Planned) -> tuple[Fit, list[Fit]]:
    """The set, which may have been fitted better meanwhile, and the fits with another candidate in the place
    of an effect."""
    key = replaced.key
    again = sought_again(result, replaced, search.pool)
    if again is not result:
        result = at_own_level(again)
        replaced = next(e for e in result.effects if e.key == key)
    without = refit_without(result, replaced)
    scanned = search.scan(without, replaced)
    if replaced.effect.ordinary and _rubs_all_over(result):
        scanned = tuple(s for s in scanned if _ordinary_too(s.candidate.effect, replaced.effect))
    needed = _needed(without.energy - result.energy, scanned, key)
    tried = polish(without, scanned, needed, search.pool, key)
    fits = [f for f in tried if not (contradicted(f, without) or stands_in(f, f.effects[-1]))]
    fits += [alone for more in search.pool.map(_containing, [(f, key[0]) for f in fits]) for alone in more]
    return result, fits


def _rubs_all_over(result: Fit) -> bool:
    """Whether ordinary friction is wrong on most joints: it is then the machine's, and not one joint's
    cause."""
    joints = {e.joint for e in result.effects if e.effect.ordinary}
    limits, count = result.settings.search, len(result.problem.robot.joints)
    return len(joints) >= limits.common_joints and 2 * len(joints) > count


def _ordinary_too(rival: Effect, replaced: Effect) -> bool:
    """Whether a law may take the place of an ordinary friction that every joint has: another such friction,
    or one with it as a special case. Any other is looked for beside it."""
    return rival.ordinary or replaced.name in rival.contains


def _needed(explained: float, scanned: Sequence[Scored], key: Key) -> float:
    """Energy that a rival must remove to be tried in the place of an effect: what the effect explains, or to
    first order, as rivals are scanned, where that is less."""
    return min(explained, max((s.removes for s in scanned if s.candidate.key == key), default=explained))


def _still_better(refitted: Fit, result: Fit) -> bool:
    """Whether a set with one effect exchanged is better than `result` at its own noise level, too."""
    if degenerate(refitted.problem, refitted.effects[-1]):
        return False
    return choose([fit(refitted.problem, result.effects), refitted]) is refitted


def _containing(task: tuple[Fit, str]) -> list[Fit]:
    return [evaluated(f) for f in containing(*task)]


def containing(result: Fit, replaced: str) -> list[Fit]:
    """Where the last effect of a set contains the `replaced` one as a special case: the set without each
    other effect of that joint in turn, which the wider effect may make unnecessary (a friction with two
    levels is Coulomb friction and an offset)."""
    added = result.effects[-1]
    if replaced not in added.effect.contains:
        return []
    beside = [e for e in result.effects[:-1] if e.joint == added.joint]
    return [refit_without(result, other) for other in beside]


def united(result: Fit) -> Fit:
    """The set without effects that are special cases of another one on the same joint, where that one alone
    scores better, causes within other joints as they are."""
    for wide in result.effects:
        for narrow in result.effects:
            if narrow.joint != wide.joint or narrow.effect.name not in wide.effect.contains:
                continue
            if makes_room(narrow, result):  # without it the claim is back
                continue
            others = [e for e in result.effects if e is not narrow and e is not wide]
            for since in dict.fromkeys((wide.since, narrow.since)):
                one = replace(wide, since=since)
                alone = date_onset(fit_tried(result.problem, [*others, one], one))
                if score(alone) < score(result):
                    return united(alone)
    return result


def prune(
    result: Fit,
    pool: WorkerPool,
    standing: Mapping[Key, frozenset[Key]] | None = None,
    among: Collection[Key] | None = None,
) -> Fit:
    """Drop, one by one, the effects that the data do not support beside the others, or those `among` some. A
    special case of an effect's law takes its place where the data support that. What makes room for another
    effect stays as long as that does: beside the claim the law is another one. Effects that were supported
    beside the same neighbours (`standing`, or a round before) are not asked again. A set that leaves more
    than one without an effect has ended in a local minimum, and is fitted again from there."""
    result, known = united(result), dict(standing or {})
    again = True  # once: what is left after it is no matter of where a fit started
    while len(result.effects) > 1:
        asked = [
            e
            for e in result.effects
            if known.get(e.key) != _neighbours(result, e)
            and (among is None or e.key in among)
            and not makes_room(e, result)
        ]
        without = pool.map(_without_unsupported, [(result, e) for e in asked])
        parts = [f for f in without if f is not None and _keys(f) < _keys(result)]
        lower = [f for f in parts if f.energy < result.energy]
        freed = pool.map(_with_missing_effect, [(result, f) for f in lower]) if again else []
        best = min(freed, key=lambda f: f.energy, default=result)
        if best.energy < result.energy:
            result, again, known = at_own_level(best), False, {}
            continue
        known |= {e.key: _neighbours(result, e) for e, f in zip(asked, without, strict=True) if f is None}
        smaller = [f for f in without if f is not None]
        if not smaller:
            return result
        result = _all_dropped(result, smaller)
    return result


def _all_dropped(result: Fit, smaller: Sequence[Fit]) -> Fit:
    """The best of some smaller sets, or what drops as much on each joint at once, where that is better:
    effects that act within their joints do not replace those of another joint."""
    best = min(smaller, key=score)
    effects, joints = list(result.effects), set[str | None]()
    for one in sorted(smaller, key=score):
        gone = _keys(result) - _keys(one)
        changed = [
            e for e in (*result.effects, *one.effects) if (e.key in _keys(one)) != (e.key in _keys(result))
        ]
        at = {e.joint for e in changed}
        if joints & at or not all(acts_within_a_joint(e) for e in changed):
            continue
        joints |= at
        effects = [e for e in effects if e.key not in gone] + [e for e in changed if e.key not in gone]
    if len(joints) <= 1:
        return best
    together = fit(result.problem, effects)
    return together if score(together) < score(best) else best


def _without_unsupported(task: tuple[Fit, Planned]) -> Fit | None:
    """The set without one of its effects, or with a simpler law in its place; None where the data support
    that effect."""
    result, dropped = task
    without = refit_without(result, dropped)
    if supported(result, without, dropped):
        return None
    return evaluated(min([without, *_simpler(result, without, dropped)], key=score))


def _with_missing_effect(task: tuple[Fit, Fit]) -> Fit:
    """A set fitted again from the numbers of one that lacks some of its effects."""
    result, without = task
    have = _keys(without)
    return fit(result.problem, [*without.effects, *(e for e in result.effects if e.key not in have)])


def _simpler(result: Fit, without: Fit, effect: Planned) -> list[Fit]:
    """The sets with a special case of an effect's law in its place, where the data support that."""
    out = []
    taken = {e.key for e in result.effects}
    for simple in (one for name in effect.effect.contains for one in effect.special_cases(name)):
        if simple.key in taken:
            continue
        trial = fit(result.problem, [*without.effects, simple])
        if supported(trial, without, trial.effects[-1]):
            out.append(trial)
    return out
