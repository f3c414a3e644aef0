"""Joint fit of all parameters of a set of effects: Levenberg-Marquardt on the whitened residual with the
nominal model's tolerances marginalised in every step (variable projection)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexjoint.core.running.budget import checkpoint
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.deviations import (
    converged_deviations,
    every_deviation,
    judged_energy,
    relinearised,
)
from flexjoint.diagnosis.regression.nuisance import entangles
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.settings import RegressionSettings, Settings
from flexjoint.effects import Effect, Parameter, Planned, Site

MOST_DAMPING = 1e8  # of a scaled step: with more damping no step lowers the energy
RELATIVE_STEP = 1e-3  # of finite differences: well above rounding, well below a parameter's own scale
CONVERGED = 0.02  # gain in energy below which an iteration ends the fit: far below any price
TRIED = 1e-3  # and, of a set that is only tried, as a share of the unexplained energy: far below what decides
LEAST_VARIANCE = 1e-200  # of a number: what is less is rounding
NOTHING = 1e-3  # of that gain: a step that promises less is none
NEARLY_SAME = 0.5  # of the gain that a step promised in vain: one that promises more is nearly the same step
SCALED = 4.0  # factor by which a step may change a scale: far from its place the energy is flat
HALF = 0.5  # of a load's mass, below which a step along its moments is tried, too
NEAR = 0.01  # relative change of a joint's numbers up to which its derivatives are not computed again


@dataclass(frozen=True)
class Slot:
    """The place of one free number in a set of effects: an effect, its parameter, and an entry of that."""

    effect: int
    param: Parameter
    component: int  # of a vector parameter

    def get(self, effects: Sequence[Planned]) -> float:
        value = effects[self.effect].values[self.param.name]
        return float(value[self.component]) if self.param.size > 1 else float(value)

    def put(self, effects: list[Planned], number: float) -> None:
        planned = effects[self.effect]
        value: Any = float(number)
        if self.param.size > 1:
            vector = list(planned.values[self.param.name])
            vector[self.component] = float(number)
            value = tuple(vector)
        effects[self.effect] = planned.with_values({self.param.name: value})


@dataclass(frozen=True)
class Fit:
    """A fitted set of effects (beyond the nominal model, or replacing its entries)."""

    problem: Problem
    effects: tuple[Planned, ...]
    judge: Callable[[], float]  # what evaluates `energy`
    y: np.ndarray  # (samples,) whitened residual
    tangents: np.ndarray  # (slots, samples) its derivatives
    slots: tuple[Slot, ...]

    @property
    def settings(self) -> Settings:
        return self.problem.settings

    @cached_property
    def energy(self) -> float:
        """Energy at the optimum (`judged_energy`), plus weak priors. Evaluated when it is first needed: a fit
        that is only a step to another noise level never needs it."""
        return self.judge()

    @cached_property
    def furthest(self) -> float:
        """Prior deviations by which the nominal number that is furthest off deviates."""
        return self.problem.furthest(self.y)


def shifts(result: Fit) -> list[Planned]:
    """The deviations of the nominal numbers beside the fitted effects, as effects of their own. Products of
    two deviations (a stiffness with its encoders' offsets) are included."""
    return every_deviation(result.problem, nominal_deviations(result))


def nominal_deviations(result: Fit) -> np.ndarray:
    """(numbers,) deviations of the nominal numbers beside the fitted effects."""
    return converged_deviations(result.problem, result.effects, result.y)


def slots_of(effects: Sequence[Planned]) -> tuple[Slot, ...]:
    return tuple(
        Slot(i, param, component)
        for i, planned in enumerate(effects)
        for param in planned.effect.params
        for component in range(param.size)
    )


def fit(
    problem: Problem,
    effects: Sequence[Planned],
    iterations: int = 12,
    held: Collection[Planned] = (),
    changed: Planned | None = None,
    least: float = 0.0,
) -> Fit:
    """Fit all numbers but those of the effects that are `held`, starting from the given values, up to a share
    `least` of the unexplained energy; bounds are kept by clipping. Where the set differs from one that was
    fitted by a `changed` effect that acts within its joint, effects within other joints are held, too, and
    what acts on several joints (a load) moves along its derivatives first: one joint's balances are then
    evaluated for a step, and those of all joints for the last ones."""
    problem, slots = problem.about(effects), slots_of(effects)
    if not slots:
        y = problem.residual(effects)
        judge = partial(_judged, problem, y, tuple(effects), slots)
        return Fit(problem, tuple(effects), judge, y, np.zeros((0, y.size)), slots)
    fixed, near = list(held), list(effects)
    if changed is not None and acts_within_a_joint(changed):
        fixed += held_beside(effects, changed)
        near = [e for e in problem.balances.beside(effects, changed) if e.effect.site is not Site.BODY]
    free, linear = (
        np.array([not any(effects[slot.effect] is e for e in some) for slot in slots], dtype=bool)
        for some in (fixed, near)
    )
    point = _Point(list(effects), jacobian_of(problem, effects, slots), [list(effects)] * len(effects))
    if np.any(free & linear):
        ahead = _descend(problem, point, slots, free, iterations, least, linear=free & linear)
        # along its derivatives a load may go too far: its weight is a product of its mass and its place
        if _energy(problem, slots, ahead.effects) < _energy(problem, slots, point.effects):
            point = ahead
    point = _descend(problem, point, slots, free, iterations, least)
    bent: np.ndarray | float = 0.0
    if any(entangles(e) for e in effects):  # the columns of nominal numbers depend on the fitted values
        problem = problem.about(point.effects)
        bent = _bent(problem, point.effects, problem.residual(point.effects))
        point = _descend(problem, point, slots, free, iterations, least, bent)
    current, y = point.effects, problem.residual(point.effects) + bent
    # of numbers that are held derivatives are wanted in the end only
    jacobian = _followed(problem, current, slots, point, np.ones(len(slots), dtype=bool)).jacobian
    judge = partial(_judged, problem, y, tuple(current), slots)
    return Fit(problem, tuple(_wrap(current)), judge, y, jacobian, slots)


def fit_tried(problem: Problem, effects: Sequence[Planned], changed: Planned) -> Fit:
    """A set that is only tried (`fit`): it need not be nearer to its minimum than sets of other causes are to
    each other."""
    return fit(problem, effects, changed=changed, least=TRIED)


def held_beside(effects: Sequence[Planned], changed: Planned) -> list[Planned]:
    """The effects that need not be fitted again when another one is changed: where that acts within its
    joint, those within other joints, which share no balance with it."""
    if not acts_within_a_joint(changed):
        return []
    return [e for e in effects if e.joint != changed.joint and acts_within_a_joint(e)]


def refit_without(result: Fit, effect: Planned) -> Fit:
    """The set without one of its effects, the others fitted again at the same noise level."""
    others = [e for e in result.effects if e is not effect]
    return fit(result.problem, others, changed=effect)


def _bent(problem: Problem, effects: Sequence[Planned], y: np.ndarray) -> np.ndarray | float:
    """What is to be added to the residual y of effects with a dry friction, because the deviations of the
    nominal numbers change when that friction sticks. 0 where these numbers are implausible, for they say
    nothing about it then."""
    if problem.level.implausible > 1.0 or not any(e.effect.overrides("level") for e in effects):
        return 0.0
    return relinearised(problem, effects, y) - y


def evaluated(result: Fit) -> Fit:
    """The fit with its energy evaluated, before it is sent to several processes that would each evaluate
    it."""
    _ = result.energy
    return result


def _judged(problem: Problem, y: np.ndarray, effects: Sequence[Planned], slots: Sequence[Slot]) -> float:
    return judged_energy(problem, y, effects) + _prior(problem, slots, effects)


@dataclass(frozen=True)
class _Point:
    """Where a fit is."""

    effects: list[Planned]
    jacobian: np.ndarray  # (slots, samples)
    taken: list[Sequence[Planned]]  # where each effect's columns were computed


def _descend(
    problem: Problem,
    point: _Point,
    slots: Sequence[Slot],
    free: np.ndarray,
    iterations: int,
    least: float = 0.0,
    bent: np.ndarray | float = 0.0,
    linear: np.ndarray | None = None,
) -> _Point:
    """The nearest minimum of the energy in the slots that are free, up to a share `least` of the unexplained
    energy; `bent` (`_bent`) is added to all residuals. By numbers that are `linear` (bool) residuals change
    along the derivatives that they have at the start."""
    start, along = point.effects, point.jacobian
    linear = np.zeros(len(slots), dtype=bool) if linear is None else linear
    kept = {slot.effect for slot, follows in zip(slots, linear, strict=True) if follows}

    def residual(effects: Sequence[Planned]) -> np.ndarray:
        y = problem.residual([start[k] if k in kept else e for k, e in enumerate(effects)]) + bent
        if not kept:
            return np.asarray(y)
        moved = [slot.get(effects) - slot.get(start) for slot in slots]
        return np.asarray(y + np.where(linear, moved, 0.0) @ along)

    current = point.effects
    y = residual(current)
    energy = problem.energy(y) + _prior(problem, slots, current)
    damping = 1e-3
    moving = [slot for slot, moves in zip(slots, free, strict=True) if moves]
    for _ in range(iterations if moving else 0):
        checkpoint()
        normal, slope = normal_equations(problem, point.jacobian[free], y, moving, current)
        enough = CONVERGED + 1e-6 * energy + least * max(0.0, energy - problem.noise_energy)
        better, failed = False, np.inf
        while not better and damping < MOST_DAMPING:
            trial, promised = _step(current, moving, normal, slope, damping)
            if promised is not None:
                # a first step is tried for less: at a raised noise level even a small gain lowers that level
                if promised < (NOTHING * enough if failed == np.inf else enough):
                    break
                if promised > NEARLY_SAME * failed:
                    damping *= 10.0
                    continue
                failed = promised
            trial_y = residual(trial)
            trial_energy = problem.energy(trial_y) + _prior(problem, slots, trial)
            lighter = None if kept else _lighter(current, trial)
            if lighter is not None:
                lighter_y = residual(lighter)
                lighter_energy = problem.energy(lighter_y) + _prior(problem, slots, lighter)
                if not trial_energy <= lighter_energy:  # it may be infinite
                    trial, trial_y, trial_energy = lighter, lighter_y, lighter_energy
            better = bool(np.isfinite(trial_energy)) and trial_energy < energy
            if not better:
                damping *= 10.0
        if not better:
            break
        gained = energy - trial_energy
        current, y, energy = trial, trial_y, trial_energy
        damping = max(damping * 0.1, 1e-9)
        point = _followed(problem, current, slots, point, free & ~linear)
        if gained < enough:
            break
    return point


def _step(
    current: list[Planned], slots: Sequence[Slot], normal: np.ndarray, slope: np.ndarray, damping: float
) -> tuple[list[Planned], float | None]:
    """The effects after a damped Gauss-Newton step in scaled numbers, and the energy that the step would gain
    if all were linear. Numbers at a bound that would leave it are kept there. The gain is None where the step
    was cut short, at a bound or because a scale (a length, a speed) would change by too large a factor: a
    shorter step may then gain more."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size) + damping * np.eye(len(slots))
    here = np.array([slot.get(current) for slot in slots])
    low, high = (np.array([getattr(slot.param, side) for slot in slots]) for side in ("low", "high"))
    step, free = np.zeros(len(slots)), np.ones(len(slots), dtype=bool)
    while np.any(free):
        step[:] = 0.0
        block = np.ix_(free, free)
        step[free] = -np.linalg.lstsq(scaled[block], (slope / size)[free], rcond=1e-12)[0] / size[free]
        leaves = free & (((here <= low) & (step < 0.0)) | ((here >= high) & (step > 0.0)))
        if not np.any(leaves):
            break
        free &= ~leaves
        step[leaves] = 0.0
    scale = np.array([slot.param.null is None and slot.param.low > 0.0 for slot in slots])
    least, most = np.where(scale, here / SCALED, low), np.where(scale, here * SCALED, high)
    there = np.clip(here + step, np.maximum(least, low), np.minimum(most, high))
    trial = list(current)
    for slot, number in zip(slots, there, strict=True):
        slot.put(trial, float(number))
    cut = bool(np.any(there != here + step))
    moved = there - here
    return trial, None if cut else float(-2.0 * slope @ moved - moved @ normal @ moved)


def load_params(effect: Effect) -> tuple[Parameter, Parameter]:
    """The parameters of a load's size and place."""
    return effect.nulls[0], next(p for p in effect.params if p.size > 1)


def _lighter(current: Sequence[Planned], trial: Sequence[Planned]) -> list[Planned] | None:
    """A step by which loads lose more than half of their mass, along straight lines of their first moments
    m r and of 1/m, in which the second moments (m r)^2 / m are linear; None where no load does. A joint feels
    the moments: along a straight line of mass and place a heavy load near the axis would pass zero long
    before it is a light one far from it."""
    out, found = list(trial), False
    for k, (before, after) in enumerate(zip(current, trial, strict=True)):
        if not before.effect.overrides("edit_inertial"):
            continue
        size, place = load_params(before.effect)
        mass, straight = before.values[size.name], after.values[size.name]
        if mass == 0.0 or straight / mass >= HALF:
            continue
        found = True
        at, to = (np.array(e.values[place.name]) for e in (before, after))
        lighter = mass / (2.0 - straight / mass)
        moments = mass * to + (straight - mass) * at
        there = np.clip(moments / lighter, place.low, place.high)
        out[k] = after.with_values({size.name: float(lighter), place.name: tuple(map(float, there))})
    return out if found else None


def jacobian_of(problem: Problem, effects: Sequence[Planned], slots: Sequence[Slot]) -> np.ndarray:
    """(slots, samples) derivatives of the residual."""
    return np.array([_column(problem, effects, slot) for slot in slots])


def _column(problem: Problem, effects: Sequence[Planned], slot: Slot) -> np.ndarray:
    """(samples,) derivative of the residual by one slot. It is the same at any noise level, and is remembered
    by the effects that it depends on."""
    around = _around(problem, effects, effects[slot.effect])
    place = next(k for k, e in enumerate(around) if e is effects[slot.effect])
    own = replace(slot, effect=place)

    def derivative() -> np.ndarray:
        checkpoint()  # of many causes on many joints the columns are what takes long
        here, step = own.get(around), step_of(problem, own, around)
        if here + step > own.param.high:
            step = -step
        moved = list(around)
        own.put(moved, here + step)
        return problem.moved_slightly(around, moved) / step

    return problem.remembered(f"by {place} {slot.param.name} {slot.component}", around, derivative)


def _around(problem: Problem, effects: Sequence[Planned], e: Planned) -> list[Planned]:
    """The effects on which the change of the residual by an effect depends: all, where it does not act within
    its joint."""
    return problem.balances.beside(effects, e) if acts_within_a_joint(e) else list(effects)


def _energy(problem: Problem, slots: Sequence[Slot], effects: Sequence[Planned]) -> float:
    return problem.energy(problem.residual(effects)) + _prior(problem, slots, effects)


def _followed(
    problem: Problem,
    effects: Sequence[Planned],
    slots: Sequence[Slot],
    point: _Point,
    wanted: np.ndarray,
) -> _Point:
    """The fit at the current values, with the derivatives there of the slots that are `wanted` (bool). A
    derivative is computed again only if a number on which it depends has changed by more than a little: with
    many causes, few have."""
    asked = {slot.effect for slot, want in zip(slots, wanted, strict=True) if want}
    anew, at = np.zeros(len(effects), dtype=bool), list(point.taken)
    for before in {id(one): one for one in point.taken}.values():
        far = {now.key for now, then in zip(effects, before, strict=True) if not _near(now, then)}
        for k in asked if far else ():
            if point.taken[k] is before and any(e.key in far for e in _around(problem, effects, effects[k])):
                anew[k], at[k] = True, effects
    columns = [
        _column(problem, effects, slot) if anew[slot.effect] else row
        for slot, row in zip(slots, point.jacobian, strict=True)
    ]
    return _Point(list(effects), np.array(columns), at)


def _near(e: Planned, before: Planned) -> bool:
    """Whether no number of an effect is far from what it was; of a vector, for its size."""
    if e is before:
        return True
    for param in e.effect.params:
        now, then = (np.ravel(one.values[param.name]) for one in (e, before))
        if np.any(np.abs(now - then) > NEAR * (1.0 if param.wraps else np.max(np.abs(then)))):
            return False
    return True


def step_of(problem: Problem, slot: Slot, effects: Sequence[Planned]) -> float:
    """Finite-difference step: relative to the value, but not below a size that the data could show."""
    here = abs(slot.get(effects))
    floor = {"rad": 1e-6, "s": 1e-6, "m": 1e-3, "kg": 1e-4}.get(slot.param.unit, 1e-5)
    return min(max(RELATIVE_STEP * here, floor), slot.param.step)


def normal_equations(
    problem: Problem,
    jacobian: np.ndarray,
    y: np.ndarray,
    slots: Sequence[Slot],
    effects: Sequence[Planned],
) -> tuple[np.ndarray, np.ndarray]:
    normal, slope = problem.normal(jacobian, y)
    for k, slot in enumerate(slots):
        value, first = _weak(problem, slot, effects)
        normal[k, k] += first**2
        slope[k] += first * value
    return normal, slope


def _prior(problem: Problem, slots: Sequence[Slot], effects: Sequence[Planned]) -> float:
    return sum(_weak(problem, slot, effects)[0] ** 2 for slot in slots)


def _weak(problem: Problem, slot: Slot, effects: Sequence[Planned]) -> tuple[float, float]:
    joint = effects[slot.effect].joint
    torque = np.inf if joint is None else float(problem.torque_scale[problem.robot.joint_names.index(joint)])
    return weak_prior(slot, effects, problem.settings.regression, torque)


def weak_prior(
    slot: Slot, effects: Sequence[Planned], settings: RegressionSettings, torque: float = np.inf
) -> tuple[float, float]:
    """Distance of a number from a plausible value, in weak prior deviations, and its derivative: a factor is
    rarely off by more than two, a position lies within reach, one of a joint near its zero, and the level
    of a friction or a ripple is hardly larger than the joint's RMS `torque` [N m]: where few samples show how
    fast a friction wears off, they do not show that it began with a multiple of that."""
    number, param = slot.get(effects), slot.param
    if param.unit == "m":
        return number / settings.position_deviation, 1.0 / settings.position_deviation
    if param.unit == "rad" and param.low < 0.0 and param.null is None and not param.wraps:
        return number / settings.angle_deviation, 1.0 / settings.angle_deviation
    if param.unit == "N m" and param.low == param.null == 0.0:
        deviation = settings.torque_deviation * torque
        return number / deviation, 1.0 / deviation
    if param.unit == "1" and param.low < 0.0 and param.null == 0.0:
        factor = max(1.0 + number, 1e-3)
        return float(np.log(factor)) / settings.factor_deviation, 1.0 / (factor * settings.factor_deviation)
    return 0.0, 0.0


def _wrap(effects: Sequence[Planned]) -> list[Planned]:
    """Angles into (-pi, pi]."""
    out = []
    for planned in effects:
        turned = {
            p.name: float(np.angle(np.exp(1j * planned.values[p.name])))
            for p in planned.effect.params
            if p.wraps
        }
        out.append(replace(planned, values={**planned.values, **turned}) if turned else planned)
    return out


def covariance(result: Fit, blocks: np.ndarray) -> np.ndarray:
    """(slots, slots) covariance of the fitted numbers that holds when the residual is not white: bread from
    the curvature, meat from the scores of time blocks (White 1980; Newey and West 1987). `blocks` (samples,)
    numbers each sample's block. Never below what the predicted noise alone gives."""
    k, problem = len(result.slots), result.problem
    if k == 0:
        return np.zeros((0, 0))
    normal, _ = normal_equations(problem, result.tangents, result.y, result.slots, result.effects)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    bread = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
    projected = problem.project(result.tangents) * problem.weights
    residual = problem.rest(result.y) * problem.weights
    count = int(blocks.max()) + 1
    scores = np.stack([np.bincount(blocks, weights=row * residual, minlength=count) for row in projected])
    meat = scores @ scores.T * (count / max(1, count - k))
    robust = bread @ meat @ bread
    own, seen = np.diag(robust), np.diag(bread)
    # a number that no sample shows has neither
    grown = np.divide(own, seen, out=np.ones(k), where=seen > LEAST_VARIANCE)
    scale = np.sqrt(np.maximum(1.0, grown))
    return bread * np.outer(scale, scale)
