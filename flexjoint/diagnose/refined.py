"""Findings with their numbers refined by output error, or the reason why they keep the balances' numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnose.fit import Fit, covariance
from flexjoint.diagnose.output_error import BLOCK, Estimate, Refinement
from flexjoint.diagnose.reliability import followed
from flexjoint.diagnose.shooting import Shooting, slot_label
from flexjoint.diagnose.workspace import IMPLAUSIBLE, PLAUSIBLE
from flexjoint.diagnosis import Estimation, Finding
from flexjoint.effect import Planned
from flexjoint.errors import FlexJointError
from flexjoint.recording import Recording
from flexjoint.robot import Robot
from flexjoint.simulate import torque_channel

LENGTHS = (0.2, 0.1, 0.05)  # s, of the windows that are tried
DISTURBED = 1.1  # squared residual per degree of freedom from which noise of the torques is sought in it
NOISY = 1.5  # squared residual per degree of freedom up to which noise explains it, and
SHORTER = 0.7  # share of it that windows of half the length must leave, to be taken instead
SELDOM = 0.02  # share of such windows that is no sign of windows that are too long
MOST_OUTLYING = 0.2  # share of them that leaves a refinement without a basis
FEWEST = 8  # windows
TO_NOISE = 1.05  # squared residual per degree of freedom up to which the simulation follows the readings
WORSE = 4.0  # times what chance takes, from which held-out windows speak against a refinement
LESS_WELL = 1.2  # times the balances' standard errors, and
CONFIRMED = 2.0  # of the simulation's, within which it confirms the balances' numbers


def refine(
    robot: Robot, recording: Recording, best: Fit, found: Sequence[Finding], workers: int = 1
) -> tuple[tuple[Finding, ...], Estimation]:
    """Findings with the numbers of their effects refined on the simulation, or as they are where that does
    not serve: the estimation says which, and why. Where a position is missing, which the balances need, they
    are believed more if the simulation follows the readings. So many `workers` (processes) share the
    simulations."""
    refinement = _begun(robot, recording, best, workers)
    why = refinement if isinstance(refinement, str) else ""
    if not isinstance(refinement, str):
        try:
            estimate = refinement.estimate()
        except (FlexJointError, np.linalg.LinAlgError) as error:
            why = str(error)
        else:
            if best.workspace.motion.missing and _follows(estimate):
                found = tuple(map(followed, found))
            why = _against(estimate) or _known_better(best, estimate)
            if not why:
                effects = refinement.with_numbers(estimate.numbers)
                changed = tuple(_changed(f, best, effects, estimate) for f in found)
                return changed, _estimation(best, estimate.covariance, estimate.bounds, estimate)
    return tuple(found), from_balances(best, why)


def from_balances(best: Fit, why: str) -> Estimation:
    """The estimation of numbers that are left as the balances gave them."""
    numbers = np.array([slot.get(best.effects) for slot in best.slots])
    low, high = (np.array([getattr(slot.param, side) for slot in best.slots]) for side in ("low", "high"))
    bounds = np.where(numbers <= low, -1, np.where(numbers >= high, 1, 0))
    return _estimation(best, _covariance(best), bounds, why=why)


def _covariance(best: Fit) -> np.ndarray:
    """(k, k) of the balances' numbers."""
    time = best.workspace.time
    blocks = np.tile(((time - time[0]) / BLOCK).astype(int), len(best.workspace.balances.rows))
    return covariance(best, blocks)


def _known_better(best: Fit, estimate: Estimate) -> str:
    """Why numbers need no refinement: the simulation confirms them, and knows them less well itself. Windows
    tell slow torques from noise less well than a whole recording does."""
    own, std = (np.sqrt(np.maximum(np.diag(c), 1e-300)) for c in (_covariance(best), estimate.covariance))
    moved = estimate.numbers - np.array([slot.get(best.effects) for slot in best.slots])
    if np.median(std / own) > LESS_WELL and np.all(np.abs(moved) < CONFIRMED * std):
        return "the simulation confirms them, and knows them less well"
    return ""


def _begun(robot: Robot, recording: Recording, best: Fit, workers: int) -> Refinement | str:
    """A refinement on windows as long as the simulation stays with the readings, or why there is none.

    A long window tells slow torques from noise (a torque moves a link by the square of the time), but what
    the model lacks and what is unstable grows in it. So it is halved while that lowers the residual by a
    third.
    """
    why = _unfit(robot, recording)
    if why:
        return why
    chosen: Refinement | None = None
    try:
        for seconds in LENGTHS:
            trial = _trial(robot, recording, best, seconds, workers)
            if trial is None:
                break
            if chosen is not None and not _better(trial, chosen):
                break
            chosen = trial
            if chosen.level < NOISY and chosen.outlying < SELDOM:
                break
    except (FlexJointError, np.linalg.LinAlgError) as error:
        return str(error)
    if chosen is None:
        return "the recording has too few stretches without gaps"
    return chosen


