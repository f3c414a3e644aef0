"""What is left of each balance on data that was held out of the fit, and how much of it depends on one
signal.

A real machine always leaves something: many small errors that nobody names. A true cause leaves just these;
a wrong one leaves more, and a smooth law of one signal would often remove that. So what is left is regressed
on one signal after another, on the blocks that were fitted, and judged on those that were held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, Balances, balances_of
from flexjoint.diagnosis.regression.deviations import converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.fit import Fit, fit, nominal_deviations
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.result import Remaining, Removed
from flexjoint.diagnosis.settings import USUAL, Settings, VerdictSettings
from flexjoint.diagnosis.verdict.held_out import held_out_blocks
from flexjoint.diagnosis.verdict.residuals import smooth_curve
from flexjoint.effects import Planned, Signals, Site
from flexjoint.recording.currents import with_torques
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

RIDGE = 1e-3  # of a curve's normal matrix, on its mean diagonal: corners that few samples visit stay flat
NEIGHBOURS = ("q", "tau_t")  # signals of a neighbour that may leave a trace: a cable over two joints


@dataclass(frozen=True)
class Unseen:
    """Filtered residuals [N m] of all balances on usable samples, by sets of causes."""

    problem: Problem
    away: np.ndarray  # (N,) bool: samples that the fits did not see
    before: np.ndarray  # (rows, N) of the nominal model
    after: np.ndarray  # of the whole set
    without: tuple[np.ndarray, ...]  # of the same model without each of its causes
    frictionless: Mapping[str, np.ndarray]  # without the ordinary friction of a joint that has some


def unseen(best: Fit, nothing: Fit) -> Unseen:
    """Residuals of a set of causes, fitted on every second block of two seconds, of the same model without
    each of them, and of the nominal model."""
    fitted = fit(unseen_problem(best.problem), best.effects)
    problem, numbers = fitted.problem, nominal_deviations(fitted)
    without = [_left(problem, [e for e in fitted.effects if e is not one], numbers) for one in fitted.effects]
    rubbing = dict.fromkeys(str(e.joint) for e in fitted.effects if e.effect.ordinary)
    frictionless = {
        joint: _left(
            problem,
            [e for e in fitted.effects if not (e.effect.ordinary and e.joint == joint)],
            numbers,
        )
        for joint in rubbing
    }
    after = _left(problem, fitted.effects, numbers)
    return Unseen(best.problem, away(problem), _nominal(nothing), after, tuple(without), frictionless)


def unseen_problem(problem: Problem) -> Problem:
    """The problem with every second block of two seconds counted only; all samples of a short recording."""
    blocks = held_out_blocks(
        problem.balances.chains.t[0] + problem.time, problem.settings.verdict.held_out_block
    )
    if np.any(blocks) and not np.all(blocks):
        return problem.at(NoiseLevel(problem.level.inflation)).only(~blocks)
    return problem


def away(problem: Problem) -> np.ndarray:
    """(N,) bool: usable samples that a fit of `unseen_problem` does not see; every second one of a recording
    that is too short for blocks."""
    blocks = held_out_blocks(problem.balances.chains.t, problem.settings.verdict.held_out_block)
    blocks = blocks[problem.readings.valid]
    return blocks if np.any(blocks) and not np.all(blocks) else np.arange(blocks.size) % 2 == 1


def joint_left(fitted: Fit, joint: str) -> tuple[float, tuple[float, ...]]:
    """[N m] RMS of what a fit of `unseen_problem` leaves where it did not look: of a joint's torque, and of
    each of its balances."""
    problem, j = fitted.problem, fitted.problem.robot.joint_names.index(joint)
    left = _left(problem, fitted.effects, nominal_deviations(fitted))[:, away(problem)]
    total = _total(problem.balances, left, j)
    own = [row.joint == j for row in problem.balances.rows]
    balances = tuple(float(x) for x in np.sqrt(np.mean(left[own] ** 2, axis=1)))
    return (0.0 if total is None else float(np.sqrt(np.mean(total**2)))), balances


def left_beside(problem: Problem, effects: Sequence[Planned]) -> np.ndarray:
    """(rows, N) what effects leave of all balances [N m] on all usable samples, beside nominal numbers as the
    samples that the problem counts tell them: on the others it is unseen."""
    return _left(problem, effects, converged_deviations(problem, effects, problem.residual(effects)))


def _left(problem: Problem, effects: Sequence[Planned], numbers: np.ndarray) -> np.ndarray:
    """(rows, N) what effects leave beside deviations (numbers,) of the nominal numbers."""
    every = [*problem.with_nominal(effects), *deviation_effects(problem, numbers)]
    return _of(problem, every) - problem.jumped(numbers)[:, problem.readings.valid]


def _nominal(nothing: Fit) -> np.ndarray:
    """(rows, N) what the nominal model leaves. Encoder offsets, free in each recording, are no error."""
    problem = nothing.problem
    offsets = [
        e for e in deviation_effects(problem, nominal_deviations(nothing)) if e.effect.site is Site.SENSOR
    ]
    return _of(problem, [*problem.nominal, *offsets])


def _of(problem: Problem, effects: Sequence[Planned]) -> np.ndarray:
    balances = problem.balances
    return np.asarray(balances.time_series(balances.residual(effects))[:, problem.readings.valid])


def torque_errors(robot: Robot, recording: Recording, settings: Settings = USUAL) -> dict[str, float]:
    """RMS [N m], by joint, of the measured motor torque minus what the model needs for the measured motion,
    on all usable samples; about its mean where encoder offsets are free. No number is corrected."""
    problem = Problem(balances_of(robot, with_torques(robot, recording), settings))
    left = _of(problem, problem.nominal)
    if robot.file.offsets == "per_recording":
        left = left - np.mean(left, axis=1, keepdims=True)
    totals = {name: _total(problem.balances, left, j) for j, name in enumerate(robot.joint_names)}
    return {name: float(np.sqrt(np.mean(x**2))) for name, x in totals.items() if x is not None}


# ------------------------------------------------------------------ causes
def removed(data: Unseen, k: int) -> Removed:
    """What cause k of a set removes, in the balance in which it removes the largest share."""
    problem, away = data.problem, data.away
    without, left = (np.mean(x[:, away] ** 2, axis=1) for x in (data.without[k], data.after))
    noise = np.maximum(problem.deviation**2, 1e-300)
    row = int(np.argmax((without - left) / np.maximum(left, noise)))
    where = problem.balances.rows[row]
    joint = problem.robot.joints[where.joint].name
    share, against = shape(data, data.after[row], joint)
    return Removed(
        joint, where.balance, float(np.sqrt(without[row])), float(np.sqrt(left[row])),
        float(np.sqrt(share * left[row])), against,
    )  # fmt: skip


def friction(data: Unseen, joint: str | None) -> float | None:
    """[N m] RMS of the torque that all ordinary friction of a joint removes; None where it has none."""
    if joint is None or joint not in data.frictionless:
        return None
    j = data.problem.robot.joint_names.index(joint)
    without, left = (_total(data.problem.balances, x, j) for x in (data.frictionless[joint], data.after))
    if without is None or left is None:
        return None
    gone = np.mean(without[data.away] ** 2) - np.mean(left[data.away] ** 2)
    return float(np.sqrt(max(0.0, gone)))


# ------------------------------------------------------------------ joints
def remaining(data: Unseen) -> tuple[Remaining, ...]:
    """What is left of each joint's torque."""
    problem, away = data.problem, data.away
    noise = _noise(problem)
    out = []
    for j, joint in enumerate(problem.robot.joints):
        before, after = (_total(problem.balances, x, j) for x in (data.before, data.after))
        if before is None or after is None:
            continue
        share, against = shape(data, after, joint.name)
        left = float(np.sqrt(np.mean(after[away] ** 2)))
        out.append(
            Remaining(
                joint.name,
                float(problem.torque_scale[j]),
                float(np.sqrt(np.mean(before[away] ** 2))),
                left,
                noise[j],
                float(np.sqrt(share)) * left,
                against,
            )
        )
    return tuple(out)


