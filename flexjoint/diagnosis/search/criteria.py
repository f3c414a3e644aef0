"""What an effect must be to enter a set of causes, and to stay in it.

A set is judged by its energy Q(y, y) plus a price for every effect and every number in it. An effect
enters only when it earns more than its price, matters by the robot's own torque tolerance (or leaves
nothing but noise), and removes more than the method's own error in the balances it touches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without, shifts
from flexjoint.diagnosis.regression.nuisance import NUMBERS
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.effects import Kind, Parameter, Planned, Site

LEVEL_ROUNDS = 5  # of fits at the level that they leave, at most, until
SAME_LEVEL = 0.1  # is the largest change of its logarithm


def price(result: Fit) -> float:
    """Energy that a set of effects must earn, chance among joints and missing sensors aside. A number without
    a trace explains nothing (of a payload that only moves straight, where it sits)."""
    limits = result.settings.search
    numbers = Counter(
        slot.effect for slot, tangent in zip(result.slots, result.tangents, strict=True) if np.any(tangent)
    )
    total = 0.0
    for k, e in enumerate(result.effects):
        first = limits.price if own_number(result.problem, e) is None else limits.price_nominal
        total += first + limits.price_number * max(0, numbers[k] + (e.since is not None) - 1)
    return total


def score(result: Fit) -> float:
    """What is compared: energy plus price."""
    limits = result.settings.search
    reconstructed = limits.price_reconstructed if result.problem.motion.missing else 0.0
    # of so many more candidates, chance favours one by so much more
    chance = limits.price_candidates * float(np.log(len(result.problem.robot.joints)))
    return result.energy + price(result) + (reconstructed + chance) * len(result.effects)


def unexplained_energy(result: Fit) -> float:
    """Energy that is still above the predicted noise."""
    return max(0.0, result.energy - result.problem.noise_energy)


def at_own_level(result: Fit) -> Fit:
    """The set fitted again at the noise level that it leaves itself."""
    for _ in range(LEVEL_ROUNDS):
        last = result.problem
        problem = last.at(last.plausible_level(result.y))
        change = np.abs(np.log(problem.level.inflation / last.level.inflation))
        result = fit(problem, result.effects)
        if np.all(change < SAME_LEVEL):
            break
    return result


def degenerate(problem: Problem, planned: Planned) -> bool:
    """Whether a law has shrunk to none, or to a simpler one (a shape at its bound, or unseen), has a size
    that the data do not limit, or names a torque far beyond what its joint has and what it shows itself (a
    bump of friction below the speeds that the data resolve)."""
    limits = problem.settings.search
    sizes = [(planned.values[p.name], p) for p in planned.effect.nulls]
    if all(np.all(np.ravel(size) == p.null) for size, p in sizes):
        return True
    if any(np.any(np.isclose(size, p.high, rtol=limits.at_bound, atol=0.0)) for size, p in sizes):
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


def _unseen(problem: Problem, planned: Planned, shapes: Sequence[Parameter]) -> bool:
    """Whether a law has a length (a scale or width, not a place) below the noise of its joint's positions, or
    sets in and has nothing above it: a shift so small is a drift of whatever the model holds. Nor is a change
    of the deflection seen below the step of an encoder that little noise blurs; a ripple is, which returns
    while the encoder takes many."""
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
    """[N m] the largest torque that an effect makes of any balance."""
    balances, used = problem.balances, problem.readings.valid
    base = problem.with_nominal([])
    change = balances.changed(base, problem.with_nominal([planned]))
    torques = [np.max(np.abs(balances.time_series(spectrum)[used])) for spectrum in change.values()]
    return float(max(torques, default=0.0))


def supported(trial: Fit, without: Fit, added: Planned) -> bool:
    """Whether `added`, present in `trial`, earns its price, is material and beyond the method's error: at the
    level of `trial`, or, where nominal numbers as no machine has them would do instead, where they do not."""
    if _supported(trial, without, added):
        return True
    if not needs_implausible(without, trial):
        return False
    there, other = (fit(raised_until_plausible(without), f.effects) for f in (trial, without))
    return _supported(there, other, next(e for e in there.effects if e.key == added.key))


def _supported(trial: Fit, without: Fit, added: Planned) -> bool:
    if degenerate(trial.problem, added) or score(trial) >= score(without):
        return False
    if shared_by_tolerances(trial, without, added) or _between_samples(trial, added):
        return False
    gained, left = explained(trial, without, added), unexplained_energy(trial)
    paid = price(trial) - price(without)
    if gained - paid < trial.settings.search.unexplained_share * left:
        return False
    beside = _sharing_balances(trial, added)
    if beside:
        # what other causes on the joint explain is known only to the method's own error, which has a shape
        # of its own: what leaves next to nothing is not that
        alone = fit(trial.problem, [e for e in trial.effects if e not in beside])
        if gained < _method_error(trial, gained) * (alone.energy - trial.energy):
            return False
    if contradicted(trial, without):
        return False
    return shown_by_motion(trial, gained, added) and material(trial, added, gained)


def _between_samples(trial: Fit, added: Planned) -> bool:
    """Whether an effect shifts a command in time by next to nothing of a sample, beside another cause of
    timing on its joint: what a command does between two samples is not recorded, and a lag smooths it, where
    a delay does not."""
    shifts_time = added.effect.kind is Kind.TIMING and added.effect.site is Site.COMMAND
    if not shifts_time or not any(
        e is not added and e.joint == added.joint and e.effect.kind is Kind.TIMING for e in trial.effects
    ):
        return False
    longest = max(abs(added.values[p.name]) for p in added.effect.params if p.unit == "s")
    return bool(longest < trial.settings.search.between_samples * trial.problem.readings.period)


def needs_implausible(trial: Fit, other: Fit) -> bool:
    """Whether a set needs nominal numbers to be off as no machine's are, and further than another set does:
    against a loud error, the price of that is low (of a motor without torque, whose inertia is none)."""
    implausible, further = trial.settings.regression.implausible, trial.settings.search.further
    return trial.furthest > max(implausible, further * other.furthest)


def only_by_implausible(trial: Fit, without: Fit) -> bool:
    """Whether a set is better than another one by such numbers alone: no longer at a level at which what is
    left does not pull them so far."""
    if trial.furthest <= trial.settings.regression.implausible:
        return False
    if not needs_implausible(trial, fit(trial.problem, without.effects)):
        return False
    there, other = (fit(raised_until_plausible(trial), f.effects) for f in (trial, without))
    return score(there) >= score(other)


def raised_until_plausible(result: Fit) -> Problem:
    """The lowest level at which a fit's leftovers do not pull nominal numbers further than machines' are."""
    problem = result.problem
    while problem.furthest(result.y) > result.settings.regression.plausible:
        level = problem.level
        problem = problem.at(NoiseLevel(2.0 * level.inflation, level.implausibility))
    return problem


def _sharing_balances(trial: Fit, added: Planned) -> list[Planned]:
    """The other causes on an effect's joint that mark a balance which it marks, too."""
    others = [e for e in trial.effects if e is not added and e.joint == added.joint]
    if not others:
        return []
    touched = {e.key: torque_shares(trial.problem, trial.effects, k) > 0.0
               for k, e in enumerate(trial.effects) if e is added or e in others}  # fmt: skip
    return [e for e in others if np.any(touched[e.key] & touched[added.key])]


