"""The drive: what it makes of the controller's commands before they act as torques."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from ..catalogue import Planted, neighbour
from ..robots import Robot
from .chain import Array


class Drive:
    """From commands to motor torques: gain, offset, saturation of the held command and a neighbour's share of
    it, then its delay, then the lag, then the resonance."""

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
        self.resonances = {
            robot.index(p.joint): Resonance(p, initial[robot.index(p.joint)], robot.control_rate * substeps)
            for p in effects
            if p.effect == "drive_resonance"
        }
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
        for j, resonance in self.resonances.items():
            torque[:, j] = resonance.follow(torque[:, j])
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


class Resonance:
    """y'' + 2 damping w y' + w^2 y = w^2 u, w = 2 pi/period; exact for a u that is constant over a step."""

    def __init__(self, planted: Planted, initial: float, rate: float) -> None:
        omega = 2 * np.pi / planted.value("period")
        rates = np.array([[0.0, 1.0], [-(omega**2), -2 * planted.value("damping") * omega]])
        self._step = expm(rates / rate)
        self._state = np.array([initial, 0.0])

    def follow(self, asked: Array) -> Array:
        """Means of y (substeps,) over steps in which u is `asked`, by the trapezoidal rule."""
        out = np.empty(len(asked))
        for i, goal in enumerate(asked):
            before, rest = self._state[0], np.array([goal, 0.0])
            self._state = rest + self._step @ (self._state - rest)
            out[i] = (before + self._state[0]) / 2
        return out
