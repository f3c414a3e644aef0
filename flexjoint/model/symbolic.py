"""The same model as named casadi.Functions of state, motor torque, parameters and time.

Nothing is written twice: `FlexibleJointModel` runs on CasADi SX over `SymbolicBody`. Effects count as always
on (`since` belongs to a recording) unless a time is given. Steps of it are in
`flexjoint.simulation.schemes.discrete`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.core.errors import unknown
from flexjoint.core.ops import Value
from flexjoint.effects import SENSOR_CHANNELS, Drive, Planned, Signals
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.parameters import DRIVE_KEYS, FREE, INERTIAL_KEYS, labels, model_parameters
from flexjoint.model.springs import VariableSpring
from flexjoint.rigidbody.symbolic import SymbolicBody
from flexjoint.robot.robot import Joint, Robot


class SymbolicModel:
    """A robot with effects as CasADi Functions.

    Inputs everywhere: x, u (n,) motor torques [N m], p (np,) parameters in the order of `parameters`,
    t [s]. `parameters` names those of effects effect.joint.name (joint `robot` for the whole robot);
    `values` (np,) holds their numbers.

    Args:
        free: what else becomes a parameter: "drives" (drive.joint.stiffness, damping, motor_inertia,
            motor_damping; the first two not of rigid joints), "inertial" (body.joint.m, mx .. Izz of every
            moving body, in Pinocchio's order; costs the constants that a step could fold).
        at, springs: see FlexibleJointModel.
        commanded: joints whose spring's stiffness and damping are parameters spring.joint.stiffness and
            spring.joint.damping, whatever effects make of the drive's.

    Raises what FlexibleJointModel and SymbolicBody raise, and UnknownNameError for `free`.
    """

    def __init__(
        self,
        robot: Robot,
        effects: Iterable[Planned] | None = None,
        *,
        free: Collection[str] = (),
        at: float | None = None,
        springs: Mapping[str, VariableSpring] | None = None,
        commanded: Collection[str] = (),
    ) -> None:
        for name in free:
            if name not in FREE:
                raise unknown("free parameters", name, FREE)
        planned = tuple(robot.effects if effects is None else effects)
        table = {name: item.value for name, item in model_parameters(robot, planned, free).items()}
        for name in commanded:
            drive = robot.joint(name).drive
            table |= {f"spring.{name}.stiffness": drive.K, f"spring.{name}.damping": drive.D}
        self.parameters: tuple[str, ...] = tuple(table)
        self.values: np.ndarray = np.array(list(table.values()))
        symbols = {name: ca.SX.sym(name) for name in table}
        joints = tuple(_with_symbols(joint, symbols) for joint in robot.joints) if "drives" in free else None
        self.robot, self.at, self.springs = robot, at, springs
        self.effects = planned
        self.model = FlexibleJointModel(
            replace(robot, joints=joints) if joints else robot,
            [_freed(item, symbols) for item in planned],
            _body_of(robot.model, symbols) if "inertial" in free else SymbolicBody,
            at,
            {**(springs or {}), **{name: _symbolic_spring(name, symbols) for name in commanded}},
        )
        self.p = ca.vertcat(ca.SX(0, 1), *symbols.values())
        self.u = ca.SX.sym("u", len(robot.joints))
        self.t = ca.SX.sym("t")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of the continuous state x; see FlexibleJointModel."""
        return self.model.state_names

    @cached_property
    def reading_names(self) -> tuple[str, ...]:
        """Names channel.joint of the readings y; tau_t only of flexible joints."""
        return tuple(
            f"{channel}.{joint.name}"
            for joint in self.model.joints
            for channel in SENSOR_CHANNELS
            if not (joint.rigid and channel == "tau_t")
        )

    def set_values(self, changes: Mapping[str, float]) -> np.ndarray:
        """`values` with some parameters changed by name; UnknownNameError lists the valid names."""
        out = self.values.copy()
        for name, value in changes.items():
            if name not in self.parameters:
                raise unknown("parameter", name, self.parameters)
            out[self.parameters.index(name)] = value
        return out

    # --- continuous ------------------------------------------------------------------------------
    def dynamics(self, width: float) -> ca.Function:
        """dynamics(x, u, p, t) -> dx, delays aside; dry friction as level tanh(velocity / width)."""
        x = ca.SX.sym("x", self.model.nx)
        return self.function("dynamics", x, self.model.rhs(x, self.u, width, self.t), "dx")

    def measure(self) -> ca.Function:
        """measure(x, u, p, t) -> y, the sensors' readings in the order of `reading_names`, delays aside."""
        x = ca.SX.sym("x", self.model.nx)
        state = self.model.unpack(x, self.t)
        y = [self.read(key, self.true(state)[key]) for key in self.reading_keys()]
        return self.function("measure", x, ca.vertcat(*y), "y")

    # --- shared ----------------------------------------------------------------------------------
    def function(self, name: str, x: ca.SX, out: ca.SX, label: str) -> ca.Function:
        inputs = [x, self.u, self.p, self.t]
        return ca.Function(name, inputs, [ca.cse(ca.densify(out))], ["x", "u", "p", "t"], [label])

    def reading_keys(self) -> list[tuple[str, int]]:
        names = self.model.robot.joint_names
        pairs = [name.split(".", 1) for name in self.reading_names]
        return [(channel, names.index(joint)) for channel, joint in pairs]

    def true(self, state: State) -> dict[tuple[str, int], Value]:
        """What sensors would say if they were ideal, by channel and place of the joint."""
        out = {}
        for channel, i in self.reading_keys():
            out[channel, i] = getattr(self.model.signals(state, i, self.u[i]), channel)
        return out

    def read(self, key: tuple[str, int], value: Value) -> Value:
        channel, i = key
        return self.model.flows[i].read(channel, Signals(t=self.t), value)


def _with_symbols(joint: Joint, symbols: Mapping[str, ca.SX]) -> Joint:
    """The joint with symbols for its drive's numbers; a rigid one keeps its infinite stiffness."""
    numbers = {name: getattr(joint.drive, name) for name in DRIVE_KEYS}
    for name, key in DRIVE_KEYS.items():
        numbers[name] = symbols.get(f"drive.{joint.name}.{key}", numbers[name])
    return replace(joint, drive=Drive(**numbers))


def _symbolic_spring(name: str, symbols: Mapping[str, ca.SX]) -> VariableSpring:
    stiffness, damping = symbols[f"spring.{name}.stiffness"], symbols[f"spring.{name}.damping"]
    return VariableSpring(lambda _t: stiffness, lambda _t: damping)


def _freed(planned: Planned, symbols: Mapping[str, ca.SX]) -> Planned:
    """The effect with symbols for its numbers."""
    given: dict[str, Any] = {}
    for param in planned.effect.params:
        own = [symbols[label] for label in labels(planned, param.name, param.size)]
        given[param.name] = own[0] if param.size == 1 else tuple(own)
    return planned.with_values(given)


def _body_of(model: pin.Model, symbols: Mapping[str, ca.SX]) -> Callable[..., SymbolicBody]:
    """SymbolicBody whose inertial parameters are symbols unless it is given others."""
    rows = [
        [symbols[f"body.{model.names[k]}.{key}"] for key in INERTIAL_KEYS] for k in range(1, model.njoints)
    ]
    free = ca.blockcat(rows)

    def build(model: pin.Model, inertial: Any = None, gravity: Any = None) -> SymbolicBody:
        return SymbolicBody(model, free if inertial is None else inertial, gravity)

    return build
