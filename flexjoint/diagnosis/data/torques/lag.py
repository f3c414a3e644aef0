"""Torques that are filtered: the reading lags the torque that acts.

A drive filters its current before it is logged. With a first-order filter the torque that acts is the
reading plus a time constant times its rate (Ljung 1999, "System Identification", chapter 7); a moving
average, or a dead time, is nearly one of the same delay. So of what the motion takes beyond the reading a
share must go with the reading's rate, by the same time constant at every joint.

What acts late itself is no such lag: of a command the torque follows, so that the reading is early, and an
encoder that lags makes it early, too. A dead time of the reading cannot be told from a filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flexjoint.diagnosis.data.change import View
from flexjoint.diagnosis.data.torques.follows import Balance
from flexjoint.diagnosis.data.torques.sampled import sampled_by
from flexjoint.diagnosis.settings import USUAL, DataSettings
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

CHANNEL = "tau_motor"
MOST = 3000  # instants
SMOOTHING = 0.012  # s, standard deviation of the kernel, or ...
LEAST_SAMPLES = 2.0  # ... as many samples
REACH = 5.0  # of them, at which the kernel ends
HOLE = 3.5  # sampling periods between two samples, from which nothing is said of what lies between
DEGREE = 6  # of a smooth law of a joint's position, and of its velocity
BLOCK = 1.0  # s, over which errors are taken for dependent
RANK = 1e-9  # singular values below this share of the largest are none


@dataclass(frozen=True)
class TorqueLag:
    """By how much readings of motor torques lag: the time constant of all joints and its standard error [s],
    the joints that show it, and all whose reading is filtered alike."""

    seconds: float
    std: float
    shown_by: tuple[str, ...]
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"tau_motor of {len(self.joints)} joints lags the torque that acts by {1e3 * self.seconds:.3g} ±"
            f" {1e3 * self.std:.1g} ms, by what the motion of {', '.join(self.shown_by)} takes: a sensor lag,"
            " as of a filter of first order with this time constant, or of an average or a dead time as long,"
            " which the recording cannot tell apart; the readings are used advanced by it"
        )


@dataclass(frozen=True)
class _Joint:
    """What one joint says, all without what a law of its motion may explain: (M,) rate of the reading, rate
    of the torque that the motion takes, and what that is beyond the reading; `blocks` (M,) number times."""

    name: str
    rate: np.ndarray
    taken: np.ndarray
    rest: np.ndarray
    blocks: np.ndarray

    @property
    def seconds(self) -> float:
        """The time constant that this joint shows [s]. The noise of a reading is in its rate, too, by which
        least squares would make the lag too small: the other rate, which has none of it, is the instrument
        (Soderstrom and Stoica 1983, "Instrumental Variable Methods for System Identification")."""
        return float(self.taken @ self.rest) / self._power

    @property
    def std(self) -> float:
        """Standard error [s], from errors that are alike within blocks (Liang and Zeger 1986)."""
        score = self.taken * (self.rest - self.seconds * self.rate)
        return float(np.linalg.norm(np.bincount(self.blocks, score))) / abs(self._power)

    @property
    def _power(self) -> float:
        power = float(self.taken @ self.rate)
        return power if abs(power) > 1e-300 else 1e-300


def torque_lag(robot: Robot, recording: Recording, settings: DataSettings = USUAL.data) -> TorqueLag | None:
    """The lag of a recording's measured motor torques; None where there is none, or none that is sure.

    Two joints at least must show it, and all that can tell must agree about its size. Where the command was
    recorded, too, that is what drives the joint, and its measured torque is not asked."""
    filtered = tuple(
        name
        for name in robot.joint_names
        if recording.has(CHANNEL, name) and not recording.has("tau_m", name)
    )
    if len(filtered) < settings.lag_joints:
        return None
    joints = [joint for joint in _joints(robot, recording, filtered, settings) if joint.std > 0.0]
    shown = [joint for joint in joints if joint.seconds > settings.lag_sure * joint.std]
    if len(shown) < settings.lag_joints:
        return None
    values, errors = np.array([[joint.seconds, joint.std] for joint in shown]).T
    weights = errors**-2.0
    seconds = float(weights @ values / np.sum(weights))
    std = float(np.sum(weights) ** -0.5)
    if seconds <= settings.lag_least:
        return None
    # a joint that would show a lag of this size has to show it
    telling = [joint for joint in joints if seconds > settings.lag_sure * joint.std]
    off = np.array([abs(joint.seconds - seconds) for joint in telling])
    allowed = np.array([max(settings.lag_alike * seconds, 3.0 * joint.std) for joint in telling])
    if np.mean(off <= allowed) < settings.lag_agreeing:
        return None
    return TorqueLag(seconds, std, tuple(joint.name for joint in shown), filtered)


def advanced(recording: Recording, lag: TorqueLag) -> Recording:
    """The recording with the torques that act: each reading plus the time constant times its rate, by central
    differences of its own samples."""
    columns = dict(recording.columns)
    for name in lag.joints:
        values = columns[CHANNEL, name].copy()
        known = np.flatnonzero(np.isfinite(values))
        values[known] += lag.seconds * np.gradient(values[known], recording.time[known])
        columns[CHANNEL, name] = values
    return replace(recording, columns=columns)


class _Smoothed:
    """Channels of a recording (3, M) with two derivatives, all smoothed by one kernel: laws that are linear
    in them stay as they are."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._period = recording, recording.period
        self._even = np.arange(recording.time[0], recording.time[-1], self._period)
        self._stride = -(-self._even.size // MOST)
        self._sigma = max(SMOOTHING / self._period, LEAST_SAMPLES)
        self.at = self._kept(self._even - self._even[0])
        after = np.searchsorted(recording.time, self._even).clip(1, recording.time.size - 1)
        hidden = np.diff(recording.time)[after - 1] > HOLE * self._period
        reach = int(REACH * self._sigma) + 1
        hidden[:reach] = hidden[-reach:] = True
        near = np.convolve(hidden.astype(float), np.ones(2 * reach + 1), mode="same") > 0.5
        self.seen = self._kept(~near)

    def __call__(self, channel: str, joint: str) -> np.ndarray:
        values = self._recording.get(channel, joint)
        known = np.isfinite(values)
        x = np.interp(self._even, self._recording.time[known], values[known])
        parts = [
            gaussian_filter1d(x, self._sigma, order=k, mode="nearest", truncate=REACH) / self._period**k
            for k in range(3)
        ]
        return np.array([self._kept(part) for part in parts])

    def _kept(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(x[:: self._stride])


def _joints(
    robot: Robot, recording: Recording, filtered: Sequence[str], settings: DataSettings
) -> list[_Joint]:
    """Each of some joints that moves, and whose motion tells more than its laws explain."""
    smoothed = _Smoothed(recording)
    data = sampled_by(robot, recording, smoothed)
    if data is None:
        return []
    balance = Balance(data, settings)
    blocks = (smoothed.at / BLOCK).astype(int)
    regressor = balance.body.regressor_batch(*balance.motion(View()))
    out = []
    for joint in robot.joints:
        key = (CHANNEL, joint.name)
        row = balance.row(key, View()) if joint.name in filtered and key in balance.rows else None
        if row is None:
            continue
        q, v, a = row.motion
        speed = float(np.sqrt(np.mean(v**2)))
        # where a joint reverses, friction changes as no law of a few numbers has it
        moving = smoothed.seen & (np.abs(v) > settings.lag_moving * speed)
        if speed == 0.0 or np.count_nonzero(moving) < 0.5 * moving.size:
            continue
        carried = regressor[:, joint.idx_v, :]
        others = np.stack([np.sign(v), a, row.taken], axis=1)
        columns = np.hstack([_smooth(q), _smooth(v), others, carried])
        rates = smoothed(*key)[1], np.gradient(row.taken, smoothed.at)
        series = np.stack([*rates, row.taken - row.recorded], axis=1)
        clean = _without(series[moving], columns[moving])
        out.append(_Joint(joint.name, clean[:, 0], clean[:, 1], clean[:, 2], blocks[moving]))
    return out


def _smooth(x: np.ndarray) -> np.ndarray:
    """(M, k) columns of a smooth law of a signal (M,): Chebyshev polynomials."""
    low, high = float(np.min(x)), float(np.max(x))
    return np.polynomial.chebyshev.chebvander(2.0 * (x - low) / max(high - low, 1e-300) - 1.0, DEGREE)


def _without(series: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(M, n) series without what columns (M, k) explain of them."""
    sizes = np.linalg.norm(columns, axis=0)
    basis, values, _ = np.linalg.svd(columns[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    basis = basis[:, values > RANK * values[0]]
    return np.asarray(series - basis @ (basis.T @ series))
