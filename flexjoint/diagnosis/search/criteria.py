"""What an effect must be to enter a set of causes, and to stay in it.

A set is judged by its energy Q(y, y) (a chi-square) plus a price for every effect and every number in it.
An effect enters the set only if it explains more energy than its price, if its torque exceeds the robot's
torque tolerance (or leaves nothing but noise), and if it explains more than the error that the method itself
makes in the balances that it changes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexjoint.diagnosis.regression.deviations import judged_energy
from flexjoint.diagnosis.regression.fit import Fit, fit, fit_tried, refit_without, shifts
from flexjoint.diagnosis.regression.nuisance import NUMBERS, NominalNumber
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.regression.uncertainty import certainty, standard_errors
from flexjoint.diagnosis.settings import SearchSettings
from flexjoint.effects import Kind, Parameter, Planned, Site, catalogue
from flexjoint.rigidbody.numeric import inertial_of

LEVEL_ROUNDS = 5  # fits at most, each at the noise level that the last one left, until
SAME_LEVEL = 0.1  # the logarithm of the level changes by less than this


def price(result: Fit) -> float:
    """Energy that a set of effects must explain at least; `score` adds what the number of joints and missing
    sensors cost. A number that changes no residual is free (for a payload that only moves in a straight line:
    its position on the link)."""
    return sum(prices(result))


def prices(result: Fit) -> list[float]:
    """That of each effect."""
    limits = result.settings.search
    numbers = Counter(
        slot.effect for slot, tangent in zip(result.slots, result.tangents, strict=True) if np.any(tangent)
    )
    out, again = [], repeated(result.effects, limits)
    for k, e in enumerate(result.effects):
        if k in again:
            out.append(limits.price_number)
            continue
        first = limits.price if own_number(result.problem, e) is None else limits.price_nominal
        out.append(first + limits.price_number * max(0, numbers[k] + len(e.changes) - 1))
    return out


def repeated(effects: Sequence[Planned], limits: SearchSettings) -> dict[int, int]:
    """The effects of a set that are one cause with an earlier one, and with which: one law on several joints,
    of those that several joints often have by one value (`Effect.common`), by nearly that value."""
    first: dict[object, int] = {}
    out = {}
    for k, e in enumerate(effects):
        if not e.effect.common or e.joint is None or e.since is not None:
            continue
        law = (e.effect.name, *(e.values[w.name] for w in e.effect.words))
        one = first.setdefault(law, k)
        size = e.effect.nulls[0].name
        known = effects[one].values[size]
        if one != k and abs(e.values[size] - known) <= limits.one_value * abs(known):
            out[k] = one
    return out


def by_joint(effects: Sequence[Planned]) -> Counter[str | None]:
    """How many causes of a set each joint has beside what every drive has (`Effect.ordinary`)."""
    return Counter(e.joint for e in effects if not e.effect.ordinary)


def score(result: Fit) -> float:
    """Energy plus price: of two sets, the one with the lower score is better."""
    limits, problem = result.settings.search, result.problem
    # a nominal number does as much within its tolerance, along the same positions
    others = sum(own_number(problem, e) is None for e in result.effects) if problem.motion.missing else 0
    # the more joints, the more candidates, and the better the best of them fits by chance
    chance = limits.price_candidates * float(np.log(len(problem.robot.joints)))
    chosen = len(result.effects) - len(repeated(result.effects, limits))
    return result.energy + price(result) + limits.price_reconstructed * others + chance * chosen


def unexplained_energy(result: Fit) -> float:
    """Energy above that of the predicted noise."""
    return max(0.0, result.energy - result.problem.noise_energy)


def at_own_level(result: Fit, tried: Planned | None = None) -> Fit:
    """The set fitted again at the noise level that it leaves itself. Where one of its effects is `tried`,
    those that share no balance with it keep their numbers."""
    for _ in range(LEVEL_ROUNDS):
        last = result.problem
        problem = last.at(last.plausible_level(result.y))
        effects = result.effects
        result = fit(problem, effects) if tried is None else fit_tried(problem, effects, tried)
        if same_level(problem.level, last.level):
            break
    return result


def same_level(one: NoiseLevel, other: NoiseLevel) -> bool:
    """Whether the noise of all balances is nearly the same at two levels."""
    return bool(np.all(np.abs(np.log(one.inflation / other.inflation)) < SAME_LEVEL))


def degenerate(problem: Problem, planned: Planned) -> bool:
    """Whether the fitted numbers of an effect mean nothing: its size is zero, or that of one of the effects
    of which it is made, or it is what the nominal model lists; a shape parameter is at its bound or below
    what the sensors resolve, so that a simpler law does the same; its size is at the upper bound, or one of
    its numbers beyond what its joint can have (`Effect.largest`); it is a friction in one direction and none
    in the other (an offset larger than friction looks so); it is a load with which what the joint carries
    weighs less than nothing; it is a torque that repeats, of which too little of a period was seen, as any
    smooth torque looks so; or its torque is far above both the torques of its joint and the torque that it
    shows in any balance (a peak of friction below the speeds that the data resolve)."""
    limits = problem.settings.search
    sizes = [(planned.values[p.name], p) for p in planned.effect.nulls]
    listed = next((e for e in problem.nominal if e.key == planned.key), None)
    if _is_as(planned, listed.values) if listed else any(_absent(part) for part in planned.parts):
        return True
    at_most = any(np.any(np.isclose(size, p.high, rtol=limits.at_bound, atol=0.0)) for size, p in sizes)
    if at_most or _beyond_its_joint(problem, planned):
        return True
    one_way = any(size == p.low for size, p in sizes if p.name in planned.effect.alike)
    if one_way and planned.effect.overrides("level"):
        return True
    if _weightless(problem, planned) or _part_of_a_period(problem, planned):
        return True
    if planned.joint is not None:
        named = [planned.values[p.name] for p in planned.effect.nulls if p.unit == "N m" and p.null == 0.0]
        largest = max((float(np.max(np.abs(torque))) for torque in named), default=0.0)
        scale = float(problem.torque_scale[problem.robot.joint_names.index(planned.joint)])
        if largest > limits.boundless * scale or (
            largest > scale and largest > limits.boundless * shown(problem, planned)
        ):
            return True
    shapes = [p for p in planned.effect.params if p.null is None and p.size == 1 and not p.wraps]
    return any(
        np.isclose(planned.values[p.name], (p.low, p.high), rtol=limits.at_bound, atol=0.0).any()
        for p in shapes
    ) or _unseen(problem, planned, shapes)


def known_sizes(result: Fit, least: float) -> tuple[np.ndarray, np.ndarray]:
    """(k,) by how many standard errors each cause's numbers differ from those of no effect, and (k,) how many
    its price asks for, `least` at least. Joints that have a cause in common tell together how large it is."""
    pairs = zip(result.effects, standard_errors(result), strict=True)
    certain = np.array([certainty(result, e, std) for e, std in pairs])
    price, again = np.array(prices(result)), repeated(result.effects, result.settings.search)
    for k in set(again.values()):
        joints = [k, *(other for other, first in again.items() if first == k)]
        certain[joints] = np.sqrt(np.sum(certain[joints] ** 2))
        price[joints] = price[k]
    return certain, np.maximum(least, np.sqrt(price))


def given_up_for(cause: Planned, effects: Sequence[Planned], nominal: Sequence[Planned]) -> Planned | None:
    """The effect among some that makes room for a cause: a special case of its law (`Effect.contains`) on its
    joint, of which there is less than the nominal model claims. Of several laws the largest one takes that
    room: beside a presliding friction, Stribeck's has no level of its own. None where there is none."""
    claims = {e.key: e for e in nominal}
    for e in effects:
        claim = claims.get(e.key)
        if claim is None or e.joint != cause.joint or e.effect.name not in cause.effect.contains:
            continue
        if any(abs(e.values[p.name]) >= abs(claim.values[p.name]) for p in e.effect.nulls):
            continue
        laws = [law for law in effects if law.joint == e.joint and e.effect.name in law.effect.contains]
        size = e.effect.nulls[0].name
        if cause.key == max(laws, key=lambda law: abs(law.values.get(size, 0.0)), default=cause).key:
            return e
    return None