def _method_error(trial: Fit, gained: float) -> float:
    """Share of what other causes on its joint explain, that a cause must explain beyond it."""
    limits = trial.settings.search
    left = unexplained_energy(trial)
    if trial.problem.motion.missing or gained < limits.cleared * left:
        return limits.method_error
    noise_alone = bool(np.all(trial.problem.level.inflation < trial.settings.regression.noise_decides))
    perfect = noise_alone and gained >= limits.beyond_noise + limits.perfect * left
    return limits.least_method_error if perfect else limits.finer_method_error


def contradicted(trial: Fit, without: Fit) -> bool:
    """Whether what a set of effects explains beyond another leaves ten times more in a balance, beyond
    noise: a spring's torque does not explain what its motor shows where its link does not show it. A gain
    that a nominal number had hidden leaves more only until that number is corrected, too."""
    plain = _worse(trial.problem, without.effects, trial.effects)
    return plain and _worse(
        trial.problem, [*without.effects, *shifts(without)], [*trial.effects, *shifts(trial)]
    )


def _worse(problem: Problem, effects: Sequence[Planned], others: Sequence[Planned]) -> bool:
    """Whether a set of effects leaves ten times less than others in a balance, beyond noise."""
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
    """Energy that `added`, present in `trial`, explains. If it is the change of a nominal number, that number
    is held at its nominal value: far from it, it would explain the same at the price of its deviation."""
    gained, problem = without.energy - trial.energy, trial.problem
    k = own_number(problem, added)
    if k is not None:
        error = problem.deviation_errors()[k]
        # holding a number raises a least-squares energy by the square of its deviation in standard errors
        free, left = ((problem.deviations(y)[k] / error) ** 2 for y in (without.y, trial.y))
        gained += float(free - left)
    return gained


