"""Deviations of the nominal numbers beyond first order, and the energy of a set of effects with them.

To first order every deviation changes the residual by its own column (problem.py). But two deviations also
have a product (a stiffness with its encoders' offsets, or with a gap beside it), and an inertia changes how
noise enters a balance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexjoint.diagnosis.balances.balances import MOTOR, TwinBalances
from flexjoint.diagnosis.balances.motion import Links, reconstruct
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.nuisance import as_effects
from flexjoint.diagnosis.regression.problem import REMEMBERED, Problem
from flexjoint.diagnosis.regression.whitening import Whitening
from flexjoint.effects import Planned, Site

LINK_ROUNDS = 12  # at most, in which unmeasured links are put where the likely numbers have them
LINKS_CONVERGED = 1.0  # a round lowers the energy by less than this, which tells nothing
REMEMBERED_STEPS = 4  # rounds from which the end of all is foretold
LEAST_CHANGE = 1e-6  # among these rounds: what changes less is rounding
SWINGS = 0.01  # share of the motors' squared balances, from which links are taken to swing at the start
MOST_HALVINGS = 6  # of a step that raises the energy
MOST_STEPS = 12  # Gauss-Newton steps of the nominal numbers at most, until
LEAST_STEP = 1e-3  # of a joint's torque, by which a command's slope is taken
CONVERGED = 0.1  # a step gains, or promises, less than this energy


def deviation_effects(problem: Problem, deviations: np.ndarray) -> list[Planned]:
    """Deviations (numbers,) of the nominal numbers beside which what is left is counted, as effects that a
    model can hold: all but those of friction that the model claims (`NominalNumber.claims_friction`)."""
    return _effects(problem, np.where(_as_effects(problem), deviations, 0.0))


def every_deviation(problem: Problem, deviations: np.ndarray) -> list[Planned]:
    """The same with those of claimed friction: what a simulation of the likely machine has."""
    return _effects(problem, deviations)


def _effects(problem: Problem, deviations: np.ndarray) -> list[Planned]:
    other_component = problem.settings.regression.other_component
    inertial = problem.motion.rigid.inertial
    return as_effects(problem.nuisance, -deviations, inertial, problem.robot, other_component)


def about_likely_links(problem: Problem) -> Problem:
    """The problem with the links that only their motors tell of where the likely nominal numbers put them,
    those that explain most of the residual: balances are linear about the links' motion, and twice the error
    of a number makes four times the error of that. The problem itself, where there are none."""
    if not problem.balances.missing_links:
        return problem
    count = sum(number.of_the_robot for number in problem.nuisance)  # before those of jumps and starts
    best = _Put(problem, np.zeros(count), np.zeros(2 * len(problem.balances.missing_links)))
    steps: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(LINK_ROUNDS):
        here, y = best.problem, best.problem.residual([])
        likely = here.at(here.plausible_level(y)).deviations(y)[:count]
        steps = [*steps[-REMEMBERED_STEPS:], (best.deviations, likely)]
        places = (_ahead(steps), likely) if len(steps) > 1 else (likely,)
        trials = (trial for place in places for trial in _put(problem, best, place))
        better = next((t for t in trials if t.energy < best.energy - LINKS_CONVERGED), None)
        if better is None:
            break
        best = better
    return best.problem


@dataclass(frozen=True)
class _Put:
    """The problem with the links where deviations (numbers,) of the robot's numbers have them, from a start
    (2 k,) beyond rest (`reconstruct`)."""

    problem: Problem
    deviations: np.ndarray
    start: np.ndarray

    @cached_property
    def energy(self) -> float:
        return self.problem.energy(self.problem.residual([]))


def _put(nominal: Problem, now: _Put, deviations: np.ndarray) -> Iterator[_Put]:
    """The problem with the links where deviations have them: they swing at the start as the motors' balances
    show beside `now`, where these show it, or start as there; nothing where they make no mechanism."""
    rest = len(now.problem.nuisance) - deviations.size
    effects = deviation_effects(now.problem, np.pad(deviations, (0, rest)))
    claimed = {e.key for e in nominal.nominal}
    numbers = [e for e in effects if e.key not in claimed]  # effects move no link here
    swing, share = _swing(now.problem, effects)
    recording, motions = nominal.readings.recording, (nominal.motion, nominal.balances.denoised.motion)
    for start in (now.start + swing, now.start) if share > SWINGS else (now.start,):
        moved = [reconstruct(nominal.robot, m.readings, recording, numbers, start) for m in motions]
        if all(np.isfinite(m.q).all() for m in moved):
            yield _Put(Problem(TwinBalances(*moved)), deviations, start)


def _ahead(steps: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Where rounds that each lead from one place (numbers,) to another would end, were they linear: Anderson
    1965, "Iterative procedures for nonlinear integral equations". By themselves they go there by a fifth of
    the way each, where a link's deflection is off by much of its size."""
    ways = [there - here for here, there in steps]
    change, places = (
        np.array([x[-1] - one for one in x[:-1]]).T for x in (ways, [there for _, there in steps])
    )
    share = np.linalg.lstsq(change, ways[-1], rcond=LEAST_CHANGE)[0]
    return np.asarray(steps[-1][1] - places @ share)


