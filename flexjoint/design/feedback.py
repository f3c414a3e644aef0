"""Linear feedback with named signals: its control law, and the linear model under it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.ops import Value
from flexjoint.design.linear_model import LinearModel, shift
from flexjoint.robot.robot import Robot
from flexjoint.simulation.controllers import Law, MotorPD

READS = ("q", "dq", "theta", "dtheta")
PAST = "[n-"  # marks a register of a sampled model: a command of an earlier tick


@dataclass(frozen=True)
class Gains:
    """tau = tau_ff - matrix (signals - their references), total torque saturated.

    matrix (n, m) [N m per unit of the signal]; signals (m) are channel.joint of the readings q, dq, theta,
    dtheta, or tau_m.joint[n-k], the commands of earlier ticks; inputs (n) are tau_m.joint. `rate` [Hz] is
    that of the ticks for which they were designed (None: continuous).
    """

    matrix: np.ndarray
    signals: tuple[str, ...]
    inputs: tuple[str, ...]
    rate: float | None = None

    @staticmethod
    def motor_pd(robot: Robot, kp: np.ndarray, kd: np.ndarray) -> Gains:
        """Gains of `control.MotorPD`: kp (n,) [N m/rad] on theta, kd (n,) [N m s/rad] on dtheta."""
        names = robot.joint_names
        matrix = np.hstack([np.diag(np.broadcast_to(k, len(names)).astype(float)) for k in (kp, kd)])
        signals = tuple(f"{channel}.{name}" for channel in ("theta", "dtheta") for name in names)
        return Gains(matrix, signals, tuple(f"tau_m.{name}" for name in names))

    def law(self, robot: Robot) -> Law:
        """The law for the simulator, saturated at the joints' torque limits: MotorPD where the gains are
        one. Raises UnknownNameError for signals that no law reads."""
        limit = np.array([joint.torque_limit for joint in robot.joints])
        names = robot.joint_names
        valid = [f"{channel}.{name}" for channel in READS for name in names]
        for signal in self.signals:
            if PAST not in signal and signal not in valid:
                raise unknown("signal that a law can feed back", signal, valid)
        parts = {channel: self._block(channel, names) for channel in READS}
        diagonal = all(np.array_equal(block, np.diag(np.diag(block))) for block in parts.values())
        past = self._past(names)
        if diagonal and not past and not np.any(parts["q"]) and not np.any(parts["dq"]):
            return MotorPD(np.diag(parts["theta"]).copy(), np.diag(parts["dtheta"]).copy(), limit)
        return StateFeedback(parts["q"], parts["dq"], parts["theta"], parts["dtheta"], limit, past)

    def _block(self, channel: str, joints: tuple[str, ...]) -> np.ndarray:
        """(n, n) gains on a channel of all joints, 0 where there is none."""
        out = np.zeros((len(joints), len(joints)))
        for column, signal in enumerate(self.signals):
            if PAST not in signal and signal.split(".", 1)[0] == channel:
                out[:, joints.index(signal.split(".", 1)[1])] = self.matrix[:, column]
        return out

    def _past(self, joints: tuple[str, ...]) -> tuple[np.ndarray, ...]:
        """(n, n) gains on the commands of one, two, ... ticks ago."""
        blocks: list[np.ndarray] = []
        for column, signal in enumerate(self.signals):
            if PAST not in signal:
                continue
            name, age = _aged(signal)
            while len(blocks) < age:
                blocks.append(np.zeros((len(joints), len(joints))))
            blocks[age - 1][:, joints.index(name.split(".", 1)[1])] = self.matrix[:, column]
        return tuple(blocks)


@dataclass
class StateFeedback:
    """tau = clip(tau_ff - kq (q - q_ref) - kdq (dq - dtheta_ref) - ktheta (theta - theta_ref)
    - kdtheta (dtheta - dtheta_ref) - sum of past[k] times the deviation commanded k + 1 ticks ago, +-limit).

    Gains (n, n). With `past`, an object serves one simulation: it remembers what it commanded.
    """

    kq: np.ndarray
    kdq: np.ndarray
    ktheta: np.ndarray
    kdtheta: np.ndarray
    limit: np.ndarray
    past: tuple[np.ndarray, ...] = ()
    reads: ClassVar[tuple[str, ...]] = READS
    _memory: list[np.ndarray] = field(default_factory=list, repr=False)

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        rate = reference["dtheta_ref"]
        deviation = -(
            self.kq @ (reading["q"] - reference["q_ref"])
            + self.kdq @ (reading["dq"] - rate)
            + self.ktheta @ (reading["theta"] - reference["theta_ref"])
            + self.kdtheta @ (reading["dtheta"] - rate)
        )
        for gain, before in zip(self.past, self._memory, strict=False):
            deviation = deviation - gain @ before
        tau = ops.clip(reference["tau_ff"] + deviation, -self.limit, self.limit)
        if self.past:
            self._memory.insert(0, tau - reference["tau_ff"])
            del self._memory[len(self.past) :]
        return tau


def join(linear: LinearModel, gains: Gains) -> tuple[LinearModel, np.ndarray]:
    """The model beside what the law remembers of its commands, and F (n, nx) of u = -F x.

    Readings come through C, late or scaled as they are. The memory is the law's own, apart from commands on
    their way in the model: where the robot does not follow its command, the two differ.
    """
    if linear.dt is None and linear.delayed:
        raise ModelError("a continuous model with dead times cannot be closed exactly; sample it (`sampled`)")
    if gains.inputs != linear.inputs:
        raise ModelError(
            f"the gains are for {', '.join(gains.inputs)}; the model has {', '.join(linear.inputs)}"
        )
    past = [_aged(signal) for signal in gains.signals if PAST in signal]
    if past and linear.dt is None:
        raise ModelError("the gains feed back earlier commands; sample the model (`sampled`)")
    n, nx = len(linear.inputs), len(linear.states)
    ages = [max((age for name, age in past if name == own), default=0) for own in linear.inputs]
    first = nx + np.concatenate([[0], np.cumsum(ages)]).astype(int)
    size = int(first[-1])
    F = np.zeros((n, size))
    for column, signal in enumerate(gains.signals):
        if PAST in signal:
            name, age = _aged(signal)
            F[:, first[linear.places("inputs", [name])[0]] + age - 1] += gains.matrix[:, column]
        else:
            row = linear.places("outputs", [signal])[0]
            F[:, :nx] += np.outer(gains.matrix[:, column], linear.C[row])
    A, B, C = np.zeros((size, size)), np.zeros((size, n)), np.zeros((len(linear.outputs), size))
    A[:nx, :nx], B[:nx], C[:, :nx] = linear.A, linear.B, linear.C
    names = list(linear.states)
    for j, age in enumerate(ages):
        shift(A, first[j], age)
        if age:
            A[first[j]] -= F[j]
        names += [f"sent.{linear.inputs[j].split('.', 1)[1]}{PAST}{k + 1}]" for k in range(age)]
    drift = np.concatenate([linear.drift, np.zeros(size - nx)])
    return replace(linear, A=A, B=B, C=C, states=tuple(names), drift=drift), F


def close_loop(linear: LinearModel, gains: Gains) -> LinearModel:
    """The linear model under the feedback; its inputs add to the commanded torque."""
    joined, F = join(linear, gains)
    return replace(joined, A=joined.A - joined.B @ F)


def open_loop(linear: LinearModel, gains: Gains) -> LinearModel:
    """From motor torques to what the feedback would take off them, all loops cut: L of the closed loop
    1 + L."""
    joined, F = join(linear, gains)
    back = tuple(f"feedback.{name.split('.', 1)[1]}" for name in linear.inputs)
    n = len(back)
    return replace(joined, C=F, D=np.zeros((n, n)), outputs=back, output_delay=np.zeros(n))


def _aged(signal: str) -> tuple[str, int]:
    """Name and age in ticks of an earlier command, tau_m.joint[n-k]."""
    name, age = signal.rstrip("]").rsplit(PAST, 1)
    return name, int(age)