def _total(balances: Balances, series: np.ndarray, j: int) -> np.ndarray | None:
    """(N,) the joint's torque error: motor and link balance together, in which no spring torque appears."""
    rows = [k for k, row in enumerate(balances.rows) if row.joint == j and row.balance in (MOTOR, LINK)]
    return np.sum(series[rows], axis=0) if rows else None


def _noise(problem: Problem) -> list[float]:
    """RMS [N m] that the sensors' noise has in each joint's torque error."""
    balances, readings = problem.balances, problem.readings
    nominal = list(problem.nominal)
    measured, denoised = (
        b.time_series(b.residual(nominal))[:, readings.valid] for b in (balances, balances.denoised)
    )
    smoothing = float(np.sqrt(np.mean(balances.filter.gain**2)))  # of a torque's white noise
    out = []
    for j in range(len(problem.robot.joints)):
        positions = _total(balances, measured - denoised, j)
        moved = 0.0 if positions is None else float(np.std(positions))
        out.append(float(np.hypot(moved, smoothing * float(readings.noise["torque"][j]))))
    return out


def beyond_background(joints: Sequence[Remaining], settings: VerdictSettings) -> tuple[Remaining, ...]:
    """Joints of which more is left than noise and a background make, most first."""
    limit = [max(settings.above_noise * joint.noise, settings.finished * joint.torque) for joint in joints]
    out = [joint for joint, most in zip(joints, limit, strict=True) if joint.after >= most]
    return tuple(sorted(out, key=lambda joint: -joint.after / max(joint.torque, 1e-300)))