def _swing(problem: Problem, effects: Sequence[Planned]) -> tuple[np.ndarray, float]:
    """`MissingLinks.swing` of links with these deviations of the nominal numbers."""
    balances, links = problem.balances, Links.of(problem.robot, effects)
    series = balances.time_series(balances.residual(problem.with_nominal(effects)))
    return balances.missing_links.beside(links).swing(
        {row.joint: series[r] for r, row in enumerate(balances.rows) if row.balance == MOTOR}
    )


def converged_deviations(problem: Problem, effects: Sequence[Planned], y: np.ndarray) -> np.ndarray:
    """(numbers,) deviations that explain most of the residual y of some effects, their products included."""
    return problem.deviations(relinearised(problem, effects, y))


def relinearised(problem: Problem, effects: Sequence[Planned], y: np.ndarray) -> np.ndarray:
    """(samples,) the residual y of some effects, corrected so that the nominal numbers' first-order columns
    give the right residual at the deviations that explain most of it. So products of deviations are
    included, and with them when a friction sticks and slips."""
    linear = ~_as_effects(problem)

    def there(deviations: np.ndarray) -> np.ndarray:
        return problem.residual([*effects, *deviation_effects(problem, deviations)])

    def energy(deviations: np.ndarray, residual: np.ndarray) -> float:
        left = (residual - problem.along(np.where(linear, deviations, 0.0))) * problem.weights
        return float(left @ left) + float(deviations @ deviations)

    deviations, left = np.zeros(len(problem.nuisance)), y
    least = energy(deviations, left)
    for _ in range(MOST_STEPS):
        step = problem.deviations(y) - deviations
        moved = problem.along(step) * problem.weights
        gained = 0.0
        # beside a cause that multiplies it, a number does more than its column says, and a step too much
        for halving in range(MOST_HALVINGS):
            if 0.25**halving * float(moved @ moved) < CONVERGED:
                break
            trial = deviations + 0.5**halving * step
            trial_left = there(trial)
            trial_energy = energy(trial, trial_left)
            gained = least - trial_energy
            if gained > 0.0:
                break
        if not gained > 0.0:
            break
        deviations, left, least = trial, trial_left, trial_energy
        y = left + problem.along(np.where(linear, 0.0, deviations))
        if gained < CONVERGED:
            break
    return y


