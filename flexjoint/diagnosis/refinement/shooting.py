"""A recording cut into short windows, each simulated from its own start state (multiple shooting; Bock 1983),
and what the readings say about the numbers common to all windows.

A window's start is unknown: its measured value begins the search, and it is eliminated window by window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.refinement.open_model import OpenModel
from flexjoint.diagnosis.refinement.sensitivities import Directions, Inputs
from flexjoint.simulation.simulate import torque_over

SIDE_BY_SIDE = 24  # windows that are simulated at once, at most: more need memory, fewer time
SIDE_MEMORY = 4e7  # bytes of derivatives that they may have together
ALL_MEASURED = 0.99  # of an interpolated flag: 1 where both neighbours were, rounding aside
ROUNDING = 1e-6  # steps


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
    """Windows of a recording against the model of a set of effects.

    Args:
        opened: the model with its free numbers.
        seconds: length of a window.
        disturbed: whether the noise of the motor torques counts, which moves the motors within a window.
        workers: processes that share the windows; the bits are the same for any number.
    """

    def __init__(self, opened: OpenModel, seconds: float, disturbed: bool = False, workers: int = 1) -> None:
        self.opened, self.seconds, self.workers = opened, seconds, workers
        self.problem, self.model, self.nominal = opened.problem, opened.model, opened.nominal
        self.recording = self.problem.readings.recording
        self.begin = float(self.recording.time[0])
        self.steps = 2 * max(1, round(0.5 * seconds * opened.rate))  # even: see `coarse`
        self.windows = self._windows()
        block = self.problem.settings.refinement.torque_block
        self.blocks = max(1, round(seconds / block)) if disturbed else 0
        self.own = self.model.nx + len(self.problem.robot.joints) * self.blocks  # unknowns of a window
        self.columns = self.own + opened.common
        self.windows = self._affordable()
        self.phases = list(dict.fromkeys(window.phase for window in self.windows))
        self.starts, self.spread = self._measured_starts()

    # --- windows -----------------------------------------------------------------------------------
    def _windows(self) -> list[Window]:
        """Abutting windows on samples whose surroundings were measured, each within one phase."""
        readings, time = self.problem.readings, self.recording.time
        good = np.interp(time, readings.time, readings.valid.astype(float)) > ALL_MEASURED
        length, out, k = self.steps / self.opened.rate, [], 0
        while k < len(time):
            end = int(np.searchsorted(time, time[k] + length + 1e-9))
            if end >= len(time):
                break
            bad = np.flatnonzero(~good[k : end + 1])
            if bad.size:
                k += int(bad[-1]) + 1
                continue
            since = (
                np.searchsorted(self.opened.phases, [time[k] - self.begin, time[end] - self.begin], "right")
                - 1
            )
            if since[0] == since[1]:
                out.append(Window(float(time[k]), slice(k, end), int(since[0])))
            k = end
        return out

    def _affordable(self) -> list[Window]:
        """Those that may be linearised in the share of the recording's time that one linearisation may
        take, evenly over the recording."""
        share = self.problem.settings.refinement.linearisation
        allowed = share * float(np.ptp(self.recording.time))
        cost = {k: self.opened.derivatives(k).cost(self.columns) for k in {w.phase for w in self.windows}}
        needed = self.steps * sum(cost[window.phase] for window in self.windows)
        return self.windows[:: max(1, int(np.ceil(needed / allowed)))]

    def _measured_starts(self) -> tuple[np.ndarray, np.ndarray]:
        """(windows, nx) the measured states at the windows' starts, and (nx,) their prior deviations, which
        are nearly flat: the samples from which the state was estimated must not count twice."""
        limits = self.problem.settings.refinement
        model, noise = self.model, self.problem.readings.noise
        length = self.steps / self.opened.rate
        motion = self.opened.estimator.at(np.array([w.start for w in self.windows]))
        rows = [self.opened.estimator.state(motion, k) for k in range(len(self.windows))]
        place = limits.flat_prior * np.maximum(np.maximum(noise["q"], noise["theta"]), 1e-7)
        q, v = np.full(model.nq, np.min(place)), np.full(model.nv, np.min(place) / length)
        for i, joint in enumerate(model.joints):
            q[joint.idx_q], v[joint.idx_v] = place[i], place[i] / length
        moving = place[list(model.flexible)]
        z = limits.state_prior * np.ptp(motion.z, axis=0) + 1e-9
        starts = np.array([model.pack(row) for row in rows])
        return starts, np.concatenate([q, v, moving, moving / length, z])

    # --- linearisation -----------------------------------------------------------------------------
    def linearise(
        self, slots: np.ndarray, deviations: np.ndarray, starts: np.ndarray, coarse: int = 1
    ) -> list[Reduced]:
        """Every window about these slot values (k,), deviations (d,) and starts (windows, nx); the common
        numbers are the slots, then the deviations. `coarse` 2 takes steps twice as long."""
        each = 8.0 * (self.steps // coarse + 1) * len(self.opened.keys) * self.columns  # bytes
        most = int(SIDE_MEMORY / each)
        parts = [
            _Part(tuple(rows), slots, deviations, starts[rows], coarse)
            for phase in self.phases
            for rows in self._side_by_side(phase, min(SIDE_BY_SIDE, max(1, most)))
        ]
        for phase in self.phases:
            self.opened.derivatives(phase)  # before the processes part
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
        rate, steps = self.opened.rate / part.coarse, self.steps // part.coarse
        numbers = self.opened.numbers(part.slots, part.deviations)
        derivatives = self.opened.derivatives(self.windows[part.rows[0]].phase)
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
        late, late_by = self.opened.delays.command(numbers)
        edges = np.linspace(0.0, self.steps / self.opened.rate, steps + 1)
        torque = np.zeros((len(part), steps, n))
        own, columns = self.own, self.columns
        by_torque = None
        if np.any(late_by) or self.blocks:
            by_torque = np.zeros((len(part), steps, n, columns))
            by_torque[..., nx:own] = self._disturbances(steps)
        h = 0.5 / self.opened.rate
        for i, joint in enumerate(robot.joint_names):
            for place, begin in enumerate(begins):
                at = begin + edges - late[i]
                torque[place, :, i] = self._torque(joint, at)
                if by_torque is not None and np.any(late_by[i]):
                    slope = (self._torque(joint, at - h) - self._torque(joint, at + h)) / (2.0 * h)
                    slots = late_by[i] @ self.opened.by_common
                    by_torque[place, :, i, own:] = slope[:, None] * slots
        load = self._loads(begins[:, None] + 0.5 * (edges[:-1] + edges[1:]), deviations)
        start = np.concatenate([np.diag(self.spread), np.zeros((nx, columns - nx))], axis=1)
        by_parameters = np.concatenate(
            [np.zeros((len(self.opened.varied), own)), self.opened.by_common], axis=1
        )
        inertial = np.zeros((10 * n, columns))
        for column, number in enumerate(self.nominal, start=own + len(self.opened.slot_labels)):
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
        late, late_by = self.opened.delays.readings(numbers)
        time = (self.recording.time[window.rows] - window.start)[:, None]
        place = (time - late[None]) * rate  # (samples, m)
        low = np.clip(np.floor(place + ROUNDING).astype(int), 0, len(readings) - 2)
        share = place - low
        channel = np.arange(len(self.opened.keys))[None]
        y0, y1 = readings[low, channel], readings[low + 1, channel]
        measured = self.opened.measured[window.rows]
        known = np.isfinite(measured) & (place >= -ROUNDING)
        weight = known / self.opened.noise
        rest = np.where(known, y0 + share * (y1 - y0) - measured, 0.0) * weight
        gradient = by[low, channel] * (1.0 - share)[..., None] + by[low + 1, channel] * share[..., None]
        if np.any(late_by):
            common = late_by @ self.opened.by_common  # (m, common)
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