def makes_room(effect: Planned, result: Fit) -> bool:
    """Whether an effect only makes room for another one of its set: it is a part of that one, has no rivals
    of its own, and stays as long as that does."""
    others = (e for e in result.effects if e is not effect)
    return any(given_up_for(e, result.effects, result.problem.nominal) is effect for e in others)


def _absent(planned: Planned) -> bool:
    return _is_as(planned, {p.name: p.null for p in planned.effect.nulls})


def _is_as(planned: Planned, values: Mapping[str, Any]) -> bool:
    """Whether an effect changes nothing of one with these values: its absence, or what the nominal model
    lists, of which a friction that is gone is a change."""
    return all(
        np.all(np.ravel(planned.values[p.name]) == np.ravel(values[p.name])) for p in planned.effect.nulls
    )


def _beyond_its_joint(problem: Problem, planned: Planned) -> bool:
    """Whether a number of an effect is more than a joint with these signals can have."""
    largest = planned.effect.largest(problem.signals(planned.joint))
    return any(planned.values[name] > most for name, most in largest.items())


def _weightless(problem: Problem, planned: Planned) -> bool:
    """Whether with a load the bodies that its joint carries would have a negative mass together."""
    if planned.joint is None or not planned.effect.overrides("edit_inertial"):
        return False
    model, joint = problem.robot.model, problem.robot.joint(planned.joint).pin_id
    body = list(inertial_of(model)[joint - 1])
    added = float(planned.effect.edit_inertial(body, planned.p)[0]) - float(body[0])
    return added + sum(float(model.inertias[k].mass) for k in model.subtrees[joint]) < 0.0


