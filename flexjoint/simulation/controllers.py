"""Control laws with named gains, for numbers and CasADi alike.

A law maps references and readings of all joints (n,) to motor torques (n,). The clockwork samples it at f_c
by an integer tick counter and holds the torque in between. Every law saturates its total torque:
torque = clip(demand, +-limit).

References are q_ref, theta_ref, dtheta_ref and tau_ff; a law that tracks a velocity on the link's side takes
dtheta_ref there too, for at a steady speed both sides share it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import RobotError, unknown
from flexjoint.core.ops import Value
from flexjoint.robot.robot import Joint, Robot

LIMIT = "limit"


class Law(Protocol):
    """A control law: which sensor channels it reads, and its torque."""

    reads: ClassVar[tuple[str, ...]]

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        """(n,) motor torques [N m] from q_ref, theta_ref, dtheta_ref, tau_ff and the readings, (n,) each."""


class Saturated(ABC):
    """A law that clips what it demands; subclasses have a `limit` [N m] and `demand`."""

    limit: Value

    @abstractmethod
    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        """(n,) motor torques [N m] before saturation."""

    def torque(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        """(n,) motor torques [N m], the total within the limit."""
        return ops.clip(self.demand(reference, reading), -self.limit, self.limit)


@dataclass(frozen=True)
class MotorPD(Saturated):
    """tau = clip(tau_ff + kp (theta_ref - theta) + kd (dtheta_ref - dtheta), +-limit), the total saturated.

    Tomei 1991; Kameduła et al. 2016, equation 4, where tau_ff = g(q_d) and theta_ref = q_d + g(q_d)/K.
    kp [N m/rad], kd [N m s/rad] and limit [N m] are (n,).
    """

    kp: Value
    kd: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("theta", "dtheta")

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        error = reference["theta_ref"] - reading["theta"]
        error_rate = reference["dtheta_ref"] - reading["dtheta"]
        return reference["tau_ff"] + self.kp * error + self.kd * error_rate


@dataclass(frozen=True)
class LinkPD(Saturated):
    """tau = clip(tau_ff + kp (q_ref - q) - kd dq, +-limit): feedback of the link instead of the motor.

    Not collocated: its gains are bounded by the spring (Spong 1987). Gains as for MotorPD.
    """

    kp: Value
    kd: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("q", "dq")

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        return reference["tau_ff"] + self.kp * (reference["q_ref"] - reading["q"]) - self.kd * reading["dq"]


@dataclass(frozen=True)
class FullState(Saturated):
    """Feedback of the whole state [q, theta, dq, dtheta] and of the spring's torque, five gains a joint.

        tau = clip(tau_ff + kp (theta_ref - theta) + kd (dtheta_ref - dtheta)
                   + kp_link (q_ref - q) + kd_link (dtheta_ref - dq) + k_torque (tau_ff - tau_t), +-limit)

    Albu-Schaffer, Ott and Hirzinger 2007 (state feedback). kp, kp_link [N m/rad], kd, kd_link [N m s/rad],
    k_torque [1] and limit [N m] are (n,). kp and kd alone are MotorPD.
    """

    kp: Value
    kd: Value
    kp_link: Value
    kd_link: Value
    k_torque: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("q", "dq", "theta", "dtheta", "tau_t")

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        rate, load = reference["dtheta_ref"], reference["tau_ff"]
        # in this order, so that with the gains of MotorPD alone it is MotorPD to the last bit
        tau = load + self.kp * (reference["theta_ref"] - reading["theta"])
        tau = tau + self.kd * (rate - reading["dtheta"])
        tau = tau + self.kp_link * (reference["q_ref"] - reading["q"])
        tau = tau + self.kd_link * (rate - reading["dq"])
        return tau + self.k_torque * (load - reading["tau_t"])

    @classmethod
    def extending(cls, law: MotorPD) -> FullState:
        """The same law with room for the gains that it lacks."""
        none = np.zeros(np.shape(law.kp))
        return cls(law.kp, law.kd, none, none, none, law.limit)


@dataclass(frozen=True)
class TorqueLoop(Saturated):
    """A spring torque loop inside a link impedance.

        tau_d = tau_ff + kp (q_ref - q) + kd (dtheta_ref - dq)
        tau = clip(tau_d + k_torque (tau_d - tau_t) - kd_spring (dtheta - dq), +-limit)

    Ott et al. 2008: torque feedback makes the motor look 1 + k_torque times lighter; kd_spring damps the
    spring, whose rate is dtheta - dq. kp [N m/rad], kd, kd_spring [N m s/rad], k_torque [1] and limit [N m]
    are (n,).
    """

    kp: Value
    kd: Value
    k_torque: Value
    kd_spring: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("q", "dq", "dtheta", "tau_t")

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        error, rate = reference["q_ref"] - reading["q"], reference["dtheta_ref"] - reading["dq"]
        wanted = reference["tau_ff"] + self.kp * error + self.kd * rate
        inner = self.k_torque * (wanted - reading["tau_t"])
        return wanted + inner - self.kd_spring * (reading["dtheta"] - reading["dq"])


@dataclass(frozen=True)
class Velocity(Saturated):
    """tau = clip(tau_ff + kd (dtheta_ref - dtheta), +-limit): a wheel. kd [N m s/rad], limit [N m]: (n,)."""

    kd: Value
    limit: Value
    reads: ClassVar[tuple[str, ...]] = ("dtheta",)

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        return reference["tau_ff"] + self.kd * (reference["dtheta_ref"] - reading["dtheta"])


@dataclass(frozen=True)
class Mixed(Saturated):
    """Different laws on different joints: each part holds the places of its joints and their law."""

    parts: tuple[tuple[tuple[int, ...], Any], ...]

    @property
    def reads(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, law in self.parts for name in law.reads))

    @property
    def limit(self) -> Value:
        return self._gathered([law.limit for _, law in self.parts])

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value:
        torques = []
        for places, law in self.parts:
            at = list(places)
            ours = {name: values[at] for name, values in reference.items()}
            seen = {name: reading[name][at] for name in law.reads}
            torques.append(law.demand(ours, seen))
        return self._gathered(torques)

    def _gathered(self, vectors: list[Value]) -> Value:
        entries: dict[int, Value] = {}
        for (places, _), vector in zip(self.parts, vectors, strict=True):
            entries.update({place: vector[k] for k, place in enumerate(places)})
        return ops.stack([entries[i] for i in range(len(entries))])


DEFAULT = "motor_pd"
LAWS: Mapping[str, Any] = MappingProxyType(
    {
        DEFAULT: MotorPD,
        "link_pd": LinkPD,
        "full_state": FullState,
        "torque_loop": TorqueLoop,
        "velocity": Velocity,
    }
)


def gain_names(law: Any) -> tuple[str, ...]:
    """Names of the gains of a law or of its class, the limit last."""
    return tuple(field.name for field in fields(law))


def gains_of(law: Any, place: int) -> dict[str, float]:
    """The gains of the joint at that place, by name. A MotorPD has the five of FullState, three of them 0."""
    part, at = _part_of(law, place)
    part = FullState.extending(part) if isinstance(part, MotorPD) else part
    return {name: float(getattr(part, name)[at]) for name in gain_names(part)}


def with_gain(law: Any, place: int, name: str, value: float) -> Any:
    """The law with one gain of the joint at that place changed; a MotorPD that is given one that it lacks
    becomes a FullState.

    Raises UnknownNameError; RobotError for a value that is no number, or a limit that is not above 0.
    """
    part, at = _part_of(law, place)
    old = part
    if isinstance(part, MotorPD) and name not in gain_names(MotorPD):
        part = FullState.extending(part)
    if name not in gain_names(part):
        raise unknown("gain", name, gain_names(part))
    if math.isnan(value) or (math.isinf(value) and name != LIMIT) or (name == LIMIT and not value > 0.0):
        raise RobotError(
            f"gain {name}: expected {'a number > 0' if name == LIMIT else 'a number'}, got {value}"
        )
    changed = np.array(getattr(part, name), dtype=float)
    changed[at] = value
    part = replace(part, **{name: changed})
    if not isinstance(law, Mixed):
        return part
    return Mixed(tuple((places, part if other is old else other) for places, other in law.parts))


def _part_of(law: Any, place: int) -> tuple[Any, int]:
    """The law of the joint at that place, and the joint's place in it."""
    if isinstance(law, Mixed):
        for places, part in law.parts:
            if place in places:
                return part, places.index(place)
    return law, place