def unfinished(joints: Sequence[Remaining], settings: VerdictSettings) -> tuple[Remaining, ...]:
    """Joints at which some cause is still missing: more is left than noise and a background make, and this is
    either most of what there was, or a smooth law of one signal removes much of it."""
    out = []
    for joint in beyond_background(joints, settings):
        shaped = joint.structured**2 > settings.unfinished_shape * joint.before**2
        if shaped or joint.after**2 > settings.unfinished_share * joint.before**2:
            out.append(joint)
    return tuple(out)


# ------------------------------------------------------------------ shape
def shape(data: Unseen, series: np.ndarray, joint: str) -> tuple[float, str]:
    """The share of what is left of a joint (N,) on held-out blocks that a smooth law of one signal removes,
    fitted on the other blocks, and that signal."""
    best, most = "t", 0.0
    seen, away = ~data.away, data.away
    if not np.any(seen) or not np.any(away):
        return most, best
    whole = max(float(np.sum(series[away] ** 2)), 1e-300)
    for name, x in signals(data.problem, joint).items():
        design = smooth_curve(x)
        normal = design[seen].T @ design[seen]
        normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        rest = series[away] - design[away] @ np.linalg.solve(normal, design[seen].T @ series[seen])
        share = 1.0 - float(np.sum(rest**2)) / whole
        if share > most:
            best, most = name, share
    return most, best


def signals(problem: Problem, joint: str) -> Mapping[str, np.ndarray]:
    """(N,) signals that an error of a joint may depend on: its own, its neighbours' positions and loads."""
    names = problem.robot.joint_names
    at = names.index(joint)
    own = problem.signals(joint)
    out = {name: getattr(own, name) for name in ("q", "dtheta", "tau_t", "phi", "tau_m", "t")}
    for k in (at - 1, at + 1):
        if 0 <= k < len(names):
            other: Signals = problem.signals(names[k])
            out |= {f"{name}.{names[k]}": getattr(other, name) for name in NEIGHBOURS}
    return {name: x for name, x in out.items() if float(np.ptp(x)) > 0.0}