def _part_of_a_period(problem: Problem, planned: Planned) -> bool:
    """Whether an effect is a torque that repeats, and the recording shows too little of a period of it."""
    effect = planned.effect
    if planned.joint is None or not effect.repeats or all(p.unit != "N m" for p in effect.nulls):
        return False
    signal = getattr(problem.signals(planned.joint), effect.against)
    turns = 1.0 if effect.against == "t" else 1.0 / (2.0 * np.pi)  # a rhythm counts in Hz
    periods = float(planned.values[effect.repeats]) * turns * float(np.ptp(signal))
    return periods < problem.settings.search.least_period


def _unseen(problem: Problem, planned: Planned, shapes: Sequence[Parameter]) -> bool:
    """Whether an effect is too small for the position sensors of its joint. That is so if one of its lengths
    (a scale or a width, not a place) is below their noise; if it sets in during the recording and its size is
    below their noise, for then it may be a slow drift of anything else; and if it changes the deflection by
    less than one step of an encoder whose rounding is not blurred by noise. A ripple repeats over many steps:
    it is seen below one step, too."""
    if planned.joint is None:
        return False
    readings, k = problem.readings, problem.robot.joint_names.index(planned.joint)
    finest = max(float(readings.noise["q"][k]), float(readings.noise["theta"][k]))
    if any(p.unit == "rad" and p.low > 0.0 and planned.values[p.name] < finest for p in shapes):
        return True
    if planned.since is None:
        shape = planned.effect.site is Site.DEFLECTION and not any(p.wraps for p in planned.effect.params)
        finest = _coarsest_step(problem, k) if shape else 0.0
    sizes = planned.effect.nulls
    return bool(sizes) and all(p.unit == "rad" and abs(planned.values[p.name]) < finest for p in sizes)


def _coarsest_step(problem: Problem, k: int) -> float:
    """[rad] of joint k's encoders whose rounding is not white noise; 0 where there is none."""
    at = {"q": k, "theta": len(problem.robot.joints) + k}
    steps = problem.readings.steps
    return max((float(steps[c][k]) for c, i in at.items() if i in problem.balances.colours), default=0.0)


def shown(problem: Problem, planned: Planned) -> float:
    """[N m] the largest torque by which an effect changes any balance."""
    balances, used = problem.balances, problem.readings.valid
    base = problem.with_nominal([])
    change = balances.changed(base, problem.with_nominal([planned]))
    torques = [np.max(np.abs(balances.time_series(spectrum)[used])) for spectrum in change.values()]
    return float(max(torques, default=0.0))


def supported(trial: Fit, without: Fit, added: Planned) -> bool:
    """Whether the data support `added`, an effect of the set `trial`, against the set `without` it: it meets
    all criteria at the noise level of `trial`. Where the set without it fits only with implausible nominal
    numbers, it may also meet them at the lowest level at which these numbers are plausible."""
    if _supported(trial, without, added):
        return True
    if not needs_implausible(without, trial):
        return False
    there, other = (fit(raised_until_plausible(without), f.effects) for f in (trial, without))
    return _supported(there, other, next(e for e in there.effects if e.key == added.key))


