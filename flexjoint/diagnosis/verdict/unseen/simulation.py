"""What a set of causes gains on held-out data, which its fit did not use."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import OutOfTimeError
from flexjoint.diagnosis.comparison.compare import HORIZON, Comparison, compared
from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without, shifts
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.result import Gain
from flexjoint.diagnosis.verdict.unseen.noise_floor import of_readings
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot


def held_out_blocks(time: np.ndarray, block: float) -> np.ndarray:
    """(N,) bool: samples that a fit does not see (time from the recording's start; every second
    `block` [s])."""
    return np.floor(time / block).astype(int) % 2 == 1


def gains(problem: Problem, best: Fit) -> list[float]:
    """Share of the nominal model's held-out error that each cause removes: refitted on the other blocks,
    with it and without it."""
    block = problem.settings.verdict.held_out_block
    away = held_out_blocks(problem.balances.chains.t[0] + problem.time, block)
    if not np.any(away) or np.all(away):
        away = np.arange(problem.time.size) % 2 == 1
    level = best.problem.level.inflation
    problem = problem.at(NoiseLevel(level))
    seen, unseen = problem.only(~away), problem.only(away)
    noise = float(np.sum(1.0 / level)) * float(np.sum(away)) * problem.whitening.freedom / len(level)

    def error(fitted: Fit) -> float:
        rest = fitted.problem.rest(fitted.y) * unseen.weights
        return float(rest @ rest)

    every = fit(seen, best.effects)
    everything, none = error(every), error(fit(seen, []))
    whole = max(none - min(noise, everything), 1e-300)
    out = []
    for e in every.effects:
        without = none if len(every.effects) == 1 else error(refit_without(every, e))
        out.append(float(np.clip((without - everything) / whole, 0.0, 1.0)))
    return out


def comparison(
    robot: Robot,
    recording: Recording,
    problem: Problem,
    best: Fit,
    known: Gain | None = None,
    nothing: Fit | None = None,
) -> Gain | None:
    """Simulation against the held-out blocks, with the nominal model and with the causes, whose numbers come
    from the other blocks. None where the recording cannot drive a simulation. The nominal model's errors are
    taken from `known`, an earlier comparison, if given. If the fit without causes, `nothing`, is given, the
    nominal numbers of both models are corrected within their tolerances, each as its own fit has them, and
    the whole recording is compared: other blocks do not tell the numbers of what acts only for a while, as
    friction after a rest does.

    Raises OutOfTimeError where the time of the work is over: errors over fewer windows are no measure."""
    block = problem.settings.verdict.held_out_block
    away = held_out_blocks(problem.balances.chains.t[0] + problem.time, block)
    held_out = nothing is None and bool(np.any(away) and not np.all(away))
    if held_out:
        best = fit(problem.at(NoiseLevel(best.problem.level.inflation)).only(~away), best.effects)
    first, last = robot, robot.extended(best.effects)
    if nothing is not None:
        first, last = robot.extended(shifts(nothing)), last.extended(shifts(best))
    rows = (
        held_out_blocks(recording.time - recording.time[0], block)
        if held_out
        else np.ones(len(recording.time), bool)
    )

    def measured(model: Robot) -> dict[str, Mapping[str, float]]:
        run = compared(FlexibleJointModel(model), problem.readings.recording)
        return errors(recording, run, rows)

    try:
        before = measured(first) if known is None else known.before
        after = measured(last) if best.effects else before
    except OutOfTimeError:
        raise
    except FlexJointError:
        return None
    return Gain(held_out, HORIZON, before, after, {"rms": of_readings(robot, recording)})


def errors(recording: Recording, run: Comparison, rows: np.ndarray) -> dict[str, Mapping[str, float]]:
    """RMS and NRMSE per channel over some rows; phi about its mean where both encoders are measured."""
    rms: dict[str, float] = {}
    nrmse: dict[str, float] = {}
    for (channel, joint), simulated in run.simulated.items():
        _add(rms, nrmse, f"{channel}.{joint}", recording.get(channel, joint), simulated, rows)
    for joint in dict.fromkeys(joint for _, joint in run.simulated):
        if ("q", joint) in run.simulated and ("theta", joint) in run.simulated:
            measured = recording.get("theta", joint) - recording.get("q", joint)
            phi = run.simulated["theta", joint] - run.simulated["q", joint]
            both = np.isfinite(measured) & np.isfinite(phi)
            _add(
                rms, nrmse, f"phi.{joint}", measured - np.mean(measured[both]), phi - np.mean(phi[both]), rows
            )
    return {"rms": rms, "nrmse": nrmse}


def _add(
    rms: dict[str, float],
    nrmse: dict[str, float],
    name: str,
    measured: np.ndarray,
    simulated: np.ndarray,
    rows: np.ndarray,
) -> None:
    error = (simulated - measured)[rows]
    error = error[np.isfinite(error)]
    if error.size:
        rms[name] = float(np.sqrt(np.mean(error**2)))
        spread = float(np.nanstd(measured))
        if spread > 0.0:
            nrmse[name] = rms[name] / spread