def _unfit(robot: Robot, recording: Recording) -> str:
    """Why a recording cannot drive a simulation of its windows; empty when it can."""
    if robot.contacts:
        return "the robot touches the ground"
    if len(robot.joints) < robot.model.nv:
        return "joints that swing freely are not refined"
    if torque_channel(recording, robot.joint_names) is None:
        return "not every motor torque is recorded"
    return ""


def _trial(robot: Robot, recording: Recording, best: Fit, seconds: float, workers: int) -> Refinement | None:
    """A refinement on windows of this length; with the noise of the motor torques where without it the
    residual is more than the sensors' noise. None: too few windows."""
    trial: Refinement | None = None
    for disturbed in (False, True):
        shooting = Shooting(
            robot, recording, best.workspace, best.effects, best.slots, seconds, disturbed, workers
        )
        if len(shooting.windows) < FEWEST:
            return None
        trial = Refinement(shooting, best)
        if trial.level < DISTURBED and trial.outlying < SELDOM:
            break
    return trial


def _better(shorter: Refinement, longer: Refinement) -> bool:
    return shorter.level < SHORTER * longer.level or shorter.outlying < SHORTER * longer.outlying


def _follows(estimate: Estimate) -> bool:
    """Whether the simulation follows the readings to their noise, with nominal numbers that machines have."""
    to_noise = estimate.level < TO_NOISE and estimate.outlying <= SELDOM
    return bool(to_noise and estimate.settled and estimate.pulled <= PLAUSIBLE)


def _against(estimate: Estimate) -> str:
    """Why an estimate is not to be taken; empty when it is."""
    spread = np.diag(estimate.covariance)
    if not np.all(np.isfinite(estimate.numbers)) or not np.all(np.isfinite(spread)):
        return "the simulation left the finite numbers"
    if estimate.outlying > MOST_OUTLYING:
        return "the simulation does not follow the readings"
    if estimate.pulled > IMPLAUSIBLE:
        return "the simulation follows only with nominal numbers far from their tolerances"
    if not estimate.settled:
        return "the refinement on the simulation did not converge"
    if estimate.gain < -WORSE * max(estimate.chance, len(estimate.numbers)):
        return "the refinement on the simulation did not hold on windows that it had not seen"
    return ""


def _changed(finding: Finding, best: Fit, effects: Sequence[Planned], estimate: Estimate) -> Finding:
    """A finding with the refined numbers of its effect."""
    place = next(k for k, e in enumerate(best.effects) if e.key == finding.planned.key)
    old, new = best.effects[place], effects[place]
    std, at = np.sqrt(np.diag(estimate.covariance)), estimate.bounds != 0
    parameters = dict(finding.parameters)
    turned = {}
    for param in new.effect.params:
        fitted = parameters[param.name]
        rows = [k for k, s in enumerate(best.slots) if s.effect == place and s.param.name == param.name]
        if isinstance(fitted, str) or not rows:
            continue
        # the finding's value is the change where the nominal model lists the effect
        moved = np.ravel(new.values[param.name]) - np.ravel(old.values[param.name])
        value = np.ravel(fitted.value) + moved
        if param.wraps:
            value = np.angle(np.exp(1j * value))
            turned[param.name] = float(value[0])
        one = param.size == 1
        parameters[param.name] = replace(
            fitted,
            value=float(value[0]) if one else tuple(map(float, value)),
            std=float(std[rows[0]]) if one else tuple(float(std[row]) for row in rows),
            at_bound=bool(np.any(at[rows])),
        )
    return replace(finding, parameters=parameters, planned=new.with_values(turned))


def _estimation(
    best: Fit, spread: np.ndarray, bounds: np.ndarray, estimate: Estimate | None = None, why: str = ""
) -> Estimation:
    size = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    names = tuple(slot_label(best.effects, slot) for slot in best.slots)
    sides = {-1: "lower", 1: "upper"}
    return Estimation(
        "balances" if estimate is None else "output_error",
        why,
        names,
        np.clip(spread / np.outer(size, size), -1.0, 1.0),
        tuple((name, sides[int(side)]) for name, side in zip(names, bounds, strict=True) if side),
        0.0 if estimate is None else estimate.seconds,
        1.0 if estimate is None else estimate.level,
    )
