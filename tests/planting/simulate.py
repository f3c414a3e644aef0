"""Recordings of a real machine under its controller, in the table of the file format.

plant() puts effects into a machine, drives it along an excitation and returns what its sensors and its
controller would have written down. See laws.py for the laws, machine.py for the time stepping, sensing.py for
the sensors.
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

from .catalogue import Planted, check, neighbour
from .chain import Array, body_load, inverse_dynamics
from .excitation import Reference, reference
from .machine import Machine
from .robots import Robot, deviating, read_robot
from .sensing import CURRENT, MEASURED, TOLD, Motion, Sensors, SensorSet

STEP_RATE = 5000.0  # Hz, at least; events are located, so a finer step changes nothing above 1e-7 rad
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
) -> Recorded:
    """Record `seconds` at `rate` [Hz] of the robot with its planted effects, along a kind of excitation or a
    given reference.

    `seed` draws the trajectory and the noise, `plant_seed` (default: seed) the deviations of the real
    machine, so that two recordings can share a machine. Raises ValueError on unknown names and on a rate
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
class _Run:
    told: _Told
    motion: Motion
    sensors: Sensors
    tau_m: Array  # (ticks, n)
    applied: Array  # (samples of motion, n) torque of the motor after the command effects


def _closed_loop(
    nominal: Robot,
    real: Robot,
    effects: list[Planted],
    told: _Told,
    seconds: float,
    sensors: SensorSet,
    rng: np.random.Generator,
) -> _Run:
    n, ticks, period = len(nominal.joints), len(told.times), 1 / nominal.control_rate
    substeps = int(np.ceil(STEP_RATE * period - 1e-9))
    machine = Machine(real, effects, period / substeps, substeps)
    values = {channel: np.zeros((ticks * substeps + 1, n)) for channel in MEASURED}
    motion = Motion(told.times[0], period / substeps, values)
    reading = Sensors(nominal, effects, sensors, ticks, rng)
    gate_since = np.array([p.start for p in effects])
    drive = _Drive(nominal, effects, told.tau_ff[0], ticks, substeps)
    tau_m, applied = np.zeros((ticks, n)), np.zeros((ticks * substeps + 1, n))

    machine.x[:n], machine.x[2 * n : 3 * n] = told.q_ref[0], told.theta_ref[0]
    offsets = np.arange(substeps) * machine.step
    for k in range(ticks):
        t, at = told.times[k], k * substeps
        gates = ((t + offsets)[:, None] >= gate_since - 1e-9).astype(float)
        if k == 0:
            machine.settle(told.tau_ff[0], gates[0], t)
            _fill(values, slice(0, 1), machine.x[None], machine.torque(told.tau_ff[0], gates[0], t)[None], n)
        theta, dtheta = (reading.feedback(channel, motion, t, k) for channel in ("theta", "dtheta"))
        wish = told.tau_ff[k] + nominal.kp * (told.theta_ref[k] - theta) - nominal.kd * dtheta
        tau_m[k] = np.clip(wish, -nominal.torque_limit, nominal.torque_limit)
        torque = drive.apply(k, t, tau_m[k])
        states, tau_t = machine.advance(torque, gates, t)
        _fill(values, slice(at + 1, at + 1 + substeps), states, tau_t, n)
        speeds = values["dtheta"][at : at + substeps + 1]
        applied[at : at + substeps] = drive.limited(t + offsets, torque, (speeds[:-1] + speeds[1:]) / 2)
    applied[-1] = applied[-2]
    return _Run(told, motion, reading, tau_m, applied)


def _fill(values: dict[str, Array], rows: slice, states: Array, tau_t: Array, n: int) -> None:
    for i, channel in enumerate(("q", "dq", "theta", "dtheta")):
        values[channel][rows] = states[:, i * n : (i + 1) * n]
    values["tau_t"][rows] = tau_t


