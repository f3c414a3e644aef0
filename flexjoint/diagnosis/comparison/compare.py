"""Simulation against recording: abutting windows from the measured start state, RMS and NRMSE."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.core.errors import RecordingError
from flexjoint.core.files import check_suffix, write_json
from flexjoint.core.running.budget import UNLIMITED, Budget, checkpoint
from flexjoint.core.running.progress import Report, silent
from flexjoint.core.text import Block, Line, Table, as_html, plain
from flexjoint.diagnosis.comparison.estimate import Motion, StateEstimator
from flexjoint.diagnosis.result.wording import clean, number, unit_of
from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as tables
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import MEASURED, Recording
from flexjoint.robot import robot as robots
from flexjoint.robot.robot import Robot
from flexjoint.simulation import rollout as runs
from flexjoint.simulation.controllers import Law, law_of
from flexjoint.simulation.loop import Ticks
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.sensors import readings
from flexjoint.simulation.simulate import (
    REFERENCES,
    command_rate,
    references_at,
    torque_channel,
    torque_over,
)
from flexjoint.simulation.trajectory import Past, Trajectory

HORIZON = 0.5  # [s]
LONGEST_GAP = 5.0  # sampling periods over which a drive may be interpolated
WHOLE = 200_000  # rows, up to which a recording is looked at as one; a longer one in parts of ...
PART = 60_000  # ... so many, so that neither memory nor the time of a window grows with its length
RUN_IN = 10.0  # s before a part, from where on what remembers (hysteresis, creep) is followed


@dataclass(frozen=True)
class Comparison:
    """How far a model is from a recording.

    `rms` by "channel.joint" in the channel's unit, and `phi.<joint>` about its mean; `nrmse` is RMS over the
    standard deviation of the whole measured channel (left out where that is 0). `time` (N,) [s] and
    `simulated` (N,) by (channel, joint) on the recording's rows, NaN outside the windows.
    """

    rms: Mapping[str, float]
    nrmse: Mapping[str, float]
    horizon: float
    windows: int
    time: np.ndarray
    simulated: Mapping[tuple[str, str], np.ndarray]
    robot: str = ""  # names of the two
    recording: str = ""
    prismatic: frozenset[str] = frozenset()  # joints that slide: their channels are in m and N
    left_out: int = 0  # windows at the end that the time allowed was too short for

    def __str__(self) -> str:
        return plain(self.table())

    def _repr_html_(self) -> str:
        return as_html(self.table())

    def table(self) -> tuple[Block, ...]:
        """The errors per channel, the largest first, as blocks of text."""
        head = (
            f"{clean(self.robot)} against {clean(self.recording)}: {self.windows} windows of"
            f" {self.horizon:g} s, each from the measured state"
        )
        if self.left_out:
            head += f"; the time allowed was over before the other {self.left_out}"
        rows = []
        for name in sorted(self.rms, key=lambda key: -self.nrmse.get(key, 0.0)):
            channel, _, joint = name.partition(".")
            share = number(self.nrmse[name]) if name in self.nrmse else "not moving"
            error = f"{number(self.rms[name])} {unit_of(channel, joint in self.prismatic)}"
            rows.append((clean(name), error, share))
        heads = (("channel", False), ("RMS error", True), ("NRMSE", True))
        return Line(head, whole=True), Table(heads, tuple(rows))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the errors as JSON (docs/reference/formats.md), whole or not at all."""
        out = Path(path)
        check_suffix(out, (".json",))
        write_json(out, self.to_json())

    def to_json(self) -> dict[str, Any]:
        """The fixed JSON form of `flexjoint compare`."""
        return {
            "rms": dict(self.rms),
            "nrmse": dict(self.nrmse),
            "horizon": self.horizon,
            "windows": self.windows,
            **({"left_out": self.left_out} if self.left_out else {}),
        }


def compare(
    model: FlexibleJointModel | Robot,
    recording: Recording,
    *,
    horizon: float = HORIZON,
    closed_loop: bool = False,
    engine: Engine = "auto",
    progress: Report | None = None,
    budget: Budget = UNLIMITED,
) -> Comparison:
    """Simulate the recording in abutting windows of the horizon [s] and measure the error per channel.

    Each window starts from the measured state. It is driven by the recorded tau_m or tau_motor; through the
    robot's controller when both are absent, or `closed_loop`. A last partial window is dropped. From a
    gap of more than 5 sampling periods in the drive on, a window counts in no sum. engine: see
    `flexjoint.simulation.compiled.engine`; auto counts the steps of all windows.

    Args:
        model: a robot, with the effects that it lists, or a model.
        progress: called with a share in [0, 1] and what is being done.
        budget: after which no further window begins; `Comparison.left_out` says how many there would be.

    Raises RecordingError when the recording lacks what that needs or is shorter than one window,
    SimulationError when the simulation diverges.
    """
    if not isinstance(model, FlexibleJointModel):
        model = FlexibleJointModel(robots.expect(model, "compare"))
    recording = of_robot(model.robot, on_regular_clock(tables.expect(recording, "compare")))
    return compared(model, recording, horizon, closed_loop, engine, progress or silent, budget)