def _supported(trial: Fit, without: Fit, added: Planned) -> bool:
    if degenerate(trial.problem, added) or score(trial) >= score(without) or stands_in(trial, added):
        return False
    if shared_by_tolerances(trial, without, added) or _between_samples(trial, added):
        return False
    gained, left = explained(trial, without, added), _left_beside(trial, added)
    paid = price(trial) - price(without)
    if gained - paid < trial.settings.search.unexplained_share * left:
        return False
    beside = _sharing_balances(trial, added)
    if beside:
        # what the other causes on the joint explain is known only up to the error of the method, and a new
        # effect may fit that error; one that leaves next to nothing does not
        others, error = [e for e in trial.effects if e not in beside], _method_error(trial, gained)
        # fitted, the set without them leaves no more than with the numbers that it has
        most = judged_energy(trial.problem, trial.problem.residual(others), others)
        if gained < error * (most - trial.energy):
            alone = fit_tried(trial.problem, others, added)
            if gained < error * (alone.energy - trial.energy):
                return False
    if contradicted(trial, without) or gained < paid * _chance(trial, gained, added):
        return False
    return shown_by_motion(trial, gained, added) and material(trial, added, gained)


def _left_beside(trial: Fit, added: Planned) -> float:
    """Unexplained energy against which an effect is held: of ordinary friction, which every joint has, that
    of the balances that it changes, whatever is left of other joints; else all."""
    problem, left = trial.problem, unexplained_energy(trial)
    if not added.effect.ordinary:
        return left
    k = next(k for k, e in enumerate(trial.effects) if e is added)
    changed = changed_balances(problem, trial.effects, k)
    rows = np.sum(problem.rest_by_row(trial.y) ** 2, axis=1)
    return left * float(np.sum(rows[changed])) / max(float(np.sum(rows)), 1e-300)


def stands_in(trial: Fit, added: Planned) -> bool:
    """Whether an effect of two joints explains no more than ordinary friction of both (`Effect.ordinary`) in
    its place. Every machine has that, and one law that imitates it on two joints at once would come first."""
    if not added.effect.reaches_before or added.joint is None:
        return False
    names = trial.problem.robot.joint_names
    i = names.index(added.joint)
    taken = {e.key for e in trial.effects}
    numbers = added.parts[0].values
    ordinary = [
        Planned.of(e.name, joint, {p.name: numbers[p.name] for p in e.params}, since=added.since)
        for e in catalogue().values()
        for joint in names[i - 1 : i + 1]
        if e.ordinary and (e.name, joint) not in taken and {p.name for p in e.params} <= set(numbers)
    ]
    if not ordinary:
        return False
    others = [e for e in trial.effects if e is not added]
    return fit(trial.problem, [*others, *ordinary]).energy <= trial.energy


def _between_samples(trial: Fit, added: Planned) -> bool:
    """Whether an effect shifts a command in time by a part of the time between two recorded ones in which the
    controller gave others, beside another cause of timing on its joint. When these changed is not known; a
    lag smooths a command and a delay does not, so that the two together can imitate a shift that is not
    there."""
    shifts_time = added.effect.kind is Kind.TIMING and added.effect.site is Site.COMMAND
    if not shifts_time or not any(
        e is not added and e.joint == added.joint and e.effect.kind is Kind.TIMING for e in trial.effects
    ):
        return False
    longest = max(abs(added.values[p.name]) for p in added.effect.params if p.unit == "s")
    problem = trial.problem
    unrecorded = problem.readings.period - 1.0 / problem.robot.rates.control
    return bool(longest < trial.settings.search.between_samples * unrecorded)


def needs_implausible(trial: Fit, other: Fit) -> bool:
    """Whether a set fits only with a nominal number that is implausibly far off, and further off than any
    number of the other set. Where the error is large, such numbers cost little energy: a motor without torque
    looks like one without inertia."""
    implausible, further = trial.settings.regression.implausible, trial.settings.search.further
    return trial.furthest > max(implausible, further * other.furthest)


