"""What a check may do to a set of causes: take one out, or put an alternative in its place."""

from __future__ import annotations

from dataclasses import replace

from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.search.criteria import (
    at_own_level,
    degenerate,
    given_up_for,
    known_sizes,
    supported,
)
from flexjoint.diagnosis.search.rivals import Rivals
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
    *beside, _ = selection.rivals_beside(refitted)
    others = [r.effects for r in selection.rivals[k] if r is not rival]
    return replace(
        selection, best=refitted, rivals=(*beside, Rivals.of(refitted, rival.effects[-1].key, others))
    )


def without(selection: Selection, effect: Planned) -> Selection:
    """The selection with one of its causes taken out, the others fitted again. What made room for it, of what
    the nominal model claims, stays where its size is known by itself."""
    best = selection.best
    left = at_own_level(fit(best.problem, [e for e in best.effects if e.key != effect.key]))
    room = given_up_for(effect, best.effects, best.problem.nominal)
    if room is not None:
        k = next(k for k, e in enumerate(left.effects) if e.key == room.key)
        certain, needed = known_sizes(left, left.settings.verdict.sure)
        if certain[k] < needed[k]:
            left = at_own_level(refit_without(left, left.effects[k]))
    return replace(selection, best=left, rivals=selection.rivals_beside(left))
