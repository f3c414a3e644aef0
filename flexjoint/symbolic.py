"""The same model as named casadi.Functions of state, motor torque, effect parameters and time.

Nothing is written twice: `FlexibleJointModel` and the default scheme run on CasADi SX over `SymbolicBody`.
Effects count as always on (`since` belongs to a recording).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexjoint.effect import SENSOR_CHANNELS, Planned, Signals
from flexjoint.errors import ModelError, unknown
from flexjoint.midpoint import Midpoint
from flexjoint.model import FlexibleJointModel, State
from flexjoint.ops import Value
from flexjoint.robot import Robot
from flexjoint.symbolic_body import SymbolicBody


@dataclass(frozen=True)
class Delay:
    """A ring buffer in the discrete state: the last `rows` values of a joint's command or true signal."""

    channel: str  # tau_m, or the sensor's channel
    joint: int
    rows: int
    begin: int  # place of the latest value in the discrete state


class SymbolicModel:
    """A robot with effects as CasADi Functions.

    Inputs everywhere: x, u (n,) motor torques [N m], p (np,) effect parameters in the order of
    `parameters`, t [s]. `parameters` names them effect.joint.name (joint `robot` for the whole robot);
    `values` (np,) holds their numbers.

    Raises what FlexibleJointModel and SymbolicBody raise.
    """

    def __init__(self, robot: Robot, effects: Iterable[Planned] | None = None) -> None:
        planned = tuple(robot.effects if effects is None else effects)
        names: list[str] = []
        numbers: list[float] = []
        symbols: list[ca.SX] = []
        free = []
        for item in planned:
            given: dict[str, Any] = {}
            for param in item.effect.params:
                value = getattr(item.p, param.name)
                entries = [value] if param.size == 1 else list(value)
                label = f"{item.effect.name}.{item.joint or 'robot'}.{param.name}"
                labels = [label] if param.size == 1 else [f"{label}[{k}]" for k in range(param.size)]
                own = [ca.SX.sym(name) for name in labels]
                names += labels
                numbers += [float(x) for x in entries]
                symbols += own
                given[param.name] = own[0] if param.size == 1 else tuple(own)
            free.append(item.with_values(given))
        self.parameters: tuple[str, ...] = tuple(names)
        self.values: np.ndarray = np.array(numbers)
        self.model = FlexibleJointModel(robot, free, SymbolicBody)
        self._p = ca.vertcat(ca.SX(0, 1), *symbols)
        self._u = ca.SX.sym("u", len(robot.joints))
        self._t = ca.SX.sym("t")

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
        return self._function("dynamics", x, self.model.rhs(x, self._u, width, self._t), "dx")

    def measure(self) -> ca.Function:
        """measure(x, u, p, t) -> y, the sensors' readings in the order of `reading_names`, delays aside."""
        x = ca.SX.sym("x", self.model.nx)
        state = self.model.unpack(x, self._t)
        y = [self._read(key, self._true(state)[key]) for key in self._reading_keys()]
        return self._function("measure", x, ca.vertcat(*y), "y")

    # --- discrete --------------------------------------------------------------------------------
    def discrete(self, rate: float) -> DiscreteModel:
        """The default scheme at `rate` steps per second [Hz], delays included."""
        if not rate > 0.0:
            raise ModelError(f"rate: expected steps per second > 0, got {rate}")
        return DiscreteModel(self, rate)

    # --- shared ----------------------------------------------------------------------------------
    def _function(self, name: str, x: ca.SX, out: ca.SX, label: str) -> ca.Function:
        inputs = [x, self._u, self._p, self._t]
        return ca.Function(name, inputs, [ca.cse(ca.densify(out))], ["x", "u", "p", "t"], [label])

    def _reading_keys(self) -> list[tuple[str, int]]:
        names = self.model.robot.joint_names
        pairs = [name.split(".", 1) for name in self.reading_names]
        return [(channel, names.index(joint)) for channel, joint in pairs]

    def _true(self, state: State) -> dict[tuple[str, int], Value]:
        out = {}
        for channel, i in self._reading_keys():
            out[channel, i] = getattr(self.model.signals(state, i, self._u[i]), channel)
        return out

    def _read(self, key: tuple[str, int], value: Value) -> Value:
        channel, i = key
        return self.model.flows[i].read(channel, Signals(t=self._t), value)


