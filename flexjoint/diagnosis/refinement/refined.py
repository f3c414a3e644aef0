"""Findings with their numbers refined by output error, or the reason why they keep the balances' numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import UNLIMITED, Budget, checkpoint, within
from flexjoint.diagnosis.refinement.open_model import OpenModel, slot_label
from flexjoint.diagnosis.refinement.output_error import Estimate, Refinement
from flexjoint.diagnosis.refinement.shooting import Shooting
from flexjoint.diagnosis.regression.fit import LEAST_VARIANCE, Fit
from flexjoint.diagnosis.regression.uncertainty import bounds_reached, number_covariance
from flexjoint.diagnosis.result import Estimation, Finding
from flexjoint.diagnosis.settings import Settings
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import torque_channel


def refine(
    best: Fit, found: Sequence[Finding], workers: int = 1, budget: Budget = UNLIMITED
) -> tuple[tuple[Finding, ...], Estimation]:
    """Findings with the numbers of their effects refined on the simulation; or unchanged, where that gives no
    better numbers, or the `budget` is spent before: the estimation says which, and why. `workers` is the
    number of processes that share the simulations."""
    with within(budget):
        return _refined(best, found, workers)


def _refined(best: Fit, found: Sequence[Finding], workers: int) -> tuple[tuple[Finding, ...], Estimation]:
    refinement = _begun(best, workers)
    why, follows = refinement if isinstance(refinement, str) else "", False
    if not isinstance(refinement, str):
        try:
            estimate = refinement.estimate()
        except (FlexJointError, np.linalg.LinAlgError) as error:
            why = str(error)
        else:
            follows = _follows(estimate, best.settings)
            why = _against(estimate, best.settings) or _known_better(best, estimate)
            if not why:
                effects = refinement.with_numbers(estimate.numbers)
                changed = tuple(_changed(f, best, effects, estimate) for f in found)
                return changed, _estimation(best, estimate.covariance, estimate.bounds, estimate)
    return tuple(found), replace(from_balances(best, why), follows=follows)


def from_balances(best: Fit, why: str) -> Estimation:
    """The estimation of numbers that are left as the balances gave them."""
    return _estimation(best, number_covariance(best), bounds_reached(best), why=why)


def _known_better(best: Fit, estimate: Estimate) -> str:
    """Why numbers need no refinement: the simulation confirms them, with larger standard errors. Short
    windows separate slow torques from noise less well than the whole recording does."""
    limits = best.settings.refinement
    own, std = (
        np.sqrt(np.maximum(np.diag(c), 1e-300)) for c in (number_covariance(best), estimate.covariance)
    )
    moved = estimate.numbers - np.array([slot.get(best.effects) for slot in best.slots])
    if np.median(std / own) > limits.less_well and np.all(np.abs(moved) < limits.confirmed * std):
        return "the simulation confirms them, with larger standard errors"
    return ""


def _begun(best: Fit, workers: int) -> Refinement | str:
    """A refinement on windows as long as the simulation stays with the readings, or why there is none.

    A long window separates slow torques from noise well (a torque moves a link by the square of the time),
    but errors of the model and unstable motions grow in it. So it is halved as long as that lowers the
    residual by a third.
    """
    limits = best.settings.refinement
    why = _unfit(best.problem.robot, best.problem.readings.recording) or _beyond_noise(best)
    if why:
        return why
    chosen: Refinement | None = None
    try:
        opened = OpenModel(best.problem, best.effects, best.slots)
        for seconds in limits.window_lengths:
            checkpoint()
            trial = _trial(best, opened, seconds, workers)
            if trial is None:
                break
            if chosen is not None and not _better(trial, chosen):
                break
            chosen = trial
            if chosen.level < limits.noise_explains and chosen.outlying < limits.few_outlying:
                break
    except (FlexJointError, np.linalg.LinAlgError) as error:
        return str(error)
    return chosen or "too few windows of the recording are without gaps, or can be simulated in its own time"


def _unfit(robot: Robot, recording: Recording) -> str:
    """Why a recording cannot drive a simulation of its windows; empty when it can."""
    if robot.contacts:
        return "the robot touches the ground"
    if len(robot.joints) < robot.model.nv:
        return "joints that swing freely are not refined"
    if torque_channel(recording, robot.joint_names) is None:
        return "not every motor torque is recorded"
    return ""


def _beyond_noise(best: Fit) -> str:
    """Why a refinement, which follows the readings to their noise, means nothing beside what a set leaves."""
    left = float(np.sqrt(np.max(best.problem.variances(best.y))))
    if left <= best.settings.refinement.most_left:
        return ""
    return f"what is left is {left:.0f} times the sensors' noise, to which the simulation would be fitted"


def _trial(best: Fit, opened: OpenModel, seconds: float, workers: int) -> Refinement | None:
    """A refinement on windows of this length; with the noise of the motor torques where without it the
    residual is more than the sensors' noise. None: too few windows."""
    limits = best.settings.refinement
    trial: Refinement | None = None
    for disturbed in (False, True):
        shooting = Shooting(opened, seconds, disturbed, workers)
        if len(shooting.windows) < limits.fewest_windows:
            return None
        trial = Refinement(shooting, best)
        if trial.level < limits.disturbed and trial.outlying < limits.few_outlying:
            break
    return trial