def shown_by_motion(trial: Fit, gained: float, added: Planned) -> bool:
    """Whether the energy that `added` earns comes from the motion: at the sensors' noise, a law of little
    energy (a gap as wide as that noise) may earn as much from the noise that it shrinks, which it no longer
    does along the denoised recording. One that shifts signals in time moves their noise n against the other
    sensors' noise m: that changes the energy by chance, by 2 m dn. So does a lag, which makes it smaller."""
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
    return denoised >= limits.denoised_share * measured


def _moved_noise(problem: Problem, effects: Sequence[Planned], others: Sequence[Planned]) -> float:
    """Root of the energy that the sensors' noise gets where it is moved by other effects."""
    before, after = problem.with_nominal(effects), problem.with_nominal(others)
    measured, denoised = (b.changed(before, after) for b in (problem.balances, problem.balances.denoised))
    noise = {row: spectrum - denoised[row] for row, spectrum in measured.items() if row in denoised}
    white = problem.whitening.white(problem.whitening.band(noise)).ravel()
    return float(np.sqrt(np.sum(white**2)))


def material(trial: Fit, added: Planned, gained: float) -> bool:
    """Whether an effect's torque is beyond the tolerance for what a model does not hold. That tolerance
    stands for errors of the model; where noise alone is left there are none, and next to none where the
    effect clears the balances that it touches: smaller effects count there that are beyond doubt."""
    limits = trial.settings.search
    if tolerated(trial.problem, added):
        return False
    shares = torque_shares(trial.problem, trial.effects, trial.effects.index(added))
    tolerance = trial.problem.robot.tolerance.torque
    uncertain = gained < (limits.certain if added.since is None else limits.certain_dated)
    if np.max(shares) >= tolerance or np.max(shares) < limits.negligible * tolerance or uncertain:
        return bool(np.max(shares) >= tolerance)
    touched = shares > 0.0
    left = at_own_level(trial).problem.level.inflation[touched]
    if np.all(left < trial.settings.regression.noise_decides):
        return True
    before = at_own_level(refit_without(trial, added)).problem.level.inflation[touched]
    wrong = before > limits.wrong
    return bool(np.any(wrong) and np.mean(np.log(before[wrong] / left[wrong])) >= np.log(limits.cleared))


def tolerated(problem: Problem, added: Planned) -> bool:
    """Whether an effect is a nominal number that is off by no more than its tolerance claims."""
    k = own_number(problem, added)
    if k is None:
        return False
    number, (param,) = problem.nuisance[k], added.effect.nulls
    damping = problem.robot.joint(str(number.joint)).drive.D_m if number.name == "motor_damping" else 1.0
    return bool(abs(added.values[param.name]) <= problem.settings.search.tolerated * number.std * damping)


def shared_by_tolerances(trial: Fit, without: Fit, added: Planned) -> bool:
    """Whether an effect is the change of a nominal number that need not be off by more than its tolerance
    claims, as others are off, too. Where more than noise is left, deviations say less than they are."""
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
        if nominal and number.std > 0.0 and (name, number.joint) == added.key:
            return k
    return None


def torque_shares(problem: Problem, effects: Sequence[Planned], index: int) -> np.ndarray:
    """(rows,) RMS torque of an effect in each balance, as a share of that joint's torque."""
    without = [e for k, e in enumerate(effects) if k != index]
    balances, used = problem.balances, problem.readings.valid
    change = balances.change(problem.with_nominal(without), problem.with_nominal(effects))
    shares = np.zeros(len(balances.rows))
    for r, (row, spectrum) in enumerate(zip(balances.rows, change, strict=True)):
        if np.any(spectrum):
            torque = balances.time_series(spectrum)[used]
            shares[r] = np.sqrt(np.mean(torque**2)) / problem.torque_scale[row.joint]
    return shares
