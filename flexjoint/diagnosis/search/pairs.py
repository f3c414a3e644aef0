"""Two causes of one joint that only together explain what is wrong with it.

A search that adds one cause at a time stops where each of two takes too little by itself to be told from what
else may be wrong: a late torque, where friction also gives way before it slips. So once no single cause is
found, each joint of which a balance is wrong is looked at two causes ahead. An effect that was found first
may have taken numbers with which it also explains what another one is there for (a gap that also explains an
offset to one side), from which no fit leads away: in the end two causes are looked for in the place of one,
that one among them. What two effects remove together follows, to first order, from the products of their
traces alone; only the best pairs are fitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from flexjoint.core.running.budget import checkpoint
from flexjoint.core.running.worker_pool import WorkerPool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.search.criteria import (
    at_own_level,
    by_joint,
    makes_room,
    only_by_implausible,
    supported,
)
from flexjoint.diagnosis.search.rivals import Key
from flexjoint.diagnosis.search.scan import RIDGE, Products, Scanner, bounds_of
from flexjoint.diagnosis.search.trials import (
    both_added_to,
    cleared,
    clears,
    judged_levels,
    marked,
    might_clear,
)
from flexjoint.diagnosis.settings import SearchSettings
from flexjoint.effects import Planned


@dataclass(frozen=True)
class Pair:
    """Two effects with the numbers that explain most together, and the energy that they remove, to first
    order."""

    planned: tuple[Planned, Planned]
    removes: float

    @property
    def keys(self) -> frozenset[Key]:
        return frozenset(e.key for e in self.planned)


def joint_pairs(best: Fit, bare: Fit, joints: Sequence[str], scanner: Scanner, pool: WorkerPool) -> list[Fit]:
    """Sets with the two causes of one of some joints that clear most of what is wrong with it, each at the
    noise level that it leaves. `bare` is the set `best` fitted at the level of the predicted noise. Joints
    without room for two more causes are left out."""
    most, count = best.settings.search.most_on_joint, by_joint(best.effects)
    room = [joint for joint in joints if count[joint] + 2 <= most]
    tried = pool.map(_tried, [(best, bare, joint, scanner) for joint in room])
    return [f for f in tried if f is not None]


def pairs_instead(
    best: Fit, bare: Fit, joints: Sequence[str], scanner: Scanner, pool: WorkerPool
) -> list[Fit]:
    """As `joint_pairs`, each pair in the place of one of the causes of its joint."""
    most, count = best.settings.search.most_on_joint, by_joint(best.effects)
    room = {joint for joint in joints if count[joint] < most}
    tasks = [
        (best, refit_without(bare, e), str(e.joint), scanner)
        for e in bare.effects
        if e.joint in room and acts_within_a_joint(e) and not makes_room(e, bare)
    ]
    return [f for f in pool.map(_tried, tasks) if f is not None]


def _tried(task: tuple[Fit, Fit, str, Scanner]) -> Fit | None:
    """The pair of causes of a joint that clears most of what is wrong with it, at the noise level that it
    leaves; None where none clears enough there, or has two causes of which each is supported beside the
    other."""
    best, bare, joint, scanner = task
    limits = best.settings.search
    implausible = best.problem.level.implausible > 1.0
    trials: list[tuple[float, frozenset[Key], Fit]] = []
    for pair in best_pairs(scanner.products(bare, joint), limits.paired, limits):
        checkpoint()
        trial = (
            both_added_to(bare, pair.planned) if might_clear(best, bare, pair.planned, pair.removes) else None
        )
        if trial is not None:
            trials.append(
                (cleared(best, bare.problem.variances(trial.y), _new(bare, trial)), pair.keys, trial)
            )
    for share, keys, trial in sorted(trials, key=lambda one: -one[0]):
        if share < np.log(limits.cleared) and not implausible:
            break
        both = at_own_level(trial, trial.effects[-1])
        relieved = implausible and both.problem.level.implausible <= 1.0
        if not relieved and not clears(best, judged_levels(best, both), _new(bare, both)):
            continue
        if only_by_implausible(both, best):
            continue
        causes = [e for e in both.effects if e.key in keys]
        if all(supported(both, refit_without(both, e), e) for e in causes):
            return both
    return None


def _new(bare: Fit, larger: Fit) -> np.ndarray:
    """(rows,) bool: the balances that the effects change that a larger set has at its end."""
    return marked(larger, len(larger.effects) - len(bare.effects))


def best_pairs(products: Products, count: int, settings: SearchSettings) -> list[Pair]:
    """The pairs of effects that remove most energy together, best first, each at its best starts. Without
    their bounds two traces remove at least as much as within them, so that pairs are solved within bounds in
    the order of what they remove without, as long as that is more than the last of the best ones removes."""
    found: dict[frozenset[Key], Pair] = {}
    enough = 0.0
    for most, i, j in _unbounded(products):
        if most <= enough:
            break
        pair = _within_bounds(products, i, j, settings)
        if pair.removes > enough and (pair.keys not in found or pair.removes > found[pair.keys].removes):
            found[pair.keys] = pair
            removed = sorted((one.removes for one in found.values()), reverse=True)
            enough = removed[count - 1] if len(removed) >= count else 0.0
    return sorted(found.values(), key=lambda pair: -pair.removes)[:count]


def _unbounded(products: Products) -> list[tuple[float, int, int]]:
    """What two traces of different effects remove with any amplitudes, most first, with their numbers."""
    visible = products.visible()
    widths = {k: products.places[k].stop - products.places[k].start for k in visible}
    keys = [trace.candidate.key for trace in products.traces]
    out: list[tuple[float, int, int]] = []
    # traces with as many columns make one stack of equations
    for a, b in itertools.combinations_with_replacement(sorted(set(widths.values())), 2):
        left, right = ([k for k in visible if widths[k] == width] for width in (a, b))
        pairs = [(i, j) for i in left for j in right if (a != b or i < j) and keys[i] != keys[j]]
        if not pairs:
            continue
        at = np.array([[*_columns(products, i), *_columns(products, j)] for i, j in pairs])
        curvature, force = _of_unit_size(products, at)
        removes = np.sum(force * np.linalg.solve(curvature, force[:, :, None])[:, :, 0], axis=1)
        out += [(float(gain), i, j) for gain, (i, j) in zip(removes, pairs, strict=True)]
    return sorted(out, key=lambda one: (-one[0], one[1], one[2]))


def _within_bounds(products: Products, i: int, j: int, settings: SearchSettings) -> Pair:
    """Two traces with the amplitudes that remove most within their bounds."""
    traces = products.traces[i], products.traces[j]
    at = np.array([*_columns(products, i), *_columns(products, j)])
    curvature, force = _of_unit_size(products, at)
    bounds = np.hstack([bounds_of(trace, settings) for trace in traces])
    size = np.sqrt(np.diag(products.curvature)[at])
    # of x'Ax + 2 b'x with A = R'R the minimum is that of |R x + R'^-1 b|
    energies, axes = np.linalg.eigh(curvature)
    roots = np.sqrt(np.maximum(energies, RIDGE))
    x = lsq_linear(roots[:, None] * axes.T, -(axes.T @ force) / roots, bounds * size, method="bvls").x
    removes = -float(x @ curvature @ x + 2.0 * force @ x)
    width = products.places[i].stop - products.places[i].start
    amplitudes = np.split(x / size, [width])
    first, second = (
        trace.candidate.planned(trace.values(amplitude))
        for trace, amplitude in zip(traces, amplitudes, strict=True)
    )
    return Pair((first, second), removes)


def _columns(products: Products, k: int) -> range:
    place = products.places[k]
    return range(place.start, place.stop)


def _of_unit_size(products: Products, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (..., n, n) and force (..., n) of columns `at` (..., n) scaled to unit length, with a ridge
    for those that are alike."""
    size = np.sqrt(np.diag(products.curvature))[at]
    curvature = products.curvature[at[..., :, None], at[..., None, :]] / (
        size[..., :, None] * size[..., None, :]
    )
    return curvature + RIDGE * np.eye(at.shape[-1]), products.force[at] / size
