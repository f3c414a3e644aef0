"""The same model as named casadi.Functions of state, motor torque, parameters and time.

Nothing is written twice: `FlexibleJointModel` and the schemes of `integrate` run on CasADi SX over
`SymbolicBody`. Effects count as always on (`since` belongs to a recording) unless a time is given.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.c_code import c_source, renamed
from flexjoint.effect import SENSOR_CHANNELS, Drive, Planned, Signals
from flexjoint.errors import ModelError, unknown
from flexjoint.files import write_text
from flexjoint.integrate import DEFAULT, make_step
from flexjoint.model import FlexibleJointModel, State
from flexjoint.ops import Value
from flexjoint.parameters import DRIVE_KEYS, FREE, INERTIAL_KEYS, labels, parameter_table
from flexjoint.robot import Joint, Robot
from flexjoint.springs import VariableSpring
from flexjoint.symbolic_body import SymbolicBody


@dataclass(frozen=True)
class Delay:
    """A ring buffer in the discrete state: the last `rows` values of a joint's command or true signal."""

    channel: str  # tau_m, or the sensor's channel
    joint: int
    rows: int
    begin: int  # place of the latest value in the discrete state


@dataclass(frozen=True)
class FreeJoint(Joint):
    """A joint whose drive holds symbols: whether it is rigid is no longer told by its stiffness."""

    is_rigid: bool = False

    @property
    def rigid(self) -> bool:
        return self.is_rigid


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
        free: Collection[str] = (),
        at: float = math.inf,
        springs: Mapping[str, VariableSpring] | None = None,
        commanded: Collection[str] = (),
    ) -> None:
        for name in free:
            if name not in FREE:
                raise unknown("free parameters", name, FREE)
        planned = tuple(robot.effects if effects is None else effects)
        table = parameter_table(robot.joints, planned, robot.model, free)
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
            {**(springs or {}), **{name: _held_spring(name, symbols) for name in commanded}},
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

    # --- discrete --------------------------------------------------------------------------------
    def discrete(self, rate: float, scheme: str = DEFAULT, width: float | None = None) -> DiscreteModel:
        """A scheme of `flexjoint.integrate` at `rate` steps per second [Hz], delays included.

        Raises ModelError, UnknownNameError or SimulationError for a rate, scheme or width that is none.
        """
        if not rate > 0.0:
            raise ModelError(f"rate: expected steps per second > 0, got {rate}")
        return DiscreteModel(self, rate, scheme, width)

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


def _with_symbols(joint: Joint, symbols: Mapping[str, ca.SX]) -> FreeJoint:
    numbers = {name: getattr(joint.drive, name) for name in DRIVE_KEYS}
    for name, key in DRIVE_KEYS.items():
        numbers[name] = symbols.get(f"drive.{joint.name}.{key}", numbers[name])
    own = {field.name: getattr(joint, field.name) for field in fields(joint)}
    return FreeJoint(**{**own, "drive": Drive(**numbers)}, is_rigid=joint.rigid)


def _held_spring(name: str, symbols: Mapping[str, ca.SX]) -> VariableSpring:
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


