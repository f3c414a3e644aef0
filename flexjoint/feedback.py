"""Linear feedback with named signals: its control law, and the linear model under it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from flexjoint import ops
from flexjoint.control import Law, MotorPD
from flexjoint.errors import ModelError, unknown
from flexjoint.linear_model import LinearModel
from flexjoint.ops import Value
from flexjoint.robot import Robot

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
            name, age = signal.split(".", 1)[1].rstrip("]").rsplit(PAST, 1)
            while len(blocks) < int(age):
                blocks.append(np.zeros((len(joints), len(joints))))
            blocks[int(age) - 1][:, joints.index(name)] = self.matrix[:, column]
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


def on_states(linear: LinearModel, gains: Gains) -> np.ndarray:
    """(n, nx) F of u = -F x: readings through C, where they are late or scaled; past commands as they are."""
    if linear.dt is None and linear.delayed:
        raise ModelError("a continuous model with dead times cannot be closed exactly; sample it (`sampled`)")
    if gains.inputs != linear.inputs:
        raise ModelError(
            f"the gains are for {', '.join(gains.inputs)}; the model has {', '.join(linear.inputs)}"
        )
    out = np.zeros((len(linear.inputs), len(linear.states)))
    for column, signal in enumerate(gains.signals):
        if PAST in signal:
            out[:, linear.places("states", [signal])[0]] += gains.matrix[:, column]
        else:
            row = linear.places("outputs", [signal])[0]
            out += np.outer(gains.matrix[:, column], linear.C[row])
    return out


def close_loop(linear: LinearModel, gains: Gains) -> LinearModel:
    """The linear model under the feedback; its inputs add to the commanded torque."""
    return replace(linear, A=linear.A - linear.B @ on_states(linear, gains))


def open_loop(linear: LinearModel, gains: Gains) -> LinearModel:
    """From motor torques to what the feedback would take off them, all loops cut: L of the closed loop 1 +
    L."""
    back = tuple(f"feedback.{name.split('.', 1)[1]}" for name in linear.inputs)
    n = len(back)
    return replace(
        linear, C=on_states(linear, gains), D=np.zeros((n, n)), outputs=back, output_delay=np.zeros(n)
    )
