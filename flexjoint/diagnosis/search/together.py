"""Several recordings of one robot: the set of causes that explains all of them with one set of numbers.

Every recording is searched by itself. What they propose, their chosen sets and the rivals of each cause, is
then fitted to each of them; near its own optimum a recording's residual is linear, so the numbers common to
all follow (shared_numbers.py). The energy of the set is the sum over all recordings, with deviations of the
nominal numbers that are common to all, too. The price of a set is paid once: a cause that only one recording
shows must explain that price in this recording alone, and two causes that fit one recording equally well are
distinguished by another one. Where the recordings disagree on the numbers, each may have its own, at the
price of so many more numbers: a note says so, those of the first recording are reported, and the standard
errors grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, fit, normal_equations
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.shared_numbers import SharedNumbers
from flexjoint.diagnosis.regression.uncertainty import Errors, certainty
from flexjoint.diagnosis.search.criteria import degenerate, price, score
from flexjoint.diagnosis.search.selection import Key, Selection, granted
from flexjoint.effects import Planned, numbers_beyond

Names = frozenset[tuple[object, ...]]


@dataclass(frozen=True)
class Together:
    """The common set, fitted to the first recording; standard errors of its numbers from all recordings, by
    effect and parameter; and notes about it."""

    selection: Selection
    errors: dict[Key, Errors]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Joint:
    """One set of effects fitted to all recordings."""

    effects: tuple[Planned, ...]
    energy: float
    fits: tuple[Fit, ...]  # each recording's own optimum
    normals: tuple[np.ndarray, ...]
    numbers: np.ndarray  # (slots,) common to all
    curvature: np.ndarray  # (slots, slots) of the energy in them
    apart: bool  # the recordings do not agree: each has its own numbers

    @property
    def price(self) -> float:
        return price(self.fits[0])

    @property
    def score(self) -> float:
        return self.energy + self.price


def combine(selections: Sequence[Selection]) -> Together:
    """The best set for all recordings, among those that any of them proposes. An effect that sets in during a
    recording, or comes and goes, is a cause of that recording only: the others are judged beside it, and
    those of the first recording are kept for it."""
    proposals = _proposals(selections)
    problems = [s.best.problem.beside(_dated(s.best)) for s in selections]
    joints = {key: _fitted(problems, effects) for key, effects in proposals.items()}
    first = selections[0]
    best_key = _chosen(first.nothing, joints)
    best = joints[best_key]
    dated = _dated(first.best)
    problem = first.best.problem
    lasting = best.fits[0].effects if best.apart else best.effects
    chosen = fit(problem, [*lasting, *dated], iterations=0)
    rivals = tuple(
        tuple(
            replace(
                fit(problem, [*kept, *dated, _other(kept, joint)], iterations=0),
                judge=partial(float, chosen.energy + joint.energy - best.energy),
            )
            for kept, joint in _with_another(best, best_key, effect, joints)
        )
        for effect in best.effects
    ) + tuple(first.rivals[first.best.effects.index(e)] for e in dated)
    bare = {e.key: joints.get(best_key - {_identity(e)}) for e in best.effects}
    selection = replace(
        first,
        best=chosen,
        rivals=tuple(tuple(sorted(r, key=score)) for r in rivals),
        explains={key: joint.energy - best.energy for key, joint in bare.items() if joint is not None},
    )
    return Together(selection, _errors(best), _notes(best))


def _dated(best: Fit) -> tuple[Planned, ...]:
    return tuple(e for e in best.effects if e.since is not None)


def _chosen(nothing: Fit, joints: Mapping[Names, _Joint]) -> Names:
    """The best set whose causes are all confirmed by the recordings together (`_sure`), or the simplest of
    those whose scores differ by no more than `selection.granted`."""
    ranked = sorted(joints, key=lambda key: joints[key].score)
    sure = [key for key in ranked if _sure(nothing, joints[key])]
    best, bare = joints[sure[0]], joints[frozenset()]
    close = best.score + granted(best.fits, bare.energy - best.energy)
    return min(
        (key for key in sure if joints[key].score <= close),
        key=lambda key: (joints[key].price, joints[key].score),
    )


def _identity(effect: Planned) -> tuple[object, ...]:
    return (*effect.key, *(effect.values.get(w.name) for w in effect.effect.words))


def _proposals(selections: Sequence[Selection]) -> dict[Names, tuple[Planned, ...]]:
    """The sets that are compared, each with its start values: the empty set, each recording's own set, the
    union of all, the causes that all share, and each of these sets with a cause left out or exchanged."""
    out: dict[Names, tuple[Planned, ...]] = {}

    def propose(effects: Sequence[Planned]) -> None:
        lasting = {_identity(e): e for e in effects if e.since is None}
        joints = {(e.effect.name, e.joint) for e in lasting.values()}
        if len(joints) == len(lasting):
            out.setdefault(frozenset(lasting), tuple(lasting.values()))

    own = [[e for e in s.best.effects if e.since is None] for s in selections]
    propose([])
    for effects in own:
        propose(effects)
    union = {_identity(e): e for effects in own for e in effects}
    propose(list(union.values()))
    propose([e for e in own[0] if all(_identity(e) in {_identity(o) for o in other} for other in own[1:])])
    found = list(out.values())
    single = [e for s in selections for r in s.rivals for f in r for e in f.effects[-1:]]
    for known in found:
        for effect in known:
            others = [e for e in known if e is not effect]
            propose(others)
            for rival in (*single, *union.values()):
                if _identity(rival) not in {_identity(e) for e in known}:
                    propose([*others, rival])
    return out


def _fitted(problems: Sequence[Problem], effects: tuple[Planned, ...]) -> _Joint:
    fits = [fit(problem, effects) for problem in problems]
    normals = [
        normal_equations(f.problem, f.tangents, f.y, f.slots, f.effects)[0] if f.slots else np.zeros((0, 0))
        for f in fits
    ]
    slots = fits[0].slots
    own = [np.array([slot.get(f.effects) for slot in slots]) for f in fits]
    for k, slot in enumerate(slots):
        if slot.param.wraps:
            for numbers in own[1:]:
                numbers[k] += 2.0 * np.pi * np.round((own[0][k] - numbers[k]) / (2.0 * np.pi))
    shared = SharedNumbers([f.problem for f in fits])
    numbers, curvature = shared.solve(fits, own)
    common = list(fits[0].effects)
    for slot, number in zip(slots, numbers, strict=True):
        slot.put(common, float(np.clip(number, slot.param.low, slot.param.high)))
    there = [fit(problem, common, iterations=0) for problem in problems]
    energy = sum(f.energy for f in there) + shared.surplus([f.y for f in there])
    apart = sum(f.energy for f in fits) + shared.surplus([f.y for f in fits])
    apart += problems[0].settings.search.price_number * len(slots) * (len(problems) - 1)
    return _Joint(
        tuple(common),
        float(min(energy, apart)),
        tuple(fits),
        tuple(normals),
        numbers,
        curvature,
        bool(apart < energy),
    )


def _with_another(
    best: _Joint, best_key: Names, effect: Planned, joints: dict[Names, _Joint]
) -> list[tuple[list[Planned], _Joint]]:
    """The fitted sets that hold another cause in the place of one."""
    kept = best_key - {_identity(effect)}
    return [
        ([e for e in joint.effects if _identity(e) in kept], joint)
        for key, joint in joints.items()
        if len(key) == len(best_key) and kept < key and key != best_key
    ]


def _other(kept: Sequence[Planned], joint: _Joint) -> Planned:
    return next(e for e in joint.effects if e not in kept)


def _sure(nothing: Fit, joint: _Joint) -> bool:
    """Whether the recordings together confirm each cause of a set and its law: its size, and the numbers that
    it has beyond those of a simpler law which it contains, differ from none by enough standard errors."""
    errors, nominal = _errors(joint), replace(nothing, effects=joint.effects)
    for e in joint.effects:
        laws = [e.effect.nulls, *(numbers_beyond(e.effect, name) for name in e.effect.contains)]
        known = [certainty(nominal, e, errors[e.key], numbers) for numbers in laws if numbers]
        if degenerate(nothing.problem, e) or min(known) < nothing.settings.search.present:
            return False
    return True


def _errors(best: _Joint) -> dict[Key, Errors]:
    """Standard errors from the curvature of all recordings, widened where the recordings disagree by more."""
    out: dict[Key, Errors] = {e.key: {} for e in best.effects}
    if not len(best.numbers):
        return out
    deviation = np.sqrt(np.diag(np.linalg.pinv(best.curvature)))
    for k, slot in enumerate(best.fits[0].slots):
        apart = [(slot.get(f.effects) - best.numbers[k]) ** 2 * n[k, k] for f, n in _each(best)]
        spread = np.sqrt(max(1.0, sum(apart) / max(1, len(apart) - 1)))
        out[best.effects[slot.effect].key].setdefault(slot.param.name, []).append(
            float(deviation[k] * spread)
        )
    return out


def _notes(best: _Joint) -> tuple[str, ...]:
    count = len(best.fits)
    notes = [f"causes and numbers common to all {count} recordings"]
    if best.apart:
        notes = [
            f"causes common to all {count} recordings, numbers of the first: each recording gives others"
        ]
    disagree = best.fits[0].settings.search.disagree
    for k, slot in enumerate(best.fits[0].slots):
        own = [slot.get(f.effects) for f in best.fits]
        apart = [
            abs(x - best.numbers[k]) * np.sqrt(n[k, k]) for x, (_, n) in zip(own, _each(best), strict=True)
        ]
        shown = [f"{x:.3g}" for x in own]
        if max(apart) > disagree and not slot.param.wraps and len(set(shown)) > 1:
            each = ", ".join(shown)
            planned = best.effects[slot.effect]
            unit = slot.param.unit_at(planned.joint in best.fits[0].problem.robot.prismatic)
            notes.append(f"the recordings disagree on {slot.param.name} of {planned}: {each} {unit}".rstrip())
    return tuple(notes)


def _each(best: _Joint) -> list[tuple[Fit, np.ndarray]]:
    return list(zip(best.fits, best.normals, strict=True))
