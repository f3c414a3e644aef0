"""Recordings of a real machine under its controller, in the table of the file format.

plant() puts effects into a machine, drives it along an excitation and returns what its sensors and its
controller would have written down. In machine/ are the laws (laws.py), the time stepping (machine.py) and the
sensors (sensing.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from .catalogue import Planted, check
from .excitation import Reference, reference
from .machine.chain import Array, body_load, inverse_dynamics
from .machine.drive import Drive
from .machine.machine import Machine
from .machine.sensing import CURRENT, MEASURED, TOLD, Motion, Sensors, SensorSet
from .robots import Robot, deviating, read_robot

STEP_RATE = 5000.0  # Hz, at least; events are located, so a finer step changes nothing above 1e-7 rad
ON_SPRINGS = ("q", "dq", "tau_t")  # what nobody measures on a rigid joint beside its motor
SETTLING = 0.5  # s of holding the first reference before the recording starts


@dataclass(frozen=True)
class Recorded:
    """A recording and what lies behind it."""

    columns: dict[str, Array]  # "time" first; NaN is a missing cell
    truth: tuple[Planted, ...]
    real: Robot  # the machine as it was, deviations included
    true: dict[str, Array] = field(
        repr=False
    )  # q, dq, theta, dtheta, tau_t, tau (applied) (rows, n), no sensor
    run: Run = field(repr=False)

    def table(self) -> pa.Table:
        """The Arrow table: time as float64, channels as float32, missing cells as null."""
        return pa.table(
            {
                name: pa.array(
                    values, type=pa.float64() if name == "time" else pa.float32(), from_pandas=True
                )
                for name, values in self.columns.items()
            }
        )

    def write(self, path: Path) -> None:
        """Write .parquet or .csv, by the suffix."""
        if path.suffix == ".parquet":
            pa.parquet.write_table(self.table(), path)
        elif path.suffix == ".csv":
            pa.csv.write_csv(self.table(), path)
        else:
            raise ValueError(f"{path.name}: expected .parquet or .csv")


def plant(
    robot_yaml: Path,
    effects: list[Planted],
    excitation: str | Reference,
    seconds: float,
    seed: int,
    sensors: SensorSet,
    rate: float = 500,
    inexact: float = 0.0,
    plant_seed: int | None = None,
    real: Robot | None = None,
) -> Recorded:
    """Record `seconds` at `rate` [Hz] of the robot with its planted effects, along a kind of excitation or a
    given reference.

    `seed` draws the trajectory and the noise, `plant_seed` (default: seed) the deviations of the real
    machine, so that two recordings can share a machine; `real` is that machine itself, and `inexact` is then
    not asked. Raises ValueError on unknown names and on a rate
    above the control rate.
    """
    nominal = read_robot(robot_yaml)
    check(nominal, effects)
    if not 0 < rate <= nominal.control_rate:
        raise ValueError(
            f"rate must be above 0 and at most the control rate {nominal.control_rate}, got {rate}"
        )
    motion_seed, noise_seed, time_seed = np.random.SeedSequence(seed).spawn(3)
    machine_rng = np.random.default_rng([seed if plant_seed is None else plant_seed, 1])
    if real is None:
        real = deviating(nominal, inexact, machine_rng) if inexact > 0 else nominal

    told = _Told(nominal, excitation, seconds, np.random.default_rng(motion_seed))
    run = _closed_loop(nominal, real, effects, told, seconds, sensors, np.random.default_rng(noise_seed))
    return _record(run, effects, real, sensors, seconds, rate, np.random.default_rng(time_seed))


class _Told:
    """What the controller is told at every tick; arrays (ticks, n), tick 0 at -SETTLING."""

    def __init__(
        self, nominal: Robot, excitation: str | Reference, seconds: float, rng: np.random.Generator
    ) -> None:
        dynamics = nominal_dynamics(nominal)
        n = len(nominal.joints)

        def demand(q: Array, v: Array, a: Array) -> Array:
            motors = nominal.motor_inertia * a + nominal.motor_damping * v
            return (dynamics(q, v, a) + motors) / nominal.torque_limit

        follow = reference(excitation, n, seconds, demand, rng) if isinstance(excitation, str) else excitation
        before = round(SETTLING * nominal.control_rate)
        self.times = (
            np.arange(before + round(seconds * nominal.control_rate)) - before
        ) / nominal.control_rate
        self.first = before
        q_ref = follow(np.maximum(self.times, 0.0))
        rest = np.zeros_like(q_ref)
        self.tau_ff = dynamics(q_ref, rest, rest)
        self.q_ref, self.theta_ref = q_ref, q_ref + self.tau_ff / nominal.stiffness


def nominal_dynamics(robot: Robot) -> Callable[[Array, Array, Array], Array]:
    """Inverse dynamics of the links: positions, velocities, accelerations (m, n) to torques (m, n)."""
    q, v, a = (ca.SX.sym(name, len(robot.joints)) for name in "qva")
    bodies = list(robot.bodies)
    loads = [body_load(body) for body in bodies]
    function = ca.Function("f", [q, v, a], [inverse_dynamics(bodies, loads, ca.SX(robot.gravity), q, v, a)])
    return lambda q, v, a: np.array(function(q.T, v.T, a.T)).T


@dataclass(frozen=True)
class Run:
    """What went on, at the end of every control tick where it says `ticks`; tick 0 begins at -SETTLING."""

    told: _Told
    motion: Motion
    sensors: Sensors
    tau_m: Array  # (ticks, n)
    applied: Array  # (samples of motion, n) torque of the motor after the command effects
    states: Array  # (ticks, 5 n + m), the x of laws.Equations
    modes: Array  # (ticks, switches)
    torques: Array  # (ticks, n) what the drive gave
    machine: Machine


def _closed_loop(
    nominal: Robot,
    real: Robot,
    effects: list[Planted],
    told: _Told,
    seconds: float,
    sensors: SensorSet,
    rng: np.random.Generator,
) -> Run:
    n, ticks, period = len(nominal.joints), len(told.times), 1 / nominal.control_rate
    substeps = int(np.ceil(STEP_RATE * period - 1e-9))
    machine = Machine(real, effects, period / substeps, substeps)
    values = {channel: np.zeros((ticks * substeps + 1, n)) for channel in MEASURED}
    motion = Motion(told.times[0], period / substeps, values)
    reading = Sensors(nominal, effects, sensors, ticks, rng)
    drive = Drive(nominal, effects, told.tau_ff[0], ticks, substeps)
    tau_m, applied = np.zeros((ticks, n)), np.zeros((ticks * substeps + 1, n))
    after, modes = np.zeros((ticks, machine.x.size)), np.zeros((ticks, machine.modes.size))
    torques = np.zeros((ticks, n))

    machine.x[:n], machine.x[2 * n : 3 * n] = told.q_ref[0], told.theta_ref[0]
    steps = told.times[:, None] + np.arange(substeps) * machine.step  # (ticks, substeps) at their starts
    on = np.zeros((*steps.shape, len(effects)))
    for k, planted in enumerate(effects):
        on[:, :, k] = planted.acts(steps)
    least, most = -nominal.torque_limit, nominal.torque_limit
    for k in range(ticks):
        t, at, gates = told.times[k], k * substeps, on[k]
        if k == 0:
            machine.settle(told.tau_ff[0], gates[0], t)
            _fill(values, slice(0, 1), machine.x[None], machine.torque(told.tau_ff[0], gates[0], t)[None], n)
        theta, dtheta = (reading.feedback(channel, motion, t, k, at) for channel in ("theta", "dtheta"))
        wish = told.tau_ff[k] + nominal.kp * (told.theta_ref[k] - theta) - nominal.kd * dtheta
        tau_m[k] = np.minimum(np.maximum(wish, least), most)
        torque = drive.apply(k, t, tau_m[k])
        states, tau_t = machine.advance(torque, gates, t)
        after[k], modes[k], torques[k] = machine.x, machine.modes, torque[-1]
        _fill(values, slice(at + 1, at + 1 + substeps), states, tau_t, n)
        if drive.limits:
            speeds = values["dtheta"][at : at + substeps + 1]
            torque = drive.limited(steps[k], torque, (speeds[:-1] + speeds[1:]) / 2)
        applied[at : at + substeps] = torque
    applied[-1] = applied[-2]
    return Run(told, motion, reading, tau_m, applied, after, modes, torques, machine)


def _fill(values: dict[str, Array], rows: slice, states: Array, tau_t: Array, n: int) -> None:
    for i, channel in enumerate(("q", "dq", "theta", "dtheta")):
        values[channel][rows] = states[:, i * n : (i + 1) * n]
    values["tau_t"][rows] = tau_t


def _record(
    run: Run,
    effects: list[Planted],
    real: Robot,
    sensors: SensorSet,
    seconds: float,
    rate: float,
    rng: np.random.Generator,
) -> Recorded:
    told, joints = run.told, real.joints
    sampled = stamps = np.arange(round(seconds * rate)) / rate
    if (ragged := sensors.ragged) is not None:
        stamps = stamps + rng.uniform(0, ragged.jitter / rate, len(stamps))
        keep = rng.random(len(stamps)) >= ragged.lost_rows
        gap = rng.uniform(0.2, 0.8) * seconds
        keep &= (stamps < gap) | (stamps >= gap + ragged.gap)
        stamps = stamps[keep]
        sampled = stamps if ragged.sampled_late else sampled[keep]
    ticks = told.first + np.floor(sampled * real.control_rate + 1e-6).astype(int)

    measured = {c: run.sensors.read(c, run.motion, sampled, ticks) for c in MEASURED}
    held = {"tau_m": run.tau_m, **{c: getattr(told, c) for c in TOLD}}
    if CURRENT in sensors.channels:
        shown = _by_current(run, effects, sampled) + run.sensors.noise[CURRENT][ticks]
        measured[CURRENT] = run.sensors.changed(CURRENT, shown, sampled)
    columns = {"time": stamps}
    for channel in (*MEASURED, "tau_m", CURRENT, *TOLD):
        if channel in sensors.channels:
            rows = measured[channel] if channel in measured else held[channel][ticks]
            for j, joint in enumerate(joints):
                if channel in ON_SPRINGS and np.isinf(real.stiffness[j]):
                    continue
                columns[f"{channel}.{joint}"] = rows[:, j].copy()
    if ragged is not None:
        for name, values in columns.items():
            if name != "time":
                values[rng.random(len(values)) < ragged.lost_cells] = np.nan
    grid = np.repeat(sampled[:, None], len(joints), axis=1)
    true = {c: run.motion.at(c, grid) for c in MEASURED}
    true["tau"] = run.applied[np.round((sampled - run.motion.start) / run.motion.step).astype(int)]
    return Recorded(columns, tuple(effects), real, true, run)


def _by_current(run: Run, effects: list[Planted], times: Array) -> Array:
    """(m, n) motor torque as the nominal torque constant makes it of the current, its mean over one control
    period about each sample.

    Delay, lag, saturation, the limit that falls with the speed and what comes from a neighbour's command act
    on the current, so that it shows them; a wrong torque constant and a stray torque act behind it, and it
    does not.
    """
    robot, torque = run.sensors.robot, run.applied.copy()
    at = run.motion.start + run.motion.step * np.arange(len(torque))
    undone = {  # the last that acted is taken back first
        "torque_offset": lambda p, tau: tau - p.value("offset"),
        "torque_gain": lambda p, tau: tau / (1 + p.value("gain")),
    }
    for effect, undo in undone.items():
        for p in effects:
            if p.effect == effect:
                j = robot.index(p.joint)
                torque[:, j] = np.where(at >= p.start - 1e-9, undo(p, torque[:, j]), torque[:, j])
    impulse = np.vstack([np.zeros(torque.shape[1]), np.cumsum(torque[:-1], axis=0)]) * run.motion.step
    half = 0.5 / robot.control_rate
    ends = [np.array([np.interp(times + s * half, at, column) for column in impulse.T]).T for s in (1, -1)]
    return (ends[0] - ends[1]) * robot.control_rate
