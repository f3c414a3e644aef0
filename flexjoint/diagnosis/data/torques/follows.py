"""How well recorded torques follow those that the recorded motion takes.

    recorded = gain * taken + friction sgn(v) + damping v + inertia a,  least <= gain <= most, others >= 0

by least squares that know no negative friction (Lawson and Hanson 1974, "Solving Least Squares Problems",
chapter 23): a real machine's friction, load and rotor inertia are no error of its data, but no machine gives
energy where it should take it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.data.change import Key, Source, View
from flexjoint.diagnosis.data.torques.sampled import Sampled
from flexjoint.diagnosis.settings import DataSettings
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.rigidbody.numeric import PinBody

REMEMBERED = 2e7  # bytes of torques along changed motions
SLOW = 0.02  # of a joint's RMS speed, below which its sign is rounded
STILL = 1e-6  # rad/s or m/s (RMS), below which nothing moves


@dataclass(frozen=True)
class Taken:
    """Torques (n, M) that a motion takes of motors and of transmissions, and the motion (3, M) of each
    joint's link and motor, by name."""

    of_motor: np.ndarray
    of_link: np.ndarray
    link: dict[str, np.ndarray]
    motor: dict[str, np.ndarray]

    @property
    def nbytes(self) -> int:
        return self.of_motor.nbytes * 8  # about: as many series


@dataclass(frozen=True)
class Row:
    """A recorded torque (M,) beside the one that the motion takes and the motion (3, M) of its side."""

    key: Key
    recorded: np.ndarray
    taken: np.ndarray
    motion: np.ndarray

    @property
    def size(self) -> float:
        """Mean square of the recorded torque."""
        return float(np.mean(self.recorded**2))


class Balance:
    """Recorded torques against the model, with any changes made to the data.

    `rows` are the torques that are looked at: of moving joints, and not all zero."""

    def __init__(self, data: Sampled, settings: DataSettings) -> None:
        self.data, self.settings = data, settings
        self.model = FlexibleJointModel(data.robot)
        self.body = self.model.body
        self._taken: LruCache[Taken] = LruCache()
        self._names = data.robot.joint_names
        self.rows: tuple[Key, ...] = tuple(
            key for key, tau in data.torque.items() if np.sqrt(np.mean(tau**2)) > 0.0
        )

    # ------------------------------------------------------------------ what is measured, and what it takes
    def row(self, key: Key, view: View) -> Row | None:
        """A torque with the changes made; None where its new source was not recorded."""
        channel, joint = key
        source = view.torques.get(key, Source(joint))
        raw = self.data.torque.get((channel, source.joint))
        if raw is None:
            return None
        taken, i = self.taken(view), self._names.index(joint)
        if channel == "tau_t":
            return Row(key, source.scale * raw, taken.of_link[i], taken.link[joint])
        flow, motion = self.model.flows[i], taken.motor[joint]
        (q, dq, _), (theta, dtheta, _) = taken.link[joint], motion
        s = Signals(0.0, q, dq, theta, dtheta)
        return Row(key, flow.steady_command(s, source.scale * raw), taken.of_motor[i], motion)

    def taken(self, view: View) -> Taken:
        return self._taken.get(view.motion, lambda: self._evaluated(view), REMEMBERED)

    def motion(self, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q (M, nq), v and a (M, nv) of the whole model."""
        data = self.data
        q, v, a = np.tile(self.body.neutral, (data.count, 1)), *np.zeros((2, data.count, self.model.nv))
        for name in data.joints:
            joint = data.robot.model.joints[data.robot.model.getJointId(name)]
            moved = _moved(data.link, name, view)
            q[:, joint.idx_q], v[:, joint.idx_v], a[:, joint.idx_v] = moved
        return q, v, a

    def _evaluated(self, view: View) -> Taken:
        data, body = self.data, self.body
        if view.gravity is not None:
            body = PinBody(data.robot.model, inertial=body.inertial, gravity=np.array(view.gravity))
        load = body.rnea_batch(*self.motion(view))
        link = {name: _moved(data.link, name, view) for name in self._names}
        motor = {name: _moved(data.motor, name, view) for name in self._names}
        of, of_link = [], []
        z = np.zeros((max(self.model.nz, 1), 1))
        for flow in self.model.flows:
            name = flow.joint.name
            of.append(Signals(0.0, link[name][0], link[name][1], motor[name][0], motor[name][1]))
            of_link.append(load[:, flow.joint.idx_v] - flow.torques(of[-1], z)[1])
        own = self.model.motor_torques(of, [motor[name][2] for name in self._names], z)
        of_motor = [needed + torque for needed, torque in zip(of_link, own, strict=True)]
        return Taken(np.array(of_motor), np.array(of_link), link, motor)

    # ------------------------------------------------------------------ how well they agree
    def misfits(self, view: View) -> np.ndarray:
        """(rows,) mean square of what is left of each torque, over that of the torque; 1 where its source was
        not recorded."""
        return np.array(
            [1.0 if (row := self.row(key, view)) is None else self.misfit(row) for key in self.rows]
        )

    def misfit(self, row: Row, gains: tuple[float, float] | None = None, spring: bool = False) -> float:
        """Of one row. `spring`: with what an offset, and a spring to any angle, would explain."""
        return self.fitted(row, gains or limits_of(self.settings.gain_range), spring)[0]

    def fitted(self, row: Row, gains: tuple[float, float], spring: bool = False) -> tuple[float, float]:
        """(misfit, gain) of one row, with gains between two limits."""
        position, v, a = row.motion
        rms = float(np.sqrt(np.mean(v**2)))
        columns = [row.taken]
        if rms > STILL:
            columns += [v / np.hypot(v, SLOW * rms), v, a]
        if spring:
            columns += [np.ones_like(v), -np.ones_like(v), position - np.mean(position)]
        return _bounded(row.recorded, columns, gains)


def limits_of(gains: tuple[float, ...]) -> tuple[float, float]:
    """Least and most of a setting's two gains."""
    return min(gains), max(gains)


def cost(misfits: np.ndarray) -> float:
    """Of several rows: the mean, a row that is no better than nothing counting 1."""
    return float(np.mean(np.minimum(misfits, 1.0)))


def _bounded(y: np.ndarray, columns: Sequence[np.ndarray], gains: tuple[float, float]) -> tuple[float, float]:
    """Least squares with coefficients >= 0, the first one between two limits: (share left of y, the first).

    The problem is convex: where the first would exceed its limit, it is at that limit.
    """
    power = float(y @ y)
    sizes = np.array([max(float(np.linalg.norm(column)), 1e-300) for column in columns])
    matrix = np.column_stack(columns) / sizes
    least, most = gains
    rest = y - least * columns[0]
    solution, norm = nnls(matrix, rest)
    gain = least + solution[0] / sizes[0]
    if gain > most:
        gain = most
        _, norm = (
            nnls(matrix[:, 1:], y - most * columns[0])
            if len(columns) > 1
            else (0, np.linalg.norm(y - most * columns[0]))
        )
    return float(norm**2) / max(power, 1e-300), float(gain)


def _moved(signals: object, joint: str, view: View) -> np.ndarray:
    """(3, M) position, velocity and acceleration of a joint with the changes made."""
    source = view.positions.get(joint, Source(joint))
    out = source.scale * signals[source.joint]  # type: ignore[index]
    out[0] += source.shift
    return out