def compared(
    model: FlexibleJointModel,
    recording: Recording,
    horizon: float = HORIZON,
    closed_loop: bool = False,
    engine: Engine = "auto",
    report: Report = silent,
    budget: Budget = UNLIMITED,
    rollout: Callable[..., Trajectory] = runs.rollout,
) -> Comparison:
    """`compare`, of a recording that is on its regular clock already, as that of `Readings` is.

    rollout: what simulates under given torques, with the arguments of `flexjoint.simulation.rollout.rollout`.
    """
    windows = _windows(recording, horizon)
    starts = recording.time[0] + horizon * np.arange(windows)
    simulated = {
        key: np.full(len(recording.time), np.nan)
        for key in recording.columns
        if key[0] in MEASURED and key[1] in model.robot.joint_names
    }
    offsets: Mapping[str, float] | None = None
    done = 0
    for part, own in _parts(recording, starts, horizon):
        estimator = StateEstimator(part, model, begin=float(recording.time[0]), offsets=offsets)
        offsets = estimator.offsets
        driver = _Driver(part, model, estimator, horizon, windows, closed_loop, engine, rollout)
        motion = estimator.at(own)
        for k, start in enumerate(own):
            if done and budget.spent:
                break
            checkpoint()
            _simulate(driver, motion, k, start, recording, simulated)
            done += 1
            report(done / windows, f"window {done} of {windows}")
        if budget.spent:
            break
    rms, nrmse = _errors(recording, simulated)
    return Comparison(
        rms,
        nrmse,
        horizon,
        done,
        recording.time,
        simulated,
        robot=model.robot.name,
        recording=recording.name,
        prismatic=model.robot.prismatic,
        left_out=windows - done,
    )


def _windows(recording: Recording, horizon: float) -> int:
    """How many windows fit in."""
    period = recording.period
    if 0.0 < horizon < period:
        raise RecordingError(
            f"{recording.name}: a window of {horizon:g} s is shorter than its period, {period:.3g} s;"
            " give a horizon of several periods"
        )
    windows = int(np.floor((recording.duration + period) / horizon + 1e-6)) if horizon > 0 else 0
    if windows < 1:
        raise RecordingError(
            f"{recording.name}: a window of {horizon:g} s does not fit into {recording.duration:.3g} s;"
            " give a horizon > 0 and below the recording's length"
        )
    return windows


def _parts(
    recording: Recording, starts: np.ndarray, horizon: float
) -> Iterator[tuple[Recording, np.ndarray]]:
    """A long recording in parts, each with the starts of its own windows, and with what is needed around
    them. Where a channel has no samples in a part, its windows are left out, as those in a gap are."""
    time = recording.time
    if time.size <= WHOLE:
        yield recording, starts
        return
    for first in range(0, time.size, PART):
        end = time[first + PART] if first + PART < time.size else np.inf
        own = starts[(starts >= time[first]) & (starts < end)]
        if not own.size:
            continue
        rows = slice(*np.searchsorted(time, [own[0] - RUN_IN, own[-1] + horizon + RUN_IN]))
        columns = {key: values[rows] for key, values in recording.columns.items()}
        if all(tables.was_measured(values) for values in columns.values()):
            yield replace(recording, time=time[rows], columns=columns), own


def _simulate(
    driver: _Driver,
    motion: Motion,
    k: int,
    start: float,
    recording: Recording,
    simulated: Mapping[tuple[str, str], np.ndarray],
) -> None:
    """One window, from the k-th state of a motion, put into its rows of the simulated channels."""
    tape = driver.run(start, motion, k)
    until = driver.driven_until(start, start + driver.horizon)
    rows = slice(*np.searchsorted(recording.time, [start - 1e-9, until - 1e-9]))
    grid = tape.time[tape.first :] + driver.estimator.begin
    for (channel, joint), values in readings(driver.model, tape).items():
        if (channel, joint) in simulated:
            offset = driver.estimator.offsets.get(joint, 0.0) if channel == "theta" else 0.0
            simulated[channel, joint][rows] = np.interp(recording.time[rows], grid, values) + offset


