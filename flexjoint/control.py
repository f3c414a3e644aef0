"""Control laws with named gains, for numbers and CasADi alike.

A law maps references and readings of all joints (n,) to motor torques (n,). The clockwork of
`flexjoint.simulate` samples it at f_c by an integer tick counter and holds the torque in between.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Protocol

import numpy as np

from flexjoint import ops
from flexjoint.errors import RobotError, unknown
from flexjoint.ops import Value
from flexjoint.robot import Robot


class Law(Protocol):
    """A control law: which sensor channels it reads, and its torque."""

    reads: ClassVar[tuple[str, ...]]

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        """(n,) motor torques [N m] from q_ref, theta_ref, dtheta_ref, tau_ff and the readings, (n,) each."""


@dataclass(frozen=True)
class MotorPD:
    """tau = clip(tau_ff + kp (theta_ref - theta) + kd (dtheta_ref - dtheta), +-limit), the total saturated.

    Tomei 1991; Kashiri et al. 2017, equation 4, where tau_ff = g(q_d) and theta_ref = q_d + g(q_d)/K.
    kp [N m/rad], kd [N m s/rad] and limit [N m] are (n,).
    """

    kp: Value
    kd: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("theta", "dtheta")

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        error = reference["theta_ref"] - reading["theta"]
        error_rate = reference["dtheta_ref"] - reading["dtheta"]
        tau = reference["tau_ff"] + self.kp * error + self.kd * error_rate
        return ops.clip(tau, -self.limit, self.limit)


@dataclass(frozen=True)
class LinkPD:
    """tau = clip(tau_ff + kp (q_ref - q) - kd dq, +-limit): feedback of the link instead of the motor.

    Not collocated: its gains are bounded by the spring (Spong 1987). Gains as for MotorPD.
    """

    kp: Value
    kd: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("q", "dq")

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        tau = reference["tau_ff"] + self.kp * (reference["q_ref"] - reading["q"]) - self.kd * reading["dq"]
        return ops.clip(tau, -self.limit, self.limit)


DEFAULT = "motor_pd"
LAWS: Mapping[str, Callable[[Value, Value, Value], Law]] = MappingProxyType(
    {DEFAULT: MotorPD, "link_pd": LinkPD}
)


def law_of(robot: Robot) -> Law:
    """The robot's controller: that of its joints' `controller` key (a name, or name with gains), the
    default law with the joints' kp, kd and torque_limit where there is none.

    Raises UnknownNameError, or RobotError when joints differ in their law or gains are not numbers.
    """
    names, gains = [], []
    for joint in robot.joints:
        entry = robot.file.joints[joint.name].controller
        given = {"name": entry} if isinstance(entry, str) else dict(entry or {})
        name = str(given.pop("name", DEFAULT))
        if name not in LAWS:
            raise unknown(f"controller of joint {joint.name}", name, LAWS)
        values = {"kp": joint.kp, "kd": joint.kd, "limit": joint.torque_limit}
        for gain, value in given.items():
            if gain not in values:
                raise unknown(f"gain of controller {name} of joint {joint.name}", gain, values)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise RobotError(f"joint {joint.name}: gain {gain} must be a number, got {value!r}")
            values[gain] = float(value)
        names.append(name)
        gains.append([values["kp"], values["kd"], values["limit"]])
    if len(set(names)) > 1:
        raise RobotError(f"all joints must share one control law, got {', '.join(sorted(set(names)))}")
    kp, kd, limit = np.array(gains).T
    return LAWS[names[0]](kp, kd, limit)