class _Drive:
    """From commands to motor torques: gain, offset, saturation of the held command and a neighbour's share of
    it, then its delay, then the lag."""

    def __init__(
        self, robot: Robot, effects: list[Planted], initial: Array, ticks: int, substeps: int
    ) -> None:
        self.robot, self.initial, self.substeps = robot, initial, substeps
        on_held = ("torque_gain", "torque_offset", "torque_saturation", "joint_coupling")
        self.on_held = [p for name in on_held for p in effects if p.effect == name]
        self.delays, self.lags, self.limits = (
            [p for p in effects if p.effect == name]
            for name in ("torque_delay", "current_lag", "torque_speed_limit")
        )
        self.held = np.zeros((ticks, len(initial)))
        self.last: Array | None = None  # torque at the end of the substep before, as far as lags follow it

    def apply(self, tick: int, t: float, command: Array) -> Array:
        """Torques (substeps, n) during the tick: the mean over each substep of the delayed, held torque, as
        the lag follows it."""
        held = command.copy()
        for p in self.on_held:
            if t >= p.start - 1e-9:
                j = self.robot.index(p.joint)
                if p.effect == "torque_gain":
                    held[j] *= 1 + p.value("gain")
                elif p.effect == "torque_offset":
                    held[j] += p.value("offset")
                elif p.effect == "torque_saturation":
                    held[j] = np.clip(held[j], -p.value("limit"), p.value("limit"))
                else:
                    held[j] += p.value("share") * command[neighbour(self.robot, p)]
        self.held[tick] = held
        torque = np.repeat(held[None], self.substeps, axis=0)
        for p in self.delays:
            if t >= p.start - 1e-9:
                joints = range(len(held)) if p.joint is None else [self.robot.index(p.joint)]
                for j in joints:
                    torque[:, j] = self._delayed(tick, p.value("delay") * self.robot.control_rate, j)
        asked = torque.copy()
        now = asked[0] if self.last is None else self.last  # settled at the start
        self.last = asked[-1].copy()
        for p in self.lags:
            if t >= p.start - 1e-9:
                j = self.robot.index(p.joint)
                torque[:, j], self.last[j] = self._lagging(asked[:, j], now[j], p.value("time_constant"))
        return torque

    def limited(self, times: Array, torque: Array, speed: Array) -> Array:
        """Torques (m, n) of substeps that begin at `times` (m,), as the limit that falls with the mean speed
        (m, n) leaves them. The motion itself feels it at every instant, in laws.py."""
        torque = torque.copy()
        for p in self.limits:
            j = self.robot.index(p.joint)
            stall, drop = p.value("stall"), p.value("drop") * speed[:, j]
            clipped = np.clip(torque[:, j], -stall - drop, stall - drop)
            torque[:, j] = np.where(times >= p.start - 1e-9, clipped, torque[:, j])
        return torque

    def _lagging(self, asked: Array, now: float, time_constant: float) -> tuple[Array, float]:
        """Means over the substeps of the torque that follows what is asked, and where it ends; exact for a
        torque that is constant over a substep."""
        share = 1 / (self.robot.control_rate * self.substeps * time_constant)  # of a time constant
        mean = np.empty(len(asked))
        for i, goal in enumerate(asked):
            mean[i] = goal - (now - goal) * np.expm1(-share) / share
            now = goal + (now - goal) * np.exp(-share)
        return mean, now

    def _delayed(self, tick: int, delay: float, j: int) -> Array:
        """Mean over each substep of the held torque `delay` ticks earlier."""
        edges = tick + np.arange(self.substeps + 1) / self.substeps - delay
        first = np.floor(edges[:-1] + 1e-9).astype(int)
        last = np.maximum(np.ceil(edges[1:] - 1e-9).astype(int) - 1, first)
        late = np.clip((edges[1:] - last) * self.substeps, 0.0, 1.0)  # share of the substep after the switch
        late = np.where(last > first, late, 1.0)
        return late * self._past(last, j) + (1 - late) * self._past(first, j)

    def _past(self, ticks: Array, j: int) -> Array:
        return np.where(ticks < 0, self.initial[j], self.held[np.maximum(ticks, 0), j])


def _record(
    run: _Run,
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
        measured[CURRENT] = _by_current(run, effects, sampled) + run.sensors.noise[CURRENT][ticks]
    columns = {"time": stamps}
    for channel in (*MEASURED, "tau_m", CURRENT, *TOLD):
        if channel in sensors.channels:
            rows = measured[channel] if channel in measured else held[channel][ticks]
            for j, joint in enumerate(joints):
                columns[f"{channel}.{joint}"] = rows[:, j].copy()
    if ragged is not None:
        for name, values in columns.items():
            if name != "time":
                values[rng.random(len(values)) < ragged.lost_cells] = np.nan
    grid = np.repeat(sampled[:, None], len(joints), axis=1)
    true = {c: run.motion.at(c, grid) for c in MEASURED}
    true["tau"] = run.applied[np.round((sampled - run.motion.start) / run.motion.step).astype(int)]
    return Recorded(columns, tuple(effects), real, true)


def _by_current(run: _Run, effects: list[Planted], times: Array) -> Array:
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