class _Driver:
    """Runs one window: the torques or references of the recording, and what went before its start."""

    def __init__(
        self,
        recording: Recording,
        model: FlexibleJointModel,
        estimator: StateEstimator,
        horizon: float,
        windows: int,
        closed_loop: bool,
        engine: Engine,
        rollout: Callable[..., Trajectory],
    ) -> None:
        self.windows, self.horizon, self.rollout = windows, horizon, rollout
        self.recording, self.model, self.estimator = recording, model, estimator
        self.options = RunOptions(engine=engine)
        self.rate, self.control = model.robot.rates.physics, model.robot.rates.control
        self.commanded = command_rate(model.robot, recording)
        self.ticks = int(np.ceil(horizon * self.control - 1e-6))
        self.joints = model.robot.joint_names
        recorded = torque_channel(recording, self.joints)
        self.law: Law | None = law_of(model.robot) if closed_loop or recorded is None else None
        self.known = _driven(recording, REFERENCES if recorded is None or closed_loop else (recorded,))
        longest = longest_delay(model)
        self.before = int(np.ceil(longest * self.rate - 1e-9)) + 1 if longest > 0.0 else 0

    def driven_until(self, start: float, end: float) -> float:
        """Up to where the recording holds the drive without a long gap: the window's end as a rule."""
        longest = LONGEST_GAP * self.recording.period
        last = self.known[self.known <= start + longest]
        inside = self.known[(self.known > start) & (self.known < end)]
        path = np.concatenate([[last[-1] if last.size else -np.inf], inside, [end]])
        broken = np.flatnonzero(np.diff(path) > longest)
        if not broken.size:
            return end
        return float(max(start, path[broken[0]]))

    def run(self, start: float, motion: Motion, k: int) -> Trajectory:
        state = self.estimator.state(motion, k)
        steps = Ticks(self.rate, self.control).steps(self.ticks)
        if self.law is None:
            edges = start + np.arange(-self.before, steps + 1) / self.rate
            torque = torque_over(self.recording, self.joints, edges, self.commanded)
            past = self._past(start, torque[: self.before])
            return self.rollout(
                self.model,
                state,
                torque[self.before :],
                self.options,
                past=past,
                runs=self.windows,
            )
        table = references_at(self.model, self.recording, start + np.arange(self.ticks) / self.control)
        past = self._past(start, self._commanded(start, self.law)) if self.before else None
        return runs.closed_loop(
            self.model, state, self.law, table, self.options, past=past, runs=self.windows
        )

    def _past(self, start: float, torque: np.ndarray) -> Past | None:
        """The motion before a start as measured; before the recording its first state holds."""
        if not self.before:
            return None
        time = start + np.arange(-self.before, 0) / self.rate
        motion = self.estimator.at(np.maximum(time, self.recording.time[0]))
        return Past(torque, motion.q, motion.v, motion.theta, motion.dtheta)

    def _commanded(self, start: float, law: Law) -> np.ndarray:
        """(H, n) what the controller commanded before a start, from the measured motion."""
        time = start + np.arange(-self.before, 0) / self.rate
        time = np.maximum(time, self.recording.time[0])
        table = references_at(self.model, self.recording, time)
        seen = self.estimator.at(time)
        torque = np.empty((len(time), len(self.joints)))
        for row in range(len(time)):
            state = self.estimator.state(seen, row)
            reading = {name: np.empty(len(self.joints)) for name in law.reads}
            for i in range(len(self.joints)):
                s = self.model.signals(state, i, 0.0)
                for name in law.reads:
                    reading[name][i] = self.model.flows[i].read(name, s, getattr(s, name))
            torque[row] = law.torque({name: values[row] for name, values in table.items()}, reading)
        return torque


def _driven(recording: Recording, channels: tuple[str, ...]) -> np.ndarray:
    """Times at which the recording holds the drive's channels of all joints."""
    columns = [values for (channel, _), values in recording.columns.items() if channel in channels]
    return recording.time[np.all(np.isfinite(columns), axis=0)]


def _errors(
    recording: Recording, simulated: Mapping[tuple[str, str], np.ndarray]
) -> tuple[dict[str, float], dict[str, float]]:
    rms: dict[str, float] = {}
    nrmse: dict[str, float] = {}
    for name, measured, values in _pairs(recording, simulated):
        error = values - measured
        error = error[np.isfinite(error)]
        if not error.size:
            continue
        rms[name] = float(np.sqrt(np.mean(error**2)))
        spread = float(np.nanstd(measured))
        if spread > 0.0:
            nrmse[name] = rms[name] / spread
    return rms, nrmse


def _pairs(
    recording: Recording, simulated: Mapping[tuple[str, str], np.ndarray]
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, measured and simulated samples of what is compared, one after the other."""
    for (channel, joint), values in simulated.items():
        yield f"{channel}.{joint}", recording.get(channel, joint), values
    for joint in dict.fromkeys(joint for _, joint in simulated):
        if ("q", joint) in simulated and ("theta", joint) in simulated:
            measured = recording.get("theta", joint) - recording.get("q", joint)
            phi = simulated["theta", joint] - simulated["q", joint]
            both = np.isfinite(phi) & np.isfinite(measured)
            yield f"phi.{joint}", measured - np.mean(measured[both]), phi - np.mean(phi[both])
