"""Simulate a robot along a reference: a table in, a recording out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flexjoint.core.errors import RecordingError, SimulationError
from flexjoint.core.limits import RECORDING, SIMULATION
from flexjoint.core.messages import shown
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.model.statics.start import at_rest, initial_positions
from flexjoint.recording.table import Recording, make
from flexjoint.robot.robot import Robot, expect
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.sensors import readings, true_signals
from flexjoint.simulation.trajectory import Trajectory

REFERENCES = ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")
TORQUES = ("tau_m", "tau_motor")
SHOWN = ("q", "dq", "theta", "dtheta", "tau_t", "tau_m")  # of each joint in a result, beside the references
ON_TICK = 0.05  # share of a tick by which samples may miss the tick grid


Drive = Literal["auto", "controller", "torque"]


@dataclass(frozen=True)
class Simulation:
    """A simulated run: sensor readings (`measured`) and true signals (`true`), both recordings of
    the same form, and the states behind them. Times count as in the reference."""

    measured: Recording
    true: Recording
    trajectory: Trajectory

    def __str__(self) -> str:
        return f"simulated {self.measured}"


def simulate(
    model: FlexibleJointModel | Robot,
    reference: Recording,
    options: RunOptions = DEFAULTS,
    *,
    drive: Drive = "auto",
    start: State | None = None,
    sample_rate: float | None = None,
    noise: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Simulation:
    """Simulate the model from rest along a reference.

    Args:
        model: a robot, with the effects that it lists, or a model.
        reference: q_ref (or theta_ref and tau_ff) of every actuated joint for the controller; or tau_m or
            tau_motor for the motors. Between its samples it is interpolated linearly. An absent theta_ref
            is q_ref + g(q_ref)/K and an absent tau_ff is g(q_ref), of the nominal model.
        drive: controller, torque, or auto: the controller where the reference has one.
        start: default: at rest at the first q_ref (or measured q), springs carrying the load.
        sample_rate: rows per second of the result, a divisor of the physics rate (default: that rate).
        noise: standard deviation by channel, drawn with `seed`; then readings are rounded to the joints'
            `resolution`.

    Raises:
        RobotError: what is handed in first is neither.
        RecordingError: the reference lacks what the drive needs.
        SimulationError: see `flexjoint.simulation.loop`, a sample rate that does not divide the physics
            rate, or a result that is larger than any recording (docs/reference/limits.md).
    """
    if not isinstance(model, FlexibleJointModel):
        model = FlexibleJointModel(expect(model, "simulate"))
    rate = options.rate_for(model.robot)
    stride = _stride(rate, sample_rate)
    names = model.robot.joint_names
    check_size(model, reference, rate)
    controller = controlled(reference, names, drive)
    _check_result(model, reference, rate / stride, controller)
    start = start or rest_of(model, reference, controller)
    if controller:
        ticks = ticks_of(reference, model.robot.rates.control)
        table = references_at(model, reference, ticks)
        tape = closed_loop(model, start, law_of(model.robot), table, options)
    else:
        steps = round(reference.duration * rate) + 1
        edges = reference.time[0] + np.arange(steps + 1) / rate
        torque = torque_over(reference, names, edges, command_rate(model.robot, reference))
        tape = rollout(model, start, torque, options)
    return _result(model, reference, tape, controller, stride, noise or {}, seed)


def check_size(model: FlexibleJointModel, reference: Recording, rate: float) -> None:
    """Raise SimulationError for a run that is longer than any that is made, or than its reference has samples
    for."""
    names = model.robot.joint_names
    steps = np.diff(reference.time)
    longest = int(np.argmax(steps)) if steps.size else 0
    held = bool(steps.size) and steps[longest] > RECORDING.held
    if held and np.sum(steps) > RECORDING.ticks_per_row * reference.time.size * np.median(steps):
        raise SimulationError(
            f"{shown(reference.name)}: expected a reference with fewer than {RECORDING.ticks_per_row:g}"
            f" sampling periods for each sample, got {reference.time.size} samples, most of them"
            f" {np.median(steps):.3g} s apart, in {reference.duration:.4g} s; the longest pause is"
            f" {steps[longest]:.4g} s at {reference.time[longest]:.6g} s; cut it at its pauses"
        )
    size = reference.duration * rate * len(names)
    if size > SIMULATION.joint_steps:
        raise SimulationError(
            f"{reference.name}: {reference.duration:.4g} s of {len(names)} joints at {rate:g} Hz are"
            f" {size:.2g} steps, at most {SIMULATION.joint_steps:g} are run; cut it at its pauses, or lower"
            " rates.physics"
        )


def _check_result(
    model: FlexibleJointModel, reference: Recording, sample_rate: float, controller: bool
) -> None:
    """Raise SimulationError for a run whose result is larger than any recording, before it is made."""
    columns = 1 + len(model.robot.joint_names) * (len(SHOWN) + (len(REFERENCES) if controller else 0))
    rows = reference.duration * sample_rate
    if rows * columns > RECORDING.cells:
        raise SimulationError(
            f"{reference.name}: {reference.duration:.4g} s at {sample_rate:g} Hz are {rows:.3g} rows of"
            f" {columns} columns, at most {RECORDING.cells:g} cells are kept; give a lower sample_rate, cut"
            " the reference, or run `flexjoint simulate`, which writes as it goes"
        )


# --- drives -----------------------------------------------------------------------------------------------
def torque_channel(recording: Recording, joints: tuple[str, ...]) -> str | None:
    """The channel that holds the motor torque of all joints: the command tau_m, else the measured
    tau_motor, else None."""
    for channel in TORQUES:
        if all(recording.has(channel, joint) for joint in joints):
            return channel
    return None


def command_rate(robot: Robot, recording: Recording) -> float:
    """How often a recorded tau_m may change [Hz]: at ticks, f_c. Where f_s is no multiple of f_c, commands
    begin on steps of the physics, between ticks: then f_s, if the recording has a sample for each step."""
    physics, control = robot.rates.physics, robot.rates.control
    if physics_rate(robot) == physics:
        return control
    place = (recording.time - recording.time[0]) * physics
    each = len(place) > 1 and np.max(np.abs(np.diff(place) - 1.0)) < ON_TICK
    return physics if each and np.max(np.abs(place - np.round(place))) < ON_TICK else control


def torque_over(recording: Recording, joints: tuple[str, ...], edges: np.ndarray, rate: float) -> np.ndarray:
    """(N, n) mean motor torque [N m] between the edges (N + 1,) [s], on the recording's clock.

    tau_m is a command, held for 1/rate from each tick of `command_rate` [Hz]: ticks that the recording missed
    are interpolated linearly at their times. Samples off the tick grid show a command that is half a tick
    old on average. tau_motor is a measurement: interpolated linearly, not held. Raises RecordingError when
    neither is there.
    """
    channel = torque_channel(recording, joints)
    if channel is None:
        lacking = [j for j in joints if not any(recording.has(c, j) for c in TORQUES)] or list(joints)
        raise RecordingError(
            f"{recording.name}: no tau_m or tau_motor for joint {lacking[0]}; record it for every joint, or"
            " drive the simulation through the controller (closed loop)"
        )
    time = recording.time
    out = np.empty((len(edges) - 1, len(joints)))
    if channel == "tau_m":
        place = (time - time[0]) * rate
        on_tick = np.max(np.abs(place - np.round(place))) < ON_TICK
        first, last = (
            np.floor((edges[0] - time[0]) * rate) - 1,
            (edges[-1] - time[0]) * rate + 1,
        )
        ticks = time[0] + np.arange(first, np.ceil(last) + 1) / rate
    for k, joint in enumerate(joints):
        known = np.isfinite(recording.get(channel, joint))
        values = recording.get(channel, joint)[known]
        if channel == "tau_motor":
            out[:, k] = np.interp(0.5 * (edges[:-1] + edges[1:]), time[known], values)
            continue
        shown = time[known] if on_tick else time[known] - 0.5 / rate
        held = np.interp(ticks, shown, values)
        impulse = np.concatenate([[0.0], np.cumsum(held[:-1]) / rate])
        out[:, k] = np.diff(np.interp(edges, ticks, impulse)) / np.diff(edges)
    return out


def references_at(
    model: FlexibleJointModel, recording: Recording, ticks: np.ndarray
) -> dict[str, np.ndarray]:
    """q_ref, theta_ref, dtheta_ref and tau_ff, each (T, n), at the ticks (T,) on the recording's clock.

    Absent ones as the nominal controller makes them: theta_ref = q_ref + g(q_ref)/K, dtheta_ref = 0,
    tau_ff = g(q_ref). Raises RecordingError when a joint has neither q_ref nor theta_ref and tau_ff.
    """
    joints = model.robot.joint_names
    table: dict[str, np.ndarray] = {}
    for channel in REFERENCES:
        columns = np.full((len(ticks), len(joints)), np.nan)
        for k, joint in enumerate(joints):
            if recording.has(channel, joint):
                columns[:, k] = _sampled(recording, channel, joint, ticks)
        table[channel] = columns
    table["dtheta_ref"] = np.nan_to_num(table["dtheta_ref"])
    absent = np.isnan(table["theta_ref"][0]) | np.isnan(table["tau_ff"][0])
    lacking = absent & np.isnan(table["q_ref"][0])
    if np.any(lacking):
        raise RecordingError(
            f"{recording.name}: no q_ref for joint {joints[int(np.argmax(lacking))]}; the controller needs"
            " q_ref, or theta_ref and tau_ff, of every joint"
        )
    if np.any(absent):
        nominal = FlexibleJointModel(model.robot, [e for e in model.robot.effects if e.nominal])
        q = np.tile(nominal.body.neutral, (len(ticks), 1))
        for k, joint in enumerate(joints):
            known = table["q_ref"] if not np.isnan(table["q_ref"][0, k]) else table["theta_ref"]
            q[:, model.robot.joint(joint).idx_q] = known[:, k]
        rest = equilibrium(nominal, q)
        table["theta_ref"] = np.where(np.isnan(table["theta_ref"]), rest.theta, table["theta_ref"])
        table["tau_ff"] = np.where(np.isnan(table["tau_ff"]), rest.tau, table["tau_ff"])
    return table


def _sampled(recording: Recording, channel: str, joint: str, at: np.ndarray) -> np.ndarray:
    values = recording.get(channel, joint)
    known = np.isfinite(values)
    return np.interp(at, recording.time[known], values[known])


def controlled(reference: Recording, joints: tuple[str, ...], drive: Drive) -> bool:
    """Whether the controller drives."""
    return drive == "controller" or (drive == "auto" and _has_references(reference, joints))


def _has_references(reference: Recording, joints: tuple[str, ...]) -> bool:
    return all(reference.has("q_ref", joint) or reference.has("theta_ref", joint) for joint in joints)


def ticks_of(reference: Recording, control_rate: float) -> np.ndarray:
    """Times of the control ticks along a reference (T,) [s], on its clock."""
    count = int(np.floor(reference.duration * control_rate + 1e-6)) + 1
    return reference.time[0] + np.arange(count) / control_rate


def rest_of(model: FlexibleJointModel, reference: Recording, controller: bool) -> State:
    """The state at rest where the reference begins."""
    q = initial_positions(model)
    for joint in model.joints:
        for channel in ("q_ref", "q") if controller else ("q", "q_ref"):
            if reference.has(channel, joint.name):
                q[joint.idx_q] = _sampled(reference, channel, joint.name, reference.time[:1])[0]
                break
    return at_rest(model, q)


# --- the result -------------------------------------------------------------------------------------------
def _stride(rate: float, sample_rate: float | None) -> int:
    stride = 1 if sample_rate is None else round(rate / sample_rate) if sample_rate > 0 else 0
    if stride < 1 or (sample_rate is not None and abs(stride * sample_rate - rate) > 1e-6 * rate):
        raise SimulationError(
            f"sample_rate must divide the physics rate {rate:g} Hz, e.g. {rate / 2:g}; got {sample_rate}"
        )
    return stride


def _result(
    model: FlexibleJointModel,
    reference: Recording,
    tape: Trajectory,
    controller: bool,
    stride: int,
    noise: Mapping[str, float],
    seed: int,
) -> Simulation:
    rows = slice(tape.first, len(tape.time) - 1, stride)  # the last row has no command of its own
    time = reference.time[0] + tape.time[rows] - tape.time[tape.first]
    given = _given(model, reference, tape, rows, time, controller)
    true = true_signals(model, tape)
    seen = readings(model, tape, true)
    exact = {key: values[rows] for key, values in true.items()}
    measured = {key: values[: len(values) - 1 : stride] for key, values in seen.items()}
    measured = _noisy(model, measured, noise, seed)
    label = f"{model.robot.name} along {reference.name}"
    return Simulation(
        make(time, {**measured, **given}, label), make(time, {**exact, **given}, f"{label}, true"), tape
    )


def measured_rows(
    model: FlexibleJointModel,
    reference: Recording,
    tape: Trajectory,
    start: State,
    controller: bool,
    begin: float,
) -> Recording:
    """The readings of a piece of a run from `start`, as `Simulation.measured` has them. The reference holds
    the times of the piece, and begins at `begin` [s] as a whole."""
    rows = slice(tape.first, len(tape.time) - 1)
    time = begin + tape.time[rows] - start.t
    given = _given(model, reference, tape, rows, time, controller)
    seen = {
        (channel, name): _rounded(model, channel, name, values[:-1])
        for (channel, name), values in readings(model, tape).items()
    }
    return Recording(time, {**seen, **given}, f"{model.robot.name} along {reference.name}")


def _given(
    model: FlexibleJointModel,
    reference: Recording,
    tape: Trajectory,
    rows: slice,
    time: np.ndarray,
    controller: bool,
) -> dict[tuple[str, str], np.ndarray]:
    """What drove the motors at some rows of a tape: torques, and what the controller followed."""
    names = model.robot.joint_names
    given = {("tau_m", name): tape.tau_m[rows, i] for i, name in enumerate(names)}
    if controller:
        for channel, columns in references_at(model, reference, time).items():
            given.update({(channel, name): columns[:, i] for i, name in enumerate(names)})
    return {key: values for key, values in given.items() if np.all(np.isfinite(values))}


def _noisy(
    model: FlexibleJointModel,
    readings: Mapping[tuple[str, str], np.ndarray],
    noise: Mapping[str, float],
    seed: int,
) -> dict[tuple[str, str], np.ndarray]:
    random = np.random.default_rng(seed)
    out = {}
    for (channel, name), exact in readings.items():
        values = exact + noise.get(channel, 0.0) * random.standard_normal(len(exact))
        out[channel, name] = _rounded(model, channel, name, values)
    return out


def _rounded(model: FlexibleJointModel, channel: str, joint: str, values: np.ndarray) -> np.ndarray:
    """Readings in steps of their sensor."""
    resolution = (model.robot.joint(joint).resolution or {}).get(channel, 0.0)
    return resolution * np.round(values / resolution) if resolution > 0 else values