def only_by_implausible(trial: Fit, without: Fit) -> bool:
    """Whether a set is better than another one only because of implausible nominal numbers: at a noise level
    at which these numbers are plausible, it is not better any more."""
    if trial.furthest <= trial.settings.regression.implausible:
        return False
    if not needs_implausible(trial, fit(trial.problem, without.effects)):
        return False
    there, other = (fit(raised_until_plausible(trial), f.effects) for f in (trial, without))
    return score(there) >= score(other)


def raised_until_plausible(result: Fit) -> Problem:
    """The problem at the lowest noise level at which what a fit leaves needs no implausible nominal
    number."""
    problem = result.problem
    while problem.furthest(result.y) > result.settings.regression.plausible:
        level = problem.level
        problem = problem.at(NoiseLevel(2.0 * level.inflation, level.implausibility))
    return problem


def _sharing_balances(trial: Fit, added: Planned) -> list[Planned]:
    """The other causes on an effect's joint that change a balance which it changes, too."""
    others = [e for e in trial.effects if e is not added and e.joint == added.joint]
    if not others:
        return []
    touched = {e.key: torque_shares(trial.problem, trial.effects, k) > 0.0
               for k, e in enumerate(trial.effects) if e is added or e in others}  # fmt: skip
    return [e for e in others if np.any(touched[e.key] & touched[added.key])]


def _method_error(trial: Fit, gained: float) -> float:
    """Error of the method, as a share of what the other causes on its joint explain: a cause must explain
    more."""
    limits = trial.settings.search
    left = unexplained_energy(trial)
    if trial.problem.motion.missing or gained < limits.cleared * left:
        return limits.method_error
    noise_alone = bool(np.all(trial.problem.level.inflation < trial.settings.regression.noise_decides))
    perfect = noise_alone and gained >= limits.beyond_noise + limits.perfect * left
    return limits.least_method_error if perfect else limits.finer_method_error


def contradicted(trial: Fit, without: Fit) -> bool:
    """Whether the effects that `trial` has beyond `without` lower one balance and leave ten times more in
    another one, noise aside: a spring's torque cannot explain an error that the motor's balance shows and the
    link's does not. The nominal numbers are then corrected for both sets and the balances compared again: a
    wrong nominal number may hide an error of an actuator's gain, and both are right only together."""
    plain = _worse(trial.problem, without.effects, trial.effects)
    return plain and _worse(
        trial.problem, [*without.effects, *shifts(without)], [*trial.effects, *shifts(trial)]
    )


def _worse(problem: Problem, effects: Sequence[Planned], others: Sequence[Planned]) -> bool:
    """Whether, in some balance, `others` leave ten times more than `effects` do, noise aside."""
    balances, used = problem.balances, problem.readings.valid
    one, other = problem.with_nominal(effects), problem.with_nominal(others)
    change = balances.changed(one, other)
    if not change:
        return False
    before = balances.residual(one)
    for r, moved in change.items():
        error, left = balances.time_series(np.array([before[r], before[r] + moved]))[:, used]
        was = max(float(np.mean(error**2)), float(problem.deviation[r]) ** 2)
        if np.mean(left**2) > problem.settings.search.cleared * was:
            return True
    return False


def explained(trial: Fit, without: Fit, added: Planned) -> float:
    """Energy that `added`, an effect of `trial`, explains. If it is the change of a nominal number, the set
    without it is taken with that number at its nominal value; otherwise the number's own deviation would
    explain most of the same."""
    gained, problem = without.energy - trial.energy, trial.problem
    k = own_number(problem, added)
    if k is not None:
        error = problem.deviation_errors()[k]
        # holding a number raises a least-squares energy by the square of its deviation in standard errors
        free, left = ((problem.deviations(y)[k] / error) ** 2 for y in (without.y, trial.y))
        gained += float(free - left)
    return gained