def law_of(robot: Robot) -> Any:
    """The robot's controller: that of its joints' `controller` key (a name, or name with gains), the
    default law with the joints' kp, kd and torque_limit where there is none; `Mixed` where joints differ.

    Raises UnknownNameError, or RobotError when gains are not numbers.
    """
    chosen = [_entry(robot, joint) for joint in robot.joints]
    parts = []
    for name in dict.fromkeys(name for name, _ in chosen):
        places = tuple(i for i, (other, _) in enumerate(chosen) if other == name)
        gains = {
            gain: np.array([chosen[i][1][gain] for i in places], dtype=float)
            for gain in gain_names(LAWS[name])
        }
        parts.append((places, LAWS[name](**gains)))
    return parts[0][1] if len(parts) == 1 else Mixed(tuple(parts))


def _entry(robot: Robot, joint: Joint) -> tuple[str, dict[str, float]]:
    """Name of a joint's law, and its gains by name: 0 where neither the entry nor the joint gives one."""
    entry = robot.file.joints[joint.name].controller
    given = {"name": entry} if isinstance(entry, str) else dict(entry or {})
    name = str(given.pop("name", DEFAULT))
    if name not in LAWS:
        raise unknown(f"controller of joint {joint.name}", name, LAWS)
    own = {"kp": joint.kp, "kd": joint.kd, LIMIT: joint.torque_limit}
    values = {gain: own.get(gain, 0.0) for gain in gain_names(LAWS[name])}
    for gain, value in given.items():
        if gain not in values:
            raise unknown(f"gain of controller {name} of joint {joint.name}", gain, values)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise RobotError(f"joint {joint.name}: gain {gain} must be a number, got {value!r}")
        values[gain] = float(value)
    return name, values
