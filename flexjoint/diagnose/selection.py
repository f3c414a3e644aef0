"""Which set of effects explains the recording: scan, fit the best, add, exchange, prune, date. What an effect
must be to enter is said in worth.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.diagnose.candidates import Candidate
from flexjoint.diagnose.fit import Fit, fit
from flexjoint.diagnose.scan import Scanner, Scored
from flexjoint.diagnose.workspace import Workspace
from flexjoint.diagnose.worth import (
    CLEARED,
    LEFTOVER,
    at_own_level,
    contradicted,
    degenerate,
    leftover,
    price,
    score,
    worthwhile,
)
from flexjoint.effect import Planned

FILTERED = 1e-5  # share of the explained energy by which laws differ as filtered balances see their kinks ...
FILTERED_BLIND = (
    1e-4  # ... and where a position is made of the nominal model, which is known to first order only
)
POLISHED = 8  # candidates fitted in full at each stage, at most ...
PROMISING = 0.3  # ... with this share of the best one's first-order gain ...
RIVALLING = 0.7  # ... and, as rivals of an effect, this share of what it explains
MOST_EFFECTS = 12
MOST_EXCHANGES = 4
ONSET_STEPS = (  # s, of the search for an onset, with a fit of the numbers after each row: a jump of an
    (0.25, 0.1, 0.04),  # encoder is seen to the sample, and dated wrongly explains nothing
    (0.015, 0.006, 0.002),
)

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Selection:
    """The chosen set with its fit, the first scan, and the alternatives to each chosen effect."""

    best: Fit
    nothing: Fit  # no effect beyond the nominal model
    scan: tuple[Scored, ...]  # of the nominal model, best start of each candidate
    last_scan: tuple[Scored, ...]  # of the chosen set: what was looked for beyond it
    rivals: tuple[tuple[Fit, ...], ...]  # per chosen effect: fits with another in its place, best first


def select(
    workspace: Workspace, candidates: Sequence[Candidate], report: Progress, start: Sequence[Planned] = ()
) -> Selection:
    """Forward selection with full refits, exchanges and pruning; `start` seeds the set."""
    nothing = at_own_level(fit(workspace, []))
    best = at_own_level(fit(workspace, start)) if start else nothing
    scanner = Scanner(candidates)
    first: tuple[Scored, ...] = ()
    scanned: tuple[Scored, ...] = ()
    rivals: tuple[tuple[Fit, ...], ...] = ()
    seen = {_keys(best)}  # a cause may enter at its own level and not stay at that of the set
    while len(best.effects) < MOST_EFFECTS:
        report(len(best.effects) / (len(best.effects) + 2.0), f"looking for cause {len(best.effects) + 1}")
        bare = at_noise(best)
        scanned, *beyond = scanner.scans([best] if bare is None else [best, bare])
        first = first or scanned
        trials = polish(best, scanned)
        found = [f for f in trials if worthwhile(f, best, f.effects[-1])]
        found = on_one_level([*found, *clearing(best, trials, bare, beyond)])
        if not found:
            break
        best = prune(at_own_level(choose(found)))
        if _keys(best) in seen:
            break
        seen.add(_keys(best))
        newest = best.effects[-1]
        best, _ = exchange(
            scanner, best, [e for e in best.effects if e.joint == newest.joint and e is not newest]
        )
    report(0.9, "comparing rival causes")
    best, rivals = exchange(scanner, best, best.effects)
    return Selection(best, nothing, first, scanned, rivals)


def _keys(result: Fit) -> frozenset[tuple[str, str | None]]:
    return frozenset(e.key for e in result.effects)


def at_noise(best: Fit) -> Fit | None:
    """The set fitted at the level of the predicted noise; None where neither a balance is wrong nor a nominal
    number implausible."""
    workspace = best.workspace
    if workspace.strain <= 1.0 and not np.any(workspace.temper > CLEARED):
        return None
    return fit(workspace.at(np.ones_like(workspace.temper)), best.effects)


def clearing(
    best: Fit, trials: Sequence[Fit], bare: Fit | None, scanned: Sequence[tuple[Scored, ...]]
) -> list[Fit]:
    """Sets of one more effect that leave a tenth of the variance in the balances that are wrong, or no
    nominal number implausible, each at the level that it leaves. At the level of `best`, at which hardly
    anything counts, they need not show: the scan of the `bare` set at the predicted noise is looked at,
    too."""
    if bare is None:
        return []
    strained = best.workspace.strain > 1.0
    left = best.workspace.temper / best.workspace.strain
    wrong = left > CLEARED

    def clears(levels: np.ndarray) -> bool:
        return bool(np.any(wrong) and np.mean(np.log(left[wrong] / levels[wrong])) >= np.log(CLEARED))

    out = []
    for trial in (*trials, *(one for scan in scanned for one in polish(bare, scan))):
        if strained or clears(bare.workspace.levels(trial.y)):
            settled = at_own_level(trial)
            relieved = strained and settled.workspace.strain <= 1.0
            if relieved or clears(settled.workspace.temper):
                without = fit(settled.workspace, best.effects)
                if worthwhile(settled, without, settled.effects[-1]):
                    out.append(settled)
    return out


def on_one_level(fits: Sequence[Fit]) -> list[Fit]:
    """The fits at the lowest level among theirs."""
    if not fits:
        return []
    lowest = min((f.workspace for f in fits), key=lambda w: float(np.sum(np.log(w.temper))))
    return [f if f.workspace is lowest else fit(lowest, f.effects) for f in fits]


def choose(fits: Sequence[Fit]) -> Fit:
    """The best score; of those that differ by little against what all leave unexplained, or against what
    filters leave of all that is explained, the plainest."""
    best = min(fits, key=score)
    bare = best.workspace.energy(best.workspace.residual([]))
    share = FILTERED_BLIND if best.workspace.motion.missing else FILTERED
    close = score(best) + LEFTOVER * leftover(best) + share * max(0.0, bare - best.energy)
    return min((f for f in fits if score(f) <= close), key=lambda f: (price(f.workspace, f.effects), score(f)))


def polish(current: Fit, scanned: Sequence[Scored], needed: float = 0.0) -> list[Fit]:
    """The most promising candidates fitted together with the current set, and dated: those whose first-order
    gain comes near the best one's, and near the `needed` energy."""
    out: list[Fit] = []
    if not scanned:
        return out
    most = scanned[0].removes  # to first order; what is `needed` may lie beyond it
    enough = max(PROMISING * most, RIVALLING * min(needed, most), 1.0)
    for scored in scanned[:POLISHED]:
        if scored.removes >= enough:
            fitted = date_onset(fit(current.workspace, [*current.effects, scored.planned()]))
            if not degenerate(current.workspace, fitted.effects[-1]):
                out.append(fitted)
    return out