def shown_by_motion(trial: Fit, gained: float, added: Planned) -> bool:
    """Whether the energy that `added` explains comes from the motion and not from the sensors' noise. A law
    of little energy (a gap as wide as the noise) may lower the energy by making the noise smaller; along the
    denoised recording it then explains nothing. An effect that shifts signals in time moves their noise n
    against the noise m of the other sensors, which changes the energy by chance, by 2 m dn; so does a lag.
    And a dry friction holds a body at rest against whatever pulls at it, which is known to the sensors' noise
    and rounding only: it must show where the body slides, too."""
    limits = trial.settings.search
    problem = trial.problem
    if (
        gained >= limits.beyond_noise
        or np.max(problem.level.inflation) >= problem.settings.regression.noise_decides
    ):
        return True
    others = [e for e in trial.effects if e is not added]
    before = problem.residual(others)
    moved = problem.whitening.white(problem.denoised_moved_band(others, trial.effects)).ravel()
    denoised, measured = (problem.energy(before) - problem.energy(y) for y in (before + moved, trial.y))
    if added.effect.kind is Kind.TIMING:
        moved_noise = _moved_noise(problem, others, trial.effects)
        if gained < limits.moved_noise * moved_noise:
            return False
    if added.effect.overrides("level") and _explained_sliding(trial, before, added) < limits.sliding:
        return False
    return denoised >= limits.denoised_share * measured


def _chance(trial: Fit, gained: float, added: Planned) -> float:
    """Energy that the sensors' noise alone has along the traces of an effect's numbers, beside those of the
    others, in that of white noise: above 1 where the noise that one encoder makes is correlated among the
    balances of several links, or where it is louder than elsewhere. At least 1; a composite likelihood is
    adjusted by the same factor (Varin, Reid and Firth 2011)."""
    if gained >= trial.settings.search.beyond_noise:
        return 1.0
    shown = np.any(trial.tangents, axis=1)
    own = shown & np.array([trial.effects[slot.effect] is added for slot in trial.slots])
    if not np.any(own):
        return 1.0
    tangents, own = trial.tangents[shown], own[shown]
    normal = trial.problem.product(tangents, tangents)
    slope = trial.problem.product(tangents, trial.problem.whitening.drawn)
    by_all, by_others = _along(normal, slope), _along(normal[np.ix_(~own, ~own)], slope[~own])
    return max(1.0, float(np.mean(by_all - by_others)) / int(np.sum(own)))


