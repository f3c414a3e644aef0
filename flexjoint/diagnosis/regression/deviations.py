"""Nominal numbers beyond first order: where their deviations are, and what a set of effects is worth there.

To first order every deviation has one trace in the residual (problem.py). Two deviations also have a
product, as a spring's with its encoders' offsets, or with a gap beside it, and an inertia changes what noise
makes of a balance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.balances.balances import MOTOR
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.nuisance import as_effects
from flexjoint.diagnosis.regression.problem import REMEMBERED, Problem
from flexjoint.effects import Planned, Site

MOST_STEPS = 12  # Gauss-Newton steps of the nominal numbers at most, until what they explain changes by less
CONVERGED = 0.1  # than this energy (beside a stiffness off by a fifth, each step leaves a fifth of an offset)


def deviation_effects(problem: Problem, deviations: np.ndarray) -> list[Planned]:
    """Deviations (numbers,) of the nominal numbers, as effects that a model can hold."""
    other_component = problem.settings.regression.other_component
    inertial = problem.motion.rigid.inertial
    return as_effects(problem.nuisance, -deviations, inertial, problem.robot, other_component)


def converged_deviations(problem: Problem, effects: Sequence[Planned], y: np.ndarray) -> np.ndarray:
    """(numbers,) deviations that explain most of the residual y of some effects, their products included."""
    return problem.deviations(relinearised(problem, effects, y))


def relinearised(problem: Problem, effects: Sequence[Planned], y: np.ndarray) -> np.ndarray:
    """(samples,) the residual y of some effects as it would be if it were linear in the nominal numbers, with
    the values that it has where these explain most of it: their products included, and when a friction holds
    and lets go."""
    deviations = problem.deviations(y)
    for _ in range(MOST_STEPS):
        there = problem.residual([*effects, *deviation_effects(problem, deviations)])
        last, y = deviations, there + problem.along(np.where(_as_effects(problem), deviations, 0.0))
        deviations = problem.deviations(y)
        moved = problem.along(deviations - last) * problem.weights
        if float(moved @ moved) < CONVERGED:
            break
    return y


def judged_energy(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    """Q(y, y), evaluated in full (noise and all) and whitened for the noise of the model that it implies,
    where that is another than the nominal one's; what is left beyond noise, in units of the command."""
    return _evaluated(problem, y, effects) + _shrunk(problem, y, effects)


def _shrunk(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    """Energy by which effects of the command shrink what is left beyond noise in the motors' balances: with
    less torque, less inertia and less friction an equation is as wrong as before, in smaller numbers. A gain
    of zero would leave nothing of it (the trivial solution of a homogeneous regression)."""
    sizes = _command_sizes(problem, effects)
    if not sizes:
        return 0.0
    rows = len(problem.balances.rows)
    left = (problem.rest(y) * problem.weights).reshape(rows, -1)
    noise = problem.freedom / rows
    total = 0.0
    for row, size in sizes.items():
        beyond = max(0.0, float(left[row] @ left[row]) - noise / float(problem.level.inflation[row]))
        total += beyond * (1.0 / size**2 - 1.0)
    return total


def _command_sizes(problem: Problem, effects: Sequence[Planned]) -> dict[int, float]:
    """By row, of the motors' balances whose command effects scale: the size of what changes of the torque,
    in that of the nominal model; at least LEAST_SIZE."""
    balances, used = problem.balances, problem.readings.valid
    every = problem.with_nominal(effects)
    sizes = {}
    for r, row in enumerate(balances.rows):
        if row.balance != MOTOR:
            continue
        name = problem.robot.joints[row.joint].name
        here, nominal = (
            [e for e in of if e.joint == name and e.effect.site is Site.COMMAND]
            for of in (every, problem.nominal)
        )
        if [e.identity for e in here] == [e.identity for e in nominal]:
            continue
        now, was = (float(np.std(balances.chains.command(row.joint, of)[used])) for of in (here, nominal))
        if was > 0.0:  # what a balance in recorded torque does not count already
            chains = balances.chains
            counted = chains.command_scale(row.joint, here) / chains.command_scale(row.joint, nominal)
            sizes[r] = max(counted * now / was, problem.settings.regression.least_command)
    return sizes


def _evaluated(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    limits = problem.settings.regression
    deviations = problem.deviations(y)
    far = (
        np.max(problem.level.inflation) < limits.noise_decides
        and np.max(np.abs(deviations), initial=0.0) > limits.plausible
    )
    if not far and not any(whitening.changes_noise(e) for e in effects):
        return problem.energy(y)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            energy = _energy_at(problem, deviations, effects)
            if np.max(problem.level.inflation) < limits.noise_decides:
                energy = min(energy, _energy_at(problem, converged_deviations(problem, effects, y), effects))
    except np.linalg.LinAlgError:  # beside a wrong cause numbers may be so far off that no machine has them
        return problem.energy(y)
    if not any(e.effect.overrides("edit_inertial") for e in problem.nominal):
        problem.motion.rigid.regressor.forget(REMEMBERED)  # nobody else asks for it
    return energy


def _energy_at(problem: Problem, deviations: np.ndarray, effects: Sequence[Planned]) -> float:
    """Energy of some effects where the nominal numbers are off by these deviations."""
    there = [*problem.with_nominal(effects), *deviation_effects(problem, deviations)]
    scale = np.array([problem.torque_scale[r.joint] for r in problem.balances.rows])
    there_white = whitening.make(problem.balances, scale, there, like=problem.whitening)
    white = there_white.apply(problem.balances.residual(there)).ravel()
    # other nominal numbers (of effects, offsets) change no noise: their part stays linear
    linear = problem.along(np.where(_as_effects(problem), 0.0, deviations))
    residual = (white - linear) * problem.weights
    return float(residual @ residual) + float(deviations @ deviations)


def _as_effects(problem: Problem) -> np.ndarray:
    """(numbers,) bool: those of which `deviation_effects` makes effects."""
    return np.array([n.becomes_effect for n in problem.nuisance], dtype=bool)
