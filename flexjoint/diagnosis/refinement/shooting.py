"""A recording cut into short windows, each simulated from its own start state (multiple shooting; Bock 1983),
and what the readings say about the numbers common to all windows.

A window's start is unknown: its measured value begins the search, and it is eliminated window by window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.comparison.estimate import StateEstimator
from flexjoint.diagnosis.refinement.open_numbers import open_numbers
from flexjoint.diagnosis.refinement.sensitivities import (
    Delays,
    Directions,
    Inputs,
    StepDerivatives,
    link_load,
)
from flexjoint.diagnosis.regression.fit import Slot
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import labels
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.simulate import torque_over

CHANNELS = ("q", "theta", "tau_t")  # the balances' sensors
SIDE_BY_SIDE = 24  # windows that are simulated at once, at most: more need memory, fewer time
SIDE_MEMORY = 4e7  # bytes of derivatives that they may have together
ALL_MEASURED = 0.99  # of an interpolated flag: 1 where both neighbours were, rounding aside
ROUNDING = 1e-6  # steps
PASSES = 3  # linearisations to be expected
MOST_WORK = 1e7  # entries of sensitivities times steps: ten seconds; windows are left out beyond it


@dataclass(frozen=True)
class Window:
    """One window: its start [s] on the recording's clock, rows of the recording in it, its phase."""

    start: float
    rows: slice
    phase: int


@dataclass(frozen=True)
class _Part:
    """Windows (by number, all of one phase) that are simulated side by side, and where they are linearised:
    slots (k,), deviations (d,), their starts (rows, nx), by steps so many times as long."""

    rows: tuple[int, ...]
    slots: np.ndarray
    deviations: np.ndarray
    starts: np.ndarray
    coarse: int


@dataclass(frozen=True)
class Reduced:
    """A window's squared error as a parabola of the common numbers g, its start eliminated:
    energy + 2 slope g + g curvature g; the start moves by start + start_by g meanwhile."""

    energy: float
    slope: np.ndarray
    curvature: np.ndarray
    start: np.ndarray
    start_by: np.ndarray
    samples: int