class DiscreteModel:
    """One step of a scheme and its measurement.

    The discrete state holds the continuous state, what the default scheme remembers (acc, ddtheta,
    tau_rigid) and, per delay, the latest commands or true signals, newest first (`delays`). They are read
    by linear interpolation, so derivatives by a delay exist. `state_names` names its entries.
    """

    def __init__(
        self, symbolic: SymbolicModel, rate: float, scheme: str = DEFAULT, width: float | None = None
    ) -> None:
        self.symbolic, self.rate, self.scheme, self.width = symbolic, rate, scheme, width
        self._advance = make_step(symbolic.model, 1.0 / rate, scheme, width)
        model = symbolic.model
        self.plain = model.nx + model.nv + model.nf + len(model.rigid)  # entries before those of delays
        delays: list[Delay] = []
        begin = self.plain
        for i, flow in enumerate(model.flows):
            longest = {"tau_m": flow.max_command_delay}
            longest |= {channel: flow.max_reading_delay(channel) for channel in SENSOR_CHANNELS}
            for channel, seconds in longest.items():
                if seconds > 0.0 and not (channel == "tau_t" and flow.joint.rigid):
                    rows = math.ceil(seconds * rate - 1e-9)
                    delays.append(Delay(channel, i, rows, begin))
                    begin += rows
        self.delays = tuple(delays)
        self.size = begin

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of the discrete state; `[k]` counts steps into the past."""
        model = self.symbolic.model
        names = [*model.state_names, *(f"acc[{k}]" for k in range(model.nv))]
        names += [f"ddtheta.{model.joints[i].name}" for i in model.flexible]
        names += [f"tau_t.{model.joints[i].name}" for i in model.rigid]
        for delay in self.delays:
            label = f"{delay.channel}.{model.joints[delay.joint].name}"
            names += [f"{label}[{k + 1}]" for k in range(delay.rows)]
        return tuple(names)

    def start(self, state: State, tau_m: np.ndarray) -> np.ndarray:
        """The discrete state of a numeric state before which it and tau_m (n,) have held."""
        symbolic = self.symbolic
        numeric = FlexibleJointModel(
            symbolic.robot, symbolic.effects, at=symbolic.at, springs=symbolic.springs
        )
        parts = [numeric.pack(state), state.acc, state.ddtheta, state.tau_rigid]
        for delay in self.delays:
            value = tau_m[delay.joint]
            if delay.channel != "tau_m":
                value = getattr(numeric.signals(state, delay.joint, value), delay.channel)
            parts.append(np.full(delay.rows, value))
        return np.concatenate(parts)

    def step(self) -> ca.Function:
        """step(x, u, p, t) -> x_next of the discrete state x."""
        symbolic, model = self.symbolic, self.symbolic.model
        x = ca.SX.sym("x", self.size)
        state = self.unpack(x)
        u = ca.SX(symbolic.u)
        shifted = []
        for delay in self.delays:
            if delay.channel == "tau_m":
                newest: Value = symbolic.u[delay.joint]
                late = model.flows[delay.joint].command_delay()
                u[delay.joint] = self._earlier(newest, x, delay, late)
            else:
                newest = symbolic.true(state)[delay.channel, delay.joint]
            shifted += [newest, x[delay.begin : delay.begin + delay.rows - 1]]
        return symbolic.function("step", x, ca.vertcat(self.advanced(state, u), *shifted), "x_next")

    def advanced(self, state: State, u: ca.SX) -> ca.SX:
        """The first `plain` entries of the discrete state a step later, under torques u that act at once."""
        return self.pack(self._advance(state, u))

    def pack(self, state: State) -> ca.SX:
        """The first `plain` entries of a discrete state, of a state."""
        return ca.SX(ca.vertcat(self.symbolic.model.pack(state), state.acc, state.ddtheta, state.tau_rigid))

    def measure(self) -> ca.Function:
        """measure(x, u, p, t) -> y of the discrete state x, sensor delays included."""
        symbolic = self.symbolic
        x = ca.SX.sym("x", self.size)
        true = symbolic.true(self.unpack(x))
        for delay in self.delays:
            if delay.channel != "tau_m":
                key = delay.channel, delay.joint
                late = symbolic.model.flows[delay.joint].reading_delay(delay.channel)
                true[key] = self._earlier(true[key], x, delay, late)
        y = [symbolic.read(key, true[key]) for key in symbolic.reading_keys()]
        return symbolic.function("measure", x, ca.vertcat(*y), "y")

    def unpack(self, x: ca.SX) -> State:
        """The state in the first `plain` entries of a discrete state."""
        model = self.symbolic.model
        state = model.unpack(x[: model.nx], self.symbolic.t)
        acc, ddtheta = model.nx + model.nv, model.nx + model.nv + model.nf
        state.acc, state.ddtheta = x[model.nx : acc], x[acc:ddtheta]
        state.tau_rigid = x[ddtheta : self.plain]
        return state

    def _earlier(self, newest: Value, x: ca.SX, delay: Delay, seconds: Value) -> ca.SX:
        """The buffered value `seconds` ago: every row weighted by a hat function of its distance."""
        rows = ca.vertcat(newest, x[delay.begin : delay.begin + delay.rows])
        distance = ca.fabs(seconds * self.rate - np.arange(delay.rows + 1))
        return ca.SX(ca.dot(rows, ca.fmax(1.0 - distance, 0.0)))

    # --- files -----------------------------------------------------------------------------------
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write step and measure with all names and numbers as JSON, for use without flexjoint:
        casadi.Function.deserialize(json.load(file)["step"])."""
        step, measure = self.step(), self.measure()
        table = {
            "step": step.serialize(),
            "measure": measure.serialize(),
            "rate": self.rate,
            "scheme": self.scheme,
            "x": self.state_names,
            "u": [joint.name for joint in self.symbolic.model.joints],
            "p": dict(zip(self.symbolic.parameters, self.symbolic.values.tolist(), strict=True)),
            "y": self.symbolic.reading_names,
        }
        write_text(Path(path), json.dumps(table, indent=1))

    def export_c(self, path: str | os.PathLike[str]) -> None:
        """Write flexjoint_step and flexjoint_measure as one C file without dependencies beyond the C
        library. Both take arg = {x, u, p, t} and res = {out} of doubles and return 0; the file's head
        lists the entries and the numbers of p."""
        functions = [
            renamed(function, f"flexjoint_{function.name()}") for function in (self.step(), self.measure())
        ]
        symbolic = self.symbolic
        numbers = [
            f"{name} = {value!r}"
            for name, value in zip(symbolic.parameters, symbolic.values.tolist(), strict=True)
        ]
        lists = {
            "x": self.state_names,
            "u": [joint.name for joint in symbolic.model.joints],
            "p": numbers,
            "y": symbolic.reading_names,
        }
        head = [f"/* {self.scheme} at {self.rate:g} Hz, SI, link-referred. Entries in their order:"]
        head += [f"   {label}: {', '.join(entries) or 'none'}" for label, entries in lists.items()]
        write_text(Path(path), "\n".join([*head, "*/", c_source(functions)]))