class DiscreteModel:
    """One step of the default scheme and its measurement.

    The discrete state holds the continuous state, what the scheme remembers (acc, ddtheta, tau_rigid) and,
    per delay, the latest commands or true signals, newest first (`delays`). They are read by linear
    interpolation, so derivatives by a delay exist.
    """

    def __init__(self, symbolic: SymbolicModel, rate: float) -> None:
        self.symbolic, self.rate = symbolic, rate
        model = symbolic.model
        self._plain = model.nx + model.nv + model.nf + len(model.rigid)
        delays: list[Delay] = []
        begin = self._plain
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

    def start(self, state: State, tau_m: np.ndarray) -> np.ndarray:
        """The discrete state of a numeric state before which it and tau_m (n,) have held."""
        model = self.symbolic.model
        numeric = FlexibleJointModel(model.robot, [self._planned(e) for e in model.effects])
        parts = [numeric.pack(state), state.acc, state.ddtheta, state.tau_rigid]
        for delay in self.delays:
            value = tau_m[delay.joint]
            if delay.channel != "tau_m":
                value = getattr(numeric.signals(state, delay.joint, value), delay.channel)
            parts.append(np.full(delay.rows, value))
        return np.concatenate(parts)

    def _planned(self, free: Planned) -> Planned:
        """The effect with its symbols replaced by their numbers."""
        numbers: dict[str, Any] = {}
        table = dict(zip(self.symbolic.parameters, self.symbolic.values.tolist(), strict=True))
        label = f"{free.effect.name}.{free.joint or 'robot'}"
        for param in free.effect.params:
            name = f"{label}.{param.name}"
            if param.size == 1:
                numbers[param.name] = table[name]
            else:
                numbers[param.name] = tuple(table[f"{name}[{k}]"] for k in range(param.size))
        return free.with_values(numbers)

    def step(self) -> ca.Function:
        """step(x, u, p, t) -> x_next of the discrete state x."""
        symbolic, model = self.symbolic, self.symbolic.model
        x = ca.SX.sym("x", self.size)
        state = self._unpack(x)
        u = ca.SX(symbolic._u)
        shifted = []
        for delay in self.delays:
            if delay.channel == "tau_m":
                newest: Value = symbolic._u[delay.joint]
                late = model.flows[delay.joint].command_delay()
                u[delay.joint] = self._earlier(newest, x, delay, late)
            else:
                newest = symbolic._true(state)[delay.channel, delay.joint]
            shifted += [newest, x[delay.begin : delay.begin + delay.rows - 1]]
        after = Midpoint(model, 1.0 / self.rate).step(state, u)
        out = ca.vertcat(model.pack(after), after.acc, after.ddtheta, after.tau_rigid, *shifted)
        return symbolic._function("step", x, out, "x_next")

    def measure(self) -> ca.Function:
        """measure(x, u, p, t) -> y of the discrete state x, sensor delays included."""
        symbolic = self.symbolic
        x = ca.SX.sym("x", self.size)
        true = symbolic._true(self._unpack(x))
        for delay in self.delays:
            if delay.channel != "tau_m":
                key = delay.channel, delay.joint
                late = symbolic.model.flows[delay.joint].reading_delay(delay.channel)
                true[key] = self._earlier(true[key], x, delay, late)
        y = [symbolic._read(key, true[key]) for key in symbolic._reading_keys()]
        return symbolic._function("measure", x, ca.vertcat(*y), "y")

    def _unpack(self, x: ca.SX) -> State:
        model = self.symbolic.model
        state = model.unpack(x[: model.nx], self.symbolic._t)
        acc, ddtheta = model.nx + model.nv, model.nx + model.nv + model.nf
        state.acc, state.ddtheta = x[model.nx : acc], x[acc:ddtheta]
        state.tau_rigid = x[ddtheta : self._plain]
        return state

    def _earlier(self, newest: Value, x: ca.SX, delay: Delay, seconds: Value) -> ca.SX:
        """The buffered value `seconds` ago: every row weighted by a hat function of its distance."""
        rows = ca.vertcat(newest, x[delay.begin : delay.begin + delay.rows])
        distance = ca.fabs(seconds * self.rate - np.arange(delay.rows + 1))
        return ca.dot(rows, ca.fmax(1.0 - distance, 0.0))
