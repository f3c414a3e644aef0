"""Sensors: what they make of the true motion, and which of it reaches the recording.

measured(t) = effects(true(t - delay)) + noise, positions rounded to the encoder's resolution.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from zlib import crc32

import numpy as np

from ..catalogue import Planted
from ..robots import Robot
from .chain import Array
from .outside import series

MEASURED = ("q", "dq", "theta", "dtheta", "tau_t")
TOLD = ("q_ref", "theta_ref", "tau_ff")
ALL_CHANNELS = (*MEASURED, "tau_m", *TOLD)  # what a complete recording holds
CURRENT = "tau_motor"  # the motor's torque as its current tells it, instead of a command

DELAYED_WITH = {"q": "q", "dq": "q", "theta": "theta", "dtheta": "theta", "tau_t": "tau_t"}
"""The `channel` of sensor_delay that a measured channel follows."""


PAST, WEIGHTS = np.polynomial.laguerre.laggauss(4)
"""Nodes, in time constants, and weights of a first-order lag's memory exp(-s): exact for a motion that is a
polynomial of degree 7 over the last ten time constants (Gauss and Laguerre's rule)."""


@dataclass(frozen=True)
class Ragged:
    """Time as loggers deliver it: late stamps, lost rows, one gap, lost cells."""

    jitter: float = 0.2  # stamps late by up to this share of the period
    lost_rows: float = 0.03
    gap: float = 0.2  # [s]
    lost_cells: float = 0.004
    sampled_late: bool = False  # True: the samples are as late as their stamps; False: only the stamps are


@dataclass(frozen=True)
class SensorSet:
    """Which channels are recorded, and how well; a noise of None is drawn per robot."""

    channels: tuple[str, ...] = ALL_CHANNELS
    noise: dict[str, float | tuple[float, ...]] | None = None
    """Standard deviation per measured channel, SI; of all joints or of each."""
    resolution: float = 2 * np.pi / 2**18  # [rad] of q and theta; 0 for none
    noisy_feedback: bool = True  # False: the controller reads sensors without noise and quantisation
    ragged: Ragged | None = None

    def __post_init__(self) -> None:
        if unknown := set(self.channels) - {*ALL_CHANNELS, CURRENT}:
            valid = ", ".join((*ALL_CHANNELS, CURRENT))
            raise ValueError(f"unknown channels {sorted(unknown)}; there are {valid}")


FULL = SensorSet()
ENCODERS = SensorSet(channels=("q", "theta", "tau_m", *TOLD))
MOTOR_ONLY = SensorSet(channels=("theta", "dtheta", "tau_m", *TOLD))
NO_COMMAND = SensorSet(channels=(*MEASURED, *TOLD))
LINK_SIDE = SensorSet(channels=("q", "dq", "tau_t", *TOLD))
FROM_CURRENT = SensorSet(channels=(*MEASURED, CURRENT, *TOLD))
RAGGED = SensorSet(ragged=Ragged())
PERFECT = SensorSet(noise=dict.fromkeys(MEASURED, 0.0), resolution=0.0)


def robot_noise(name: str) -> dict[str, float]:
    """Standard deviations per channel of a robot's sensors, drawn once from its name."""
    rng = np.random.default_rng(crc32(name.encode()))
    position, velocity, torque = (
        rng.uniform(1e-5, 3e-5, 2),
        rng.uniform(4e-3, 6e-3, 2),
        rng.uniform(0.04, 0.06),
    )
    return {
        "q": position[0],
        "theta": position[1],
        "dq": velocity[0],
        "dtheta": velocity[1],
        "tau_t": torque,
        CURRENT: torque,
    }


@dataclass(frozen=True)
class Motion:
    """True motion on a uniform grid from `start` [s]; arrays (samples, n), filled as the simulation goes."""

    start: float
    step: float  # [s]
    values: dict[str, Array] = field(repr=False)

    def at(self, channel: str, times: Array) -> Array:
        """Values (m, n) at `times` (m, n): cubic Hermite for positions, else linear; held before `start`."""
        grid = self.values[channel]
        place = np.maximum((times - self.start) / self.step, 0.0)
        low = np.minimum(np.floor(place + 1e-6).astype(int), len(grid) - 2)
        s = np.maximum(place - low, 0.0)
        joint = np.arange(grid.shape[1])
        a, b = grid[low, joint], grid[low + 1, joint]
        if channel in ("q", "theta"):
            slope = self.values["d" + channel]
            da, db = self.step * slope[low, joint], self.step * slope[low + 1, joint]
            between = a + s * (da + s * (3 * (b - a) - 2 * da - db + s * (2 * (a - b) + da + db)))
        else:
            between = a + s * (b - a)
        return np.where(
            s < 1e-5, a, between
        )  # on the grid, take the grid (what lies ahead may not be filled yet)


class Sensors:
    """The sensors of one robot with their planted effects; noise is drawn once per control tick."""

    def __init__(
        self, robot: Robot, effects: list[Planted], sensors: SensorSet, ticks: int, rng: np.random.Generator
    ) -> None:
        self.robot, self.set = robot, sensors
        order = ("sensor_delay", "position_filter", *_SENSOR_LAWS, *_OUTSIDE_LAWS)
        self.effects = sorted((p for p in effects if p.effect in order), key=lambda p: order.index(p.effect))
        level = robot_noise(robot.name) if sensors.noise is None else sensors.noise
        self.noise = {
            c: np.asarray(level.get(c, 0.0)) * rng.standard_normal((ticks, len(robot.joints)))
            for c in (*MEASURED, CURRENT)
        }

    def clean(self, channel: str, motion: Motion, times: Array) -> Array:
        """Readings (m, n) at times (m,) with the sensors' effects, without noise and rounding."""
        seen = times[:, None] - self._delays(channel, times)
        value = motion.at(channel, seen)
        for planted in self.effects:
            if planted.effect == "position_filter" and channel in _both(planted):
                j = self.robot.index(planted.joint)
                lags = planted.value("time_constant") * PAST
                value[:, j] = sum(
                    w * motion.at(channel, seen - lag)[:, j] for w, lag in zip(WEIGHTS, lags, strict=True)
                )
        return self.changed(channel, value, times)

    def changed(self, channel: str, value: Array, times: Array) -> Array:
        """Readings (m, n) as the laws that see nothing but the reading itself leave them."""
        for planted in self.effects:
            change = _SENSOR_LAWS.get(planted.effect) or _OUTSIDE_LAWS.get(planted.effect)
            if change is not None and channel == _channel(planted):
                j = self.robot.index(planted.joint)
                on = times >= planted.start
                value[:, j] = np.where(on, change(planted, value[:, j], times), value[:, j])
        return value

    def read(self, channel: str, motion: Motion, times: Array, ticks: Array) -> Array:
        """Readings (m, n) with the noise of the given ticks (m,), positions rounded."""
        return self._noisy(channel, self.clean(channel, motion, times), ticks)

    def _noisy(self, channel: str, value: Array, ticks: Array | int) -> Array:
        value = value + self.noise[channel][ticks]
        if channel in ("q", "theta") and self.set.resolution > 0:
            value = np.round(value / self.set.resolution) * self.set.resolution
        return value

    def feedback(self, channel: str, motion: Motion, time: float, tick: int, place: int) -> Array:
        """What the controller reads (n,) at a tick, which is sample `place` of the motion."""
        if not self.effects:  # the motion as it is, without the way there
            value = motion.values[channel][place]
            return self._noisy(channel, value, tick) if self.set.noisy_feedback else value
        times = np.array([time])
        if self.set.noisy_feedback:
            return self.read(channel, motion, times, np.array([tick]))[0]
        return self.clean(channel, motion, times)[0]

    def _delays(self, channel: str, times: Array) -> Array:
        delays = np.zeros((len(times), len(self.robot.joints)))
        for planted in self.effects:
            if planted.effect == "sensor_delay" and planted.word("channel") in (None, DELAYED_WITH[channel]):
                joints = slice(None) if planted.joint is None else [self.robot.index(planted.joint)]
                delays[:, joints] += planted.value("delay") * (times >= planted.start)[:, None]
        return delays


def _channel(planted: Planted) -> str | None:
    if planted.effect in ("encoder_eccentricity", "encoder_ripple", *_OUTSIDE_LAWS):
        return planted.word("channel")
    return {"link_encoder_offset": "q", "motor_encoder_offset": "theta"}.get(planted.effect, "tau_t")


def _both(planted: Planted) -> tuple[str, str]:
    """A position and its velocity."""
    position = str(planted.word("channel"))
    return position, f"d{position}"


_SENSOR_LAWS = {  # in the order in which they act on one sensor
    "torque_sensor_gain": lambda p, x, t: (1 + p.value("gain")) * x,
    "encoder_eccentricity": lambda p, x, t: x + p.value("amplitude") * np.sin(x + p.value("phase")),
    "encoder_ripple": lambda p, x, t: (
        x + p.value("amplitude") * np.sin(p.value("cycles") * x + p.value("phase"))
    ),
    "link_encoder_offset": lambda p, x, t: x + p.value("offset"),
    "motor_encoder_offset": lambda p, x, t: x + p.value("offset"),
    "torque_sensor_offset": lambda p, x, t: x + p.value("offset"),
}

_OUTSIDE_LAWS = {  # outside.py tells them
    "encoder_series": lambda p, x, t: x + p.value("amplitude") * series(x, p.value("phase"), np.sin),
    "torque_wander": lambda p, x, t: (
        x + p.value("amplitude") * np.sin(2 * np.pi * t / p.value("period") + p.value("phase"))
    ),
    "torque_bow": lambda p, x, t: x + p.value("share") * x * np.abs(x) / p.value("reference"),
    "torque_steps": lambda p, x, t: np.round(x / p.value("step")) * p.value("step"),
}
