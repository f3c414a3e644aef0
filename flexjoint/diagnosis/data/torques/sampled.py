"""A recording at a few hundred instants: positions with their derivatives, and torques, smoothed alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.settings import DataSettings
from flexjoint.recording.smooth import local_polynomial
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

TORQUES = ("tau_m", "tau_motor", "tau_t")
EDGE = 0.02  # share of the recording at either end where its derivatives are not used
PERIODS = 4.0  # sampling periods that a kernel's standard deviation has at least


@dataclass(frozen=True)
class Sampled:
    """M instants of a recording. `link` and `motor` map a moving joint to (3, M): position, velocity and
    acceleration; a side that was not measured has the other's. `torque` maps (channel, joint) to (M,)."""

    robot: Robot
    link: Mapping[str, np.ndarray]
    motor: Mapping[str, np.ndarray]
    torque: Mapping[tuple[str, str], np.ndarray]
    by_motor: frozenset[str]  # joints of which the motor's encoder alone was recorded

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(self.link)

    @property
    def count(self) -> int:
        """M."""
        return next(iter(self.link.values())).shape[1]


def sampled(robot: Robot, recording: Recording, settings: DataSettings) -> Sampled | None:
    """The recording at instants that lie evenly among its samples with torques (motors may be off for most of
    a log); None where its torques cannot be told from its motion: a floating base, a joint of several axes,
    one without a position, no torque at all."""
    width = max(settings.smoothing, PERIODS * recording.period)
    time = recording.time[_near_torques(robot, recording, recording.time, width)]
    if not time.size:
        return None
    last = time.size - 1
    places = np.linspace(EDGE * last, (1.0 - EDGE) * last, settings.instants)
    at = np.interp(places, np.arange(last + 1), time)
    at = at[_near_torques(robot, recording, at, width)]

    def smoothed(channel: str, joint: str) -> np.ndarray:
        values = recording.get(channel, joint)
        known = np.isfinite(values)
        return np.array(local_polynomial(recording.time[known], values[known], at, width))

    return sampled_by(robot, recording, smoothed)


def _near_torques(robot: Robot, recording: Recording, at: np.ndarray, width: float) -> np.ndarray:
    """(M,) bool, the instants at which all recorded torques have samples within `width` [s], or within their
    own period."""
    near = np.ones(at.size, dtype=bool)
    for channel in TORQUES:
        for joint in robot.joint_names:
            if recording.has(channel, joint):
                known = recording.time[np.isfinite(recording.get(channel, joint))]
                if not known.size:  # a torque of a motor that was off all the time
                    return np.zeros(at.size, dtype=bool)
                nearest = np.interp(at, known, np.arange(known.size)).round().astype(int)
                own = float(np.median(np.diff(known))) if known.size > 1 else 0.0
                near &= np.abs(known[nearest] - at) <= max(width, own)
    return near


def sampled_by(
    robot: Robot, recording: Recording, smoothed: Callable[[str, str], np.ndarray]
) -> Sampled | None:
    """The recording with each channel of a joint as (3, M) by a function; None as of `sampled`."""
    joints = [name for name in robot.model.names if name != "universe"]
    sides = {name: [c for c in ("q", "theta") if recording.has(c, name)] for name in joints}
    there = [(c, name) for c in TORQUES for name in robot.joint_names if recording.has(c, name)]
    one_axis = all(joint.nq == 1 and joint.nv == 1 for joint in list(robot.model.joints)[1:])
    if robot.floating or not one_axis or not all(sides.values()) or not there:
        return None
    link = {name: smoothed(channels[0], name) for name, channels in sides.items()}
    motor = {
        name: smoothed("theta", name) if len(channels) > 1 else link[name] for name, channels in sides.items()
    }
    by_motor = frozenset(name for name, channels in sides.items() if channels == ["theta"])
    return Sampled(robot, link, motor, {key: smoothed(*key)[0] for key in there}, by_motor)