def exchange(
    scanner: Scanner, result: Fit, places: Sequence[Planned]
) -> tuple[Fit, tuple[tuple[Fit, ...], ...]]:
    """Try other candidates in the place of some effects; keep what scores better. Also returns, for every
    effect that stays, the fits with a rival in its place, best first."""
    rivals: dict[tuple[str, str | None], tuple[Fit, ...]] = {}
    waiting = [e.key for e in places]
    exchanges = 0  # bounded, so that two equals do not alternate for ever
    while waiting:
        key = waiting.pop(0)
        others = [e for e in result.effects if e.key != key]
        if len(others) == len(result.effects):
            continue
        without = fit(result.workspace, others)
        needed = without.energy - result.energy
        fits = [f for f in polish(without, scanner.scan(without), needed) if f.effects[-1].key != key]
        fits = [f for f in fits if not contradicted(f, without)]
        fits += [alone for f in fits for alone in containing(f, key[0])]
        swapped = choose([result, *fits])
        if swapped is not result and exchanges < MOST_EXCHANGES:
            exchanges += 1
            settled = at_own_level(swapped)
            if _still_better(settled, result):
                result = prune(settled)
                waiting = [e.key for e in result.effects]
                continue
        rivals[key] = tuple(sorted(fits, key=score))
    return result, tuple(rivals.get(e.key, ()) for e in result.effects)


def _still_better(settled: Fit, result: Fit) -> bool:
    """Whether a set with another effect in it is better than a `result` at its own level, too."""
    if degenerate(settled.workspace, settled.effects[-1]):
        return False
    return choose([fit(settled.workspace, result.effects), settled]) is settled


def containing(result: Fit, replaced: str) -> list[Fit]:
    """Where the last effect of a set contains the `replaced` one as a special case: the set without each
    other effect of that joint, whose part it may play too (two levels are a Coulomb level and an offset)."""
    added = result.effects[-1]
    if replaced not in added.effect.contains:
        return []
    beside = [e for e in result.effects[:-1] if e.joint == added.joint]
    return [fit(result.workspace, [e for e in result.effects if e is not other]) for other in beside]


def united(result: Fit) -> Fit:
    """The set without effects that another one of the same joint contains as a special case, where that one
    does as well alone."""
    for wide in result.effects:
        for narrow in result.effects:
            if narrow.joint != wide.joint or narrow.effect.name not in wide.effect.contains:
                continue
            others = [e for e in result.effects if e is not narrow and e is not wide]
            for since in dict.fromkeys((wide.since, narrow.since)):
                alone = date_onset(fit(result.workspace, [*others, replace(wide, since=since)]))
                if score(alone) < score(result):
                    return united(alone)
    return result


def prune(result: Fit) -> Fit:
    """Drop, one by one, the effects that are not worth keeping beside the others."""
    result = united(result)
    while len(result.effects) > 1:
        cheapest: Fit | None = None
        for dropped in result.effects:
            without = fit(result.workspace, [e for e in result.effects if e is not dropped])
            if not worthwhile(result, without, dropped) and (
                cheapest is None or score(without) < score(cheapest)
            ):
                cheapest = without
        if cheapest is None:
            return result
        result = cheapest
    return result


def date_onset(result: Fit) -> Fit:
    """Refine when the last effect set in, or find that it was always there."""
    added = result.effects[-1]
    if added.since is None:
        return result
    workspace = result.workspace
    always = fit(workspace, [*result.effects[:-1], replace(added, since=None)])
    for steps in ONSET_STEPS:
        moved = _moved_onset(result, steps)
        if moved != result.effects[-1].since:
            trial = fit(workspace, [*result.effects[:-1], replace(result.effects[-1], since=moved)])
            if trial.energy < result.energy:
                result = trial
    return (
        always if score(always) < score(result) + 0.01 * max(0.0, always.energy - result.energy) else result
    )


def _moved_onset(result: Fit, steps: Sequence[float]) -> float:
    """Where, in ever smaller steps from its onset, the last effect of a set would have set in best, all
    numbers held."""
    workspace, added = result.workspace, result.effects[-1]

    def energy(since: float) -> float:
        if not 0.0 < since < workspace.balances.chains.t[-1]:
            return np.inf
        return workspace.energy(workspace.residual([*result.effects[:-1], replace(added, since=since)]))

    best = float(added.since or 0.0)
    least = energy(best)
    for step in steps:
        start = best
        for sign in (-1.0, 1.0):
            if best == start:  # it is on one side
                while (there := energy(best + sign * step)) < least:
                    least, best = there, best + sign * step
    return best
