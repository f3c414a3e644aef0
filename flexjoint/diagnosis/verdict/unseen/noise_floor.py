"""What the sensors' noise alone leaves between a recording and a simulation by the right model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import OutOfTimeError
from flexjoint.diagnosis.comparison.compare import Comparison, compared
from flexjoint.diagnosis.signals.command import Source
from flexjoint.diagnosis.signals.signals import torque_noise
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.noise import white_noise
from flexjoint.recording.table import MEASURED, Recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import torque_channel

SEED = 0  # of the noise that is added: any will do


def noise_floor(model: Robot, recording: Recording) -> dict[str, dict[str, float]]:
    """`Gain.noise_floor`, by channel and joint: noise of the readings (`rms`), and the error of a simulation
    that all noise makes (`simulated`)."""
    return {"rms": of_readings(model, recording), "simulated": of_simulation(model, recording)}


def of_readings(robot: Robot, recording: Recording) -> dict[str, float]:
    """Predicted noise of each reading, by channel and joint: no model can come below it."""
    return {
        f"{channel}.{joint}": white_noise(values)
        for (channel, joint), values in recording.columns.items()
        if channel in MEASURED and joint in robot.joint_names
    }


def of_simulation(model: Robot, recording: Recording) -> dict[str, float]:
    """RMS error by channel and joint that a simulation by the right model, in windows as those of a
    comparison, has by noise: that of the reading, and what becomes of the noise of the start states and of
    the driving torques. The latter is measured: it is how far the simulation moves when as much noise again
    is added to the readings. Empty where the recording cannot drive a simulation.

    Raises OutOfTimeError where the time of the work is over."""
    simulated = FlexibleJointModel(model)
    try:
        as_read, noisier = (compared(simulated, one) for one in (recording, _noisier(model, recording)))
    except OutOfTimeError:
        raise
    except FlexJointError:
        return {}
    readings = of_readings(model, recording)
    moved = {f"{c}.{joint}": _moved(as_read, noisier, {(c, joint): 1.0}) for c, joint in as_read.simulated}
    for joint in model.joint_names:
        if {("q", joint), ("theta", joint)} <= as_read.simulated.keys():
            readings[f"phi.{joint}"] = float(np.hypot(readings[f"q.{joint}"], readings[f"theta.{joint}"]))
            moved[f"phi.{joint}"] = _moved(as_read, noisier, {("theta", joint): 1.0, ("q", joint): -1.0})
    return {name: float(np.hypot(readings[name], drift)) for name, drift in moved.items()}


def _noisier(robot: Robot, recording: Recording) -> Recording:
    """The recording with as much noise again in what a simulation starts from and is driven by."""
    rng = np.random.default_rng(SEED)
    driving = torque_channel(recording, robot.joint_names)
    columns = dict(recording.columns)
    for (channel, joint), values in sorted(columns.items(), key=lambda c: c[0]):  # the same in whatever order
        if joint not in robot.joint_names:
            continue
        if channel in MEASURED:
            noise = white_noise(values)
        elif channel == driving:
            source = Source(values, held=channel == "tau_m", origin=channel)
            noise = torque_noise(source, recording.period, robot.rates.control)
        else:
            continue
        columns[channel, joint] = values + noise * rng.standard_normal(values.size)
    return replace(recording, columns=columns)


def _moved(before: Comparison, after: Comparison, of: Mapping[tuple[str, str], float]) -> float:
    """RMS by which a weighted sum of simulated channels differs between two runs."""
    change = np.sum([x * (after.simulated[key] - before.simulated[key]) for key, x in of.items()], axis=0)
    return float(np.sqrt(np.mean(change[np.isfinite(change)] ** 2)))