def judged_energy(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    """The energy by which a set of effects with the whitened residual y is judged: Q(y, y), evaluated in full
    and whitened for the noise of the corrected model where sensor noise decides or an effect changes it, plus
    what effects of the command hide by making a balance smaller (`_shrunk`). Rivals are judged by one
    measure: a stiffness 5 % off changes how noise enters beside any of them, and where only some were
    evaluated in full, that alone decided between them."""
    return _evaluated(problem, y, effects) + _shrunk(problem, y, effects)


def _shrunk(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    """Energy that effects of the command hide in the motors' balances: with less torque, less inertia and
    less friction a balance is as wrong as before, only in smaller numbers, down to zero for a gain of zero
    (the trivial solution of a homogeneous regression). What is left beyond noise is scaled back to the
    recorded command; and a law that lets less of the torque's noise through (a motor that saturates) would
    fit any recording better by what it takes of that noise."""
    changed = _changed_commands(problem, effects)
    if not changed:
        return 0.0
    rows = len(problem.balances.rows)
    left = problem.rest_by_row(y)
    noise, kept = problem.freedom / rows, problem.torque_noise_kept
    total = 0.0
    for row, command in changed.items():
        expected = noise * float(problem.by_row[row])
        beyond = max(0.0, float(left[row] @ left[row]) - expected)
        total += beyond * (1.0 / command.size**2 - 1.0)
        total += expected * kept[row] * max(0.0, 1.0 - command.slope**2)
    return total


@dataclass(frozen=True)
class _Command:
    """What effects make of a commanded torque, over what the nominal model's make of it."""

    size: float  # at least `regression.least_command`
    slope: float  # RMS of its change by a small change of the torque: what is let through of noise


def _changed_commands(problem: Problem, effects: Sequence[Planned]) -> dict[int, _Command]:
    """By row, of the motors' balances whose command effects change."""
    balances, used = problem.balances, problem.readings.valid
    every = problem.with_nominal(effects)
    changed = {}
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
        chains, noise = balances.chains, float(problem.readings.noise["torque"][row.joint])
        step = max(noise, LEAST_STEP * float(problem.torque_scale[row.joint]))
        sizes, slopes = [], []
        for of in (here, nominal):
            counted = chains.command_scale(row.joint, of)  # the balance is counted in recorded torque already
            torque, up, down = (chains.command(row.joint, of, more)[used] for more in (0.0, step, -step))
            sizes.append(counted * float(np.std(torque)))
            slopes.append(counted * float(np.sqrt(np.mean(((up - down) / (2.0 * step)) ** 2))))
        if sizes[1] > 0.0 and slopes[1] > 0.0:
            size = max(sizes[0] / sizes[1], problem.settings.regression.least_command)
            changed[r] = _Command(size, slopes[0] / slopes[1])
    return changed


def _evaluated(problem: Problem, y: np.ndarray, effects: Sequence[Planned]) -> float:
    limits = problem.settings.regression
    deviations = problem.deviations(y)
    noise_decides = np.max(problem.level.inflation) < limits.noise_decides
    if not noise_decides and not any(whitening.changes_noise(e) for e in effects):
        return problem.energy(y)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if noise_decides:
                energy = _energy_at(problem, deviations, effects)
                energy = min(energy, _energy_at(problem, converged_deviations(problem, effects, y), effects))
            else:  # what is left is not sensor noise: no smaller where a model predicts more of that noise
                changed, usual = (
                    _energy_at(problem, deviations, effects, white)
                    for white in (_white_for(problem, effects), problem.whitening)
                )
                energy = problem.energy(y) + max(0.0, changed - usual)
    except np.linalg.LinAlgError:  # beside a wrong cause the numbers may be impossible (a negative mass)
        return problem.energy(y)
    if not any(e.effect.overrides("edit_inertial") for e in problem.nominal):
        problem.motion.rigid.regressor.forget(REMEMBERED)  # nobody else asks for it
    return energy


def _energy_at(
    problem: Problem, deviations: np.ndarray, effects: Sequence[Planned], under: Whitening | None = None
) -> float:
    """Energy of some effects where the nominal numbers are off by these deviations, under a whitening or
    that of the noise which a model with these effects and numbers predicts."""
    there = problem.with_nominal([*effects, *deviation_effects(problem, deviations)])
    balances = problem.balances
    known = _noise_known(problem, there)
    there_white = under or _white_for(problem, there)
    spectra = balances.residual(known)
    if len(known) < len(there):
        spectra = spectra + balances.denoised.change(known, there)
    white = there_white.apply(spectra).ravel()
    # the other nominal numbers (of effects, of jumps) change no noise: they enter to first order
    linear = problem.along(np.where(_as_effects(problem), 0.0, deviations))
    residual = (white - linear) * problem.weights
    return float(residual @ residual) + float(deviations @ deviations)


def _white_for(problem: Problem, effects: Sequence[Planned]) -> Whitening:
    """The whitening of the noise that a model with these effects predicts."""
    scale = np.array([problem.torque_scale[r.joint] for r in problem.balances.rows])
    return whitening.make(problem.balances, scale, _noise_known(problem, effects), like=problem.whitening)


def _noise_known(problem: Problem, effects: Sequence[Planned]) -> list[Planned]:
    """The effects but those that shape the noise in other ways than by what enters a whitening: these are
    evaluated without it."""
    return [
        e for e in effects if whitening.changes_noise(e) or not whitening.shapes_noise(e, problem.balances)
    ]


def _as_effects(problem: Problem) -> np.ndarray:
    """(numbers,) bool: those of which `deviation_effects` makes effects."""
    return np.array([n.becomes_effect and not n.claims_friction for n in problem.nuisance], dtype=bool)
