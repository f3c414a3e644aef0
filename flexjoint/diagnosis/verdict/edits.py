"""What a check may do to a set of causes: take one out, or put an alternative in its place."""

from __future__ import annotations

from dataclasses import replace

from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.search.criteria import at_own_level, degenerate, score, supported
from flexjoint.diagnosis.search.selection import Selection, choose
from flexjoint.effects import Planned


def plainer(selection: Selection, shrunk: Planned) -> Selection:
    """The selection with the best rival in the place of a law that has shrunk, or without that law where the
    data support no rival."""
    best = selection.best
    k = next(k for k, e in enumerate(best.effects) if e.key == shrunk.key)
    simplest = refit_without(best, best.effects[k])
    fits = [
        r
        for r in selection.rivals[k]
        if len(r.effects) == len(best.effects) and supported(r, simplest, r.effects[-1])
    ]
    if not fits:
        return without(selection, shrunk)
    rival = choose(fits)
    refitted = at_own_level(rival)
    if degenerate(refitted.problem, refitted.effects[-1]):
        return without(selection, shrunk)
    return given_way(selection, k, rival, refitted)


def given_way(selection: Selection, k: int, rival: Fit, refitted: Fit) -> Selection:
    """The selection with a rival, `refitted` at its own noise level, in the place of effect k; the other
    rivals of that effect become rivals of it."""
    kept = tuple(r for i, r in enumerate(selection.rivals) if i != k)
    left = [fit(refitted.problem, r.effects) for r in selection.rivals[k] if r is not rival]
    return replace(selection, best=refitted, rivals=(*kept, tuple(sorted(left, key=score))))


def without(selection: Selection, effect: Planned) -> Selection:
    """The selection with one of its causes taken out, the others and their rivals fitted again."""
    best = selection.best
    keep = [k for k, e in enumerate(best.effects) if e.key != effect.key]
    left = at_own_level(fit(best.problem, [best.effects[k] for k in keep]))

    def again(rivals: tuple[Fit, ...]) -> tuple[Fit, ...]:
        sets = [[e for e in rival.effects if e.key != effect.key] for rival in rivals]
        return tuple(sorted((fit(left.problem, effects) for effects in sets), key=score))

    return replace(selection, best=left, rivals=tuple(again(selection.rivals[k]) for k in keep))