def _better(shorter: Refinement, longer: Refinement) -> bool:
    share = shorter.settings.refinement.shorter
    return shorter.level < share * longer.level or shorter.outlying < share * longer.outlying


def _follows(estimate: Estimate, settings: Settings) -> bool:
    """Whether the simulation follows the readings up to their noise, with plausible nominal numbers."""
    limits = settings.refinement
    to_noise = estimate.level < limits.follows and estimate.outlying <= limits.few_outlying
    return bool(to_noise and estimate.converged and estimate.furthest <= settings.regression.plausible)


def _against(estimate: Estimate, settings: Settings) -> str:
    """Why an estimate is not to be taken; empty when it is."""
    spread = np.diag(estimate.covariance)
    if not np.all(np.isfinite(estimate.numbers)) or not np.all(np.isfinite(spread)):
        return "the simulation left the finite numbers"
    if estimate.outlying > settings.refinement.most_outlying:
        return "the simulation does not follow the readings"
    if estimate.furthest > settings.regression.implausible:
        return "the simulation follows only with nominal numbers far from their tolerances"
    if not estimate.converged:
        return "the refinement on the simulation did not converge"
    if estimate.gain < -settings.refinement.worse * max(estimate.chance, len(estimate.numbers)):
        return "the refinement on the simulation did not hold on windows that it had not seen"
    return ""


def _changed(finding: Finding, best: Fit, effects: Sequence[Planned], estimate: Estimate) -> Finding:
    """A finding with the refined numbers of its effect."""
    place = next(k for k, e in enumerate(best.effects) if e.key == finding.planned.key)
    old, new = best.effects[place], effects[place]
    std, at = np.sqrt(np.diag(estimate.covariance)), _told(best, estimate.bounds) != 0
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


def _told(best: Fit, bounds: np.ndarray) -> np.ndarray:
    """(slots,) of the bounds at which numbers are, -1, 0 or 1, those that are said (`Parameter.bounds`)."""
    listed = {e.key for e in best.problem.nominal}
    said = [slot.param.bounds(best.effects[slot.effect].key in listed) for slot in best.slots]
    ends = np.array([high if side > 0 else low for (low, high), side in zip(said, bounds, strict=True)])
    return np.where(np.isfinite(ends), bounds, 0)


def _estimation(
    best: Fit, spread: np.ndarray, bounds: np.ndarray, estimate: Estimate | None = None, why: str = ""
) -> Estimation:
    size = np.sqrt(np.maximum(np.diag(spread), LEAST_VARIANCE))
    names = tuple(slot_label(best.effects, slot) for slot in best.slots)
    sides = {-1: "lower", 1: "upper"}
    return Estimation(
        "balances" if estimate is None else "output_error",
        why,
        names,
        np.clip(spread / np.outer(size, size), -1.0, 1.0),
        tuple(
            (name, sides[int(side)]) for name, side in zip(names, _told(best, bounds), strict=True) if side
        ),
        0.0 if estimate is None else estimate.seconds,
        1.0 if estimate is None else estimate.level,
        estimate is not None and _follows(estimate, best.settings),
    )