def _along(normal: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(draws,) energy that numbers explain, from their normal matrix (k, k) and slopes (k, draws)."""
    return np.asarray(np.sum(slope * (np.linalg.pinv(normal, hermitian=True) @ slope), axis=0))


def _explained_sliding(trial: Fit, before: np.ndarray, added: Planned) -> float:
    """Energy of a residual `before` that a dry friction explains at samples at which its body slides."""
    problem = trial.problem
    speed = "dtheta" if added.effect.site is Site.MOTOR else "dq"
    joint = problem.robot.joint_names.index(str(added.joint))
    sliding = problem.balances.chains.moves(joint, speed)
    nearest = np.rint(problem.time / problem.readings.period).astype(int)
    there, left = (np.sum(problem.rest_by_row(y) ** 2, axis=0) for y in (before, trial.y))
    return float(np.sum((there - left)[sliding[nearest]]))


def _moved_noise(problem: Problem, effects: Sequence[Planned], others: Sequence[Planned]) -> float:
    """Root of the energy of the change that effects make of the sensors' noise."""
    before, after = problem.with_nominal(effects), problem.with_nominal(others)
    measured, denoised = (b.changed(before, after) for b in (problem.balances, problem.balances.denoised))
    noise = {row: spectrum - denoised[row] for row, spectrum in measured.items() if row in denoised}
    white = problem.whitening.white(problem.whitening.band(noise)).ravel()
    return float(np.sqrt(np.sum(white**2)))


def material(trial: Fit, added: Planned, gained: float) -> bool:
    """Whether an effect's torque is large enough to be named: above the robot's torque tolerance, which
    stands for what no model contains. A smaller one is named if it is certain and part of what the model of
    the joint's drive lacks (`Effect.ordinary`), all of which is larger; or if it is certain and there is
    little such error: nothing but noise is left in the balances that it changes, or it removes most of what
    was wrong there."""
    limits = trial.settings.search
    if tolerated(trial.problem, added):
        return False
    place = trial.effects.index(added)
    size = np.max(torque_shares(trial.problem, trial.effects, place))
    tolerance = trial.problem.robot.tolerance.torque
    uncertain = gained < (limits.certain if added.since is None else limits.certain_dated)
    if size >= tolerance or size < limits.negligible * tolerance or uncertain:
        return bool(size >= tolerance)
    if added.effect.ordinary and np.max(_shares_of_drive(trial, added.joint)) >= tolerance:
        return True
    touched = changed_balances(trial.problem, trial.effects, place)
    left = at_own_level(trial, added).problem.level.inflation[touched]
    if np.all(left < trial.settings.regression.noise_decides):
        return True
    before = at_own_level(refit_without(trial, added), added).problem.level.inflation[touched]
    wrong = before > limits.wrong
    return bool(np.any(wrong) and np.mean(np.log(before[wrong] / left[wrong])) >= np.log(limits.cleared))


def tolerated(problem: Problem, added: Planned) -> bool:
    """Whether an effect is the change of a nominal number that is within twice its tolerance."""
    k = own_number(problem, added)
    if k is None:
        return False
    number, (param,) = problem.nuisance[k], added.effect.nulls
    return bool(abs(added.values[param.name]) <= problem.settings.search.tolerated * _spread(problem, number))


def shared_by_tolerances(trial: Fit, without: Fit, added: Planned) -> bool:
    """Whether an effect is the change of a nominal number that is within twice its tolerance when all nominal
    numbers may deviate together. Asked only where nothing but noise is left: at a higher noise level the
    deviations are estimated too small."""
    k = own_number(trial.problem, added)
    if k is None or np.max(trial.problem.level.inflation) >= trial.settings.regression.noise_decides:
        return False
    return bool(abs(trial.problem.deviations(without.y)[k]) <= trial.settings.search.tolerated)


def own_number(problem: Problem, added: Planned) -> int | None:
    """The index of the nominal number of which an effect, at work all the time, is the change."""
    if added.since is not None:
        return None
    for k, number in enumerate(problem.nuisance):
        name = "motor_viscous_friction" if number.name == "motor_damping" else number.name
        nominal = number.name in NUMBERS or number.name.endswith("_encoder_offset")
        if nominal and _spread(problem, number) > 0.0 and (name, number.joint) == added.key:
            return k
    return None


def _spread(problem: Problem, number: NominalNumber) -> float:
    """One deviation of a nominal number in the unit of the effect that changes it: a damping's is a share of
    it, and none where the model has no damping."""
    damping = problem.robot.joint(str(number.joint)).drive.D_m if number.name == "motor_damping" else 1.0
    return float(number.std * damping)


def torque_shares(problem: Problem, effects: Sequence[Planned], index: int) -> np.ndarray:
    """(rows,) RMS torque of an effect in each balance, as a share of that joint's torque."""
    return _shares(problem, [e for k, e in enumerate(effects) if k != index], effects)


def _shares_of_drive(trial: Fit, joint: str | None) -> np.ndarray:
    """(rows,) the same of all that every machine's drive has (`Effect.ordinary`) on a joint together."""
    others = [e for e in trial.effects if not (e.effect.ordinary and e.joint == joint)]
    return _shares(trial.problem, others, trial.effects)


def _shares(problem: Problem, without: Sequence[Planned], effects: Sequence[Planned]) -> np.ndarray:
    balances, used = problem.balances, problem.readings.valid
    change = balances.change(problem.with_nominal(without), problem.with_nominal(effects))
    shares = np.zeros(len(balances.rows))
    for r, (row, spectrum) in enumerate(zip(balances.rows, change, strict=True)):
        if np.any(spectrum):
            torque = balances.time_series(spectrum)[used]
            shares[r] = np.sqrt(np.mean(torque**2)) / problem.torque_scale[row.joint]
    return shares


def changed_balances(problem: Problem, effects: Sequence[Planned], index: int) -> np.ndarray:
    """(rows,) bool: the balances that an effect changes, and the whitened one that it changes most. A balance
    is white beside those before it (`Whitening.matrix`), so that an effect may show in another one than it
    acts in: a drag of a link in its spring's torque, a friction of a motor in the load of its link."""
    changed = torque_shares(problem, effects, index) > 0.0
    if np.any(changed):
        others = [e for k, e in enumerate(effects) if k != index]
        mark = problem.moved(others, effects).reshape(len(changed), -1)
        changed[np.argmax(np.sum(mark**2, axis=1))] = True
    return changed
