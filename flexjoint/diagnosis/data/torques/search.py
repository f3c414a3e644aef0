"""Which errors of the data make the recorded torques follow the motion, where they do not as they are.

The change that leaves least is taken, then the next beside it; what is not needed in the end is dropped.
An error is reported when a joint's torque is far from what its motion takes, is near it once the error is
undone, and one load or one spring at work instead does not set as much right (rivals.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.data.change import Change, View
from flexjoint.diagnosis.data.torques.errors import gear, mounting, swapped, turned, unit, zero
from flexjoint.diagnosis.data.torques.follows import Balance, cost
from flexjoint.diagnosis.data.torques.rivals import explained_otherwise

MOST = 4  # changes of the motion that are looked for, one after the other
PLAIN = (  # of changes that are as good the first is named
    gear.GEAR,
    turned.TORQUE,
    turned.POSITION,
    turned.JOINT,
    swapped.JOINTS,
    swapped.TORQUES,
    swapped.POSITIONS,
    zero.ZERO,
    unit.UNIT,
    mounting.MOUNTING,
)
OF_MOTION: tuple[Callable[[Balance, View], Iterator[Change]], ...] = (
    gear.ratios,
    turned.positions,
    swapped.pairs,
    zero.angles,
    mounting.directions,
)
OF_TORQUES: tuple[Callable[[Balance, View], Iterator[Change]], ...] = (turned.torques, unit.factors)


@dataclass(frozen=True)
class Found:
    """An error that torques show: how much smaller (RMS) the balance of its joint is once it is undone, what
    is left of that torque then, and other changes that do as well."""

    change: Change
    joint: str
    factor: float
    left: float
    instead: tuple[Change, ...]


@dataclass(frozen=True)
class _Step:
    changes: tuple[Change, ...]
    misfits: np.ndarray
    instead: tuple[Change, ...] = ()

    @property
    def cost(self) -> float:
        return cost(self.misfits)


def found_errors(balance: Balance) -> tuple[Found, ...]:
    """The errors of the data that the torques show; none where real causes may stand behind them."""
    limits = balance.settings
    given = balance.misfits(View())
    if not balance.rows or np.max(given) < limits.wrong**2:
        return ()
    changes, instead = _needed(balance, *_forward(balance, given))
    if not changes:
        return ()
    final = balance.misfits(View.of(changes))
    changed = np.abs(given - final) > limits.changed
    if np.any(final[changed] > limits.right**2) or np.any(final > np.maximum(2.0 * given, limits.right**2)):
        return ()
    if len(changes) > 1 and explained_otherwise(balance, View(), given, final):
        return ()  # one real cause rather than several errors
    found = []
    for k, change in enumerate(changes):
        others = View.of(changes[:k] + changes[k + 1 :])
        without = balance.misfits(others)
        place = _shows(without, final, limits.wrong)
        if place is None or explained_otherwise(balance, others, without, final):
            return ()
        factor = float(np.sqrt(without[place] / max(final[place], 1e-12)))
        joint = balance.rows[place][1]
        found.append(Found(change, joint, factor, float(np.sqrt(final[place])), instead.get(id(change), ())))
    return tuple(found)


def _shows(without: np.ndarray, final: np.ndarray, wrong: float) -> int | None:
    """The row, wrong as it is, that a change clears most."""
    ratios = np.where(without >= wrong**2, without / np.maximum(final, 1e-12), 0.0)
    return int(np.argmax(ratios)) if np.max(ratios) > 0.0 else None


def _forward(balance: Balance, given: np.ndarray) -> tuple[tuple[Change, ...], dict[int, tuple[Change, ...]]]:
    """Changes, each the best beside those before, until nothing is far off; and what is as good as each."""
    step, instead = _Step((), given), {}
    for _ in range(MOST):
        if np.max(step.misfits) < balance.settings.wrong**2:
            break
        tried = [_torques(balance, step), *_motions(balance, step)]
        best = min(tried, key=lambda one: one.cost)
        near = [one for one in tried if _alike(one, best, balance.settings.alike)]
        best = min(near, key=_plainness)
        if best.cost > 0.9 * step.cost or not best.changes[len(step.changes) :]:
            break
        new = best.changes[len(step.changes) :]
        others = tuple(
            one.changes[-1] for one in near if one is not best and len(one.changes) == len(best.changes)
        )
        instead[id(new[-1])] = others if len(new) == 1 else ()
        step = best
    return step.changes, instead


def _alike(one: _Step, best: _Step, alike: float) -> bool:
    return one.cost <= alike**2 * best.cost + 1e-6


def _plainness(step: _Step) -> tuple[int, int]:
    return (len(step.changes), PLAIN.index(step.changes[-1].error) if step.changes else 0)


def _torques(balance: Balance, step: _Step) -> _Step:
    """The best sign and unit of each torque by itself: no other row depends on it."""
    view, limits = View.of(step.changes), balance.settings
    chosen: dict[tuple[str, str], tuple[float, Change]] = {}
    for propose in OF_TORQUES:
        for change in propose(balance, view):
            (key,) = change.torques
            row = balance.row(key, view.after(change))
            left = 1.0 if row is None else balance.misfit(row)
            if key not in chosen or left < chosen[key][0]:
                chosen[key] = (left, change)
    changes, misfits = step.changes, step.misfits.copy()
    for k, key in enumerate(balance.rows):
        if key not in chosen:
            continue
        left, change = chosen[key]
        if left * limits.times_smaller**2 <= misfits[k]:
            changes, misfits[k] = (*changes, change), left
    return _Step(changes, misfits)


def _motions(balance: Balance, step: _Step) -> list[_Step]:
    view = View.of(step.changes)
    out = []
    for propose in OF_MOTION:
        for change in propose(balance, view):
            out.append(_Step((*step.changes, change), balance.misfits(view.after(change))))
    return out


def _needed(
    balance: Balance, changes: tuple[Change, ...], instead: dict[int, tuple[Change, ...]]
) -> tuple[tuple[Change, ...], dict[int, tuple[Change, ...]]]:
    """Without the changes that clear no row by enough."""
    limits = balance.settings
    kept: Sequence[Change] = changes
    while kept:
        final = balance.misfits(View.of(kept))
        needed = []
        for k, change in enumerate(kept):
            without = balance.misfits(View.of([*kept[:k], *kept[k + 1 :]]))
            place = _shows(without, final, limits.wrong)
            if place is not None and without[place] >= limits.times_smaller**2 * final[place]:
                needed.append(change)
        if len(needed) == len(kept):
            break
        kept = needed
    return tuple(kept), instead