class Shooting:
    """Windows of a problem's recording against a set of effects.

    Args:
        seconds: length of a window.
        disturbed: whether the noise of the motor torques counts, which moves the motors within a window.
        slots: the free numbers of the effects.
        workers: processes that share the windows; the bits are the same for any number.
    """

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Planned],
        slots: Sequence[Slot],
        seconds: float,
        disturbed: bool = False,
        workers: int = 1,
    ) -> None:
        self.problem, self.seconds, self.workers = problem, seconds, workers
        robot, recording = problem.robot, problem.readings.recording
        self.recording = recording
        self.begin = float(recording.time[0])
        self.rate = physics_rate(robot)
        self.steps = 2 * max(1, round(0.5 * seconds * self.rate))  # even: see `coarse`
        free_offsets = _offsets(robot, effects)
        at_work = [*problem.with_nominal(effects), *free_offsets]
        self.model = FlexibleJointModel(robot, at_work)
        self.estimator = StateEstimator(recording, self.model)
        self.phases = [time for time, _ in self.model.phases]
        self.windows = self._windows()
        loads = [link_load(joint.name) for joint in robot.joints]
        self._symbolic = [
            SymbolicModel(robot, [*at_work, *loads], free=("drives",), at=max(time, -1.0))
            for time in self.phases
        ]
        self.parameters = self._symbolic[0].parameters
        self.nominal = open_numbers(robot, problem, free_offsets)
        block = problem.settings.refinement.torque_block
        self.blocks = max(1, round(seconds / block)) if disturbed else 0
        self.own = self.model.nx + len(robot.joints) * self.blocks  # unknowns of a window
        columns = self.own + len(slots) + len(self.nominal)
        work = len(self.windows) * self.steps * columns * 1.5 * self.model.nx
        every = max(1, int(np.ceil(work / MOST_WORK)))
        self.windows = self.windows[::every]
        self.slot_labels = [slot_label(effects, slot) for slot in slots]
        self._values = self._symbolic[0].values.copy()
        for joint, offset in self.estimator.offsets.items():
            self._values[self.parameters.index(f"motor_encoder_offset.{joint}.offset")] = offset
        named = {number.name for number in self.nominal if not number.direction}
        self.varied = list(dict.fromkeys([*self.slot_labels, *sorted(named)]))
        self.keys = [
            (channel, joint.name)
            for joint in robot.joints
            for channel in CHANNELS
            if recording.has(channel, joint.name) and not (joint.rigid and channel == "tau_t")
        ]
        self.noise = np.array([self._noise(*key) for key in self.keys])
        self._measured = np.stack([recording.get(*key) for key in self.keys], axis=1)
        expected = PASSES * len(self.windows) * self.steps
        names = [".".join(key) for key in self.keys]
        used = {window.phase for window in self.windows}
        self._derivatives = {
            k: StepDerivatives(self._symbolic[k], self.varied, names, expected) for k in used
        }
        self._delays = Delays(self._symbolic[0], self.keys, self.varied)
        self.starts, self.spread = self._measured_starts()

    # --- windows -----------------------------------------------------------------------------------
    def _windows(self) -> list[Window]:
        """Abutting windows on samples whose surroundings were measured, each within one phase."""
        readings, time = self.problem.readings, self.recording.time
        good = np.interp(time, readings.time, readings.valid.astype(float)) > ALL_MEASURED
        length, out, k = self.steps / self.rate, [], 0
        while k < len(time):
            end = int(np.searchsorted(time, time[k] + length + 1e-9))
            if end >= len(time):
                break
            bad = np.flatnonzero(~good[k : end + 1])
            if bad.size:
                k += int(bad[-1]) + 1
                continue
            since = np.searchsorted(self.phases, [time[k] - self.begin, time[end] - self.begin], "right") - 1
            if since[0] == since[1]:
                out.append(Window(float(time[k]), slice(k, end), int(since[0])))
            k = end
        return out

    def _measured_starts(self) -> tuple[np.ndarray, np.ndarray]:
        """(windows, nx) the measured states at the windows' starts, and (nx,) their prior deviations, which
        are nearly flat: the samples from which the state was estimated must not count twice."""
        limits = self.problem.settings.refinement
        model, noise = self.model, self.problem.readings.noise
        length = self.steps / self.rate
        motion = self.estimator.at(np.array([w.start for w in self.windows]))
        rows = [self.estimator.state(motion, k) for k in range(len(self.windows))]
        place = limits.flat_prior * np.maximum(np.maximum(noise["q"], noise["theta"]), 1e-7)
        q, v = np.full(model.nq, np.min(place)), np.full(model.nv, np.min(place) / length)
        for i, joint in enumerate(model.joints):
            q[joint.idx_q], v[joint.idx_v] = place[i], place[i] / length
        moving = place[list(model.flexible)]
        z = limits.state_prior * np.ptp(motion.z, axis=0) + 1e-9
        starts = np.array([model.pack(row) for row in rows])
        return starts, np.concatenate([q, v, moving, moving / length, z])

    def _noise(self, channel: str, joint: str) -> float:
        i = self.problem.robot.joint_names.index(joint)
        spread = float(np.nanstd(self.recording.get(channel, joint)))
        return max(float(self.problem.readings.noise[channel][i]), 1e-7 * spread, 1e-12)

    # --- numbers -----------------------------------------------------------------------------------
    def numbers(self, slots: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """(np,) parameters for slot values and deviations of the nominal numbers."""
        out = self._values.copy()
        for label, value in zip(self.slot_labels, slots, strict=True):
            out[self.parameters.index(label)] = value
        for number, deviation in zip(self.nominal, deviations, strict=True):
            if not number.direction:
                out[self.parameters.index(number.name)] += deviation * number.std
        return out

    # --- linearisation -----------------------------------------------------------------------------
    def linearise(
        self, slots: np.ndarray, deviations: np.ndarray, starts: np.ndarray, coarse: int = 1
    ) -> list[Reduced]:
        """Every window about these slot values (k,), deviations (d,) and starts (windows, nx); the common
        numbers are the slots, then the deviations. `coarse` 2 takes steps twice as long."""
        columns = self.own + len(self.slot_labels) + len(self.nominal)
        most = int(SIDE_MEMORY / (8.0 * (self.steps // coarse + 1) * len(self.keys) * columns))
        parts = [
            _Part(tuple(rows), slots, deviations, starts[rows], coarse)
            for phase in self._derivatives
            for rows in self._side_by_side(phase, min(SIDE_BY_SIDE, max(1, most)))
        ]
        with worker_pool([self], min(self.workers, len(parts))) as processes:
            found = processes.map(self._linearised, parts)
        out: dict[int, Reduced] = {}
        for part, reduced in zip(parts, found, strict=True):
            out.update(zip(part.rows, reduced, strict=True))
        return [out[k] for k in sorted(out)]

    def _side_by_side(self, phase: int, most: int) -> list[list[int]]:
        """The windows of a phase, in equal parts of at most so many: an even number, for two cores."""
        rows = [k for k, window in enumerate(self.windows) if window.phase == phase]
        parts = min(len(rows), 2 * int(np.ceil(0.5 * len(rows) / most)))
        return [list(map(int, part)) for part in np.array_split(rows, parts)]

    def _linearised(self, part: _Part) -> list[Reduced]:
        rate, steps = self.rate / part.coarse, self.steps // part.coarse
        numbers = self.numbers(part.slots, part.deviations)
        derivatives = self._derivatives[self.windows[part.rows[0]].phase]
        inputs, directions = self._inputs(part.rows, numbers, part.deviations, part.starts, steps)
        out = []
        # a window that swings up leaves the finite numbers, for which an estimate is refused
        with np.errstate(over="ignore", invalid="ignore"):
            run = derivatives.run(inputs, numbers, directions, rate)
            for place, k in enumerate(part.rows):
                prior = (part.starts[place] - self.starts[k]) / self.spread
                out.append(self._reduced(k, run.readings[place], run.by[place], numbers, prior, rate))
        return out

    def _inputs(
        self,
        part: Sequence[int],
        numbers: np.ndarray,
        deviations: np.ndarray,
        starts: np.ndarray,
        steps: int,
    ) -> tuple[Inputs, Directions]:
        robot, nx, n = self.problem.robot, self.model.nx, len(self.model.joints)
        begins = np.array([self.windows[k].start for k in part])
        late, late_by = self._delays.command(numbers)
        edges = np.linspace(0.0, self.steps / self.rate, steps + 1)
        torque = np.zeros((len(part), steps, n))
        own, columns = self.own, self.own + len(self.slot_labels) + len(self.nominal)
        by_torque = None
        if np.any(late_by) or self.blocks:
            by_torque = np.zeros((len(part), steps, n, columns))
            by_torque[..., nx:own] = self._disturbances(steps)
        h = 0.5 / self.rate
        for i, joint in enumerate(robot.joint_names):
            for place, begin in enumerate(begins):
                at = begin + edges - late[i]
                torque[place, :, i] = self._torque(joint, at)
                if by_torque is not None and np.any(late_by[i]):
                    slope = (self._torque(joint, at - h) - self._torque(joint, at + h)) / (2.0 * h)
                    slots = late_by[i] @ self._by_parameters()
                    by_torque[place, :, i, own:] = slope[:, None] * slots
        load = self._loads(begins[:, None] + 0.5 * (edges[:-1] + edges[1:]), deviations)
        start = np.concatenate([np.diag(self.spread), np.zeros((nx, columns - nx))], axis=1)
        by_parameters = np.concatenate([np.zeros((len(self.varied), own)), self._by_parameters()], axis=1)
        inertial = np.zeros((10 * n, columns))
        for column, number in enumerate(self.nominal, start=own + len(self.slot_labels)):
            if number.direction:
                inertial[:, column] = number.direction
        inputs = Inputs(starts, begins - self.begin, torque, load)
        by_inertial = inertial if np.any(inertial) else None
        return inputs, Directions(start, by_parameters, by_torque, by_inertial)

    def _disturbances(self, steps: int) -> np.ndarray:
        """(steps, n, n blocks) one deviation of the mean motor torque over each block of a window, as the
        predicted noise of its samples has it."""
        n, readings = len(self.model.joints), self.problem.readings
        block = np.arange(steps) * self.blocks // steps
        length = self.problem.settings.refinement.torque_block
        deviation = readings.noise["torque"] * np.sqrt(min(1.0, readings.period / length))
        out = np.zeros((steps, n, n * self.blocks))
        for i in range(n if self.blocks else 0):
            out[np.arange(steps), i, i * self.blocks + block] = deviation[i]
        return out

    def _torque(self, joint: str, edges: np.ndarray) -> np.ndarray:
        control = self.problem.robot.rates.control
        return torque_over(self.recording, (joint,), edges, control)[:, 0]

    def _by_parameters(self) -> np.ndarray:
        """(varied, common numbers)."""
        out = np.zeros((len(self.varied), len(self.slot_labels) + len(self.nominal)))
        for k, label in enumerate(self.slot_labels):
            out[self.varied.index(label), k] = 1.0
        for k, number in enumerate(self.nominal, start=len(self.slot_labels)):
            if not number.direction:
                out[self.varied.index(number.name), k] = number.std
        return out

    def _loads(self, middle: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """(W, J, n) other inertial parameters as torques on the links at times (W, J), along the denoised
        motion: with the readings' noise in them they would draw the fit (errors in variables)."""
        n = len(self.model.joints)
        change = np.zeros(10 * n)
        for number, deviation in zip(self.nominal, deviations, strict=True):
            if number.direction:
                change += deviation * np.array(number.direction)
        if not np.any(change):
            return np.zeros((*middle.shape, n))
        readings, denoised = self.problem.readings, self.problem.balances.denoised.motion
        rows = np.round((middle - readings.time[0]) / readings.period).astype(int)
        torque = sum(denoised.rigid.regressor.torque(i, change[10 * i : 10 * i + 10]) for i in range(n))
        return -np.asarray(torque).T[np.clip(rows, 0, len(readings.time) - 1)]

    def _reduced(
        self,
        k: int,
        readings: np.ndarray,
        by: np.ndarray,
        numbers: np.ndarray,
        prior: np.ndarray,
        rate: float,
    ) -> Reduced:
        window, own = self.windows[k], self.own
        late, late_by = self._delays.readings(numbers)
        time = (self.recording.time[window.rows] - window.start)[:, None]
        place = (time - late[None]) * rate  # (samples, m)
        low = np.clip(np.floor(place + ROUNDING).astype(int), 0, len(readings) - 2)
        share = place - low
        channel = np.arange(len(self.keys))[None]
        y0, y1 = readings[low, channel], readings[low + 1, channel]
        measured = self._measured[window.rows]
        known = np.isfinite(measured) & (place >= -ROUNDING)
        weight = known / self.noise
        rest = np.where(known, y0 + share * (y1 - y0) - measured, 0.0) * weight
        gradient = by[low, channel] * (1.0 - share)[..., None] + by[low + 1, channel] * share[..., None]
        if np.any(late_by):
            common = late_by @ self._by_parameters()  # (m, common)
            gradient[:, :, own:] -= ((y1 - y0) * rate)[..., None] * common[None]
        gradient = (gradient * weight[..., None]).reshape(-1, gradient.shape[2])
        r = rest.ravel()
        mine, common = gradient[:, :own], gradient[:, own:]
        inner = np.linalg.inv(mine.T @ mine + np.eye(own))
        prior = np.concatenate([prior, np.zeros(own - len(prior))])
        cross, pull = mine.T @ common, mine.T @ r + prior
        start, start_by = -inner @ pull, -inner @ cross
        return Reduced(
            float(r @ r + prior @ prior + pull @ start),
            common.T @ r + cross.T @ start,
            common.T @ common + cross.T @ start_by,
            start[: self.model.nx] * self.spread,
            start_by[: self.model.nx] * self.spread[:, None],
            int(np.sum(known)),
        )


def slot_label(effects: Sequence[Planned], slot: Slot) -> str:
    """The name effect.joint.parameter of a free number."""
    return labels(effects[slot.effect], slot.param.name, slot.param.size)[slot.component]


def _offsets(robot: Robot, effects: Sequence[Planned]) -> list[Planned]:
    """Encoder offsets that are free in each recording, as effects of the model."""
    if robot.file.offsets != "per_recording":
        return []
    taken = {e.key for e in (*robot.effects, *effects)}
    names = ("link_encoder_offset", "motor_encoder_offset")
    wanted = [(name, j.name) for j in robot.joints for name in names[j.rigid :]]
    return [effect(name, joint, offset=0.0) for name, joint in wanted if (name, joint) not in taken]
