"""Exact derivatives of a simulation by its start, its parameters and torques: forward along the steps.

The step is the symbolic one of the default scheme, differentiated by CasADi as it branches: exact where a
motion does not lie on a switch (a turn of dry friction, an end of a play), which no short step does as a
rule. Many windows are simulated side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np

from flexjoint.core.ops import Value
from flexjoint.effects import Effect, Parameter, Planned, Signals, Site
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.simulation.compiled.functions import compiled, compiling_pays
from flexjoint.simulation.schemes import make_step
from flexjoint.simulation.schemes.discrete import DiscreteModel

# measured on TX40, KR300, UR5 and a planar arm of two joints
BY_ONE = 0.6  # operations of a derivative by one number, 0.34 to 0.87 of those of the step itself
INTERPRETED, COMPILED = 4.5e-9, 5e-10  # s an operation of CasADi's virtual machine, and of compiled code
PRODUCT = 1e-10  # s a multiplication of matrices takes, for each product in it


class LinkLoad(Effect):
    """A torque on the link that is given step by step (not a cause: an input of the simulation)."""

    site = Site.LINK
    params = (Parameter("torque", "N m", r"\tau", value=0.0, low=-1e12, high=1e12),)

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.torque


def link_load(joint: str) -> Planned:
    """The load input of a joint, for the effects of a symbolic model."""
    return Planned(LinkLoad(), joint, {"torque": 0.0})


@dataclass(frozen=True)
class Inputs:
    """W windows of J steps: start (W, nx) in the order of `SymbolicModel.state_names`, time (W,) [s] from the
    recording's start, torque and load (W, J, n) on motors and links [N m]."""

    start: np.ndarray
    time: np.ndarray
    torque: np.ndarray
    load: np.ndarray


@dataclass(frozen=True)
class Directions:
    """C directions in which a simulation is differentiated: what a unit of each changes of the start (nx, C),
    of the varied parameters (V, C), of the motor torques at each step (W, J, n, C), and of the inertial
    parameters (10 n, C) of the actuated joints' links, in their order and Pinocchio's; None for nothing.
    """

    start: np.ndarray
    parameters: np.ndarray
    torque: np.ndarray | None = None
    inertial: np.ndarray | None = None


@dataclass(frozen=True)
class Run:
    """Readings (W, J + 1, m) at the steps, and their derivatives (W, J + 1, m, C) where asked for."""

    readings: np.ndarray
    by: np.ndarray


@dataclass(frozen=True)
class _Step:
    """Expressions: a step's inputs, what it makes of them (state and readings), and by which of the
    parameters it is differentiated."""

    x: Any
    u: Any
    p: Any
    t: Any
    h: Any
    after: Any
    y: Any
    varied: Any
    loads: Any

    @property
    def numbers(self) -> int:
        """By how many the step is differentiated."""
        return sum(int(a.numel()) for a in (self.x, self.u, self.loads, self.varied))

    @cached_property
    def operations(self) -> int:
        inputs = [self.x, self.u, self.p, self.t, self.h]
        return int(ca.Function("step", inputs, ca.cse([self.after, self.y])).n_instructions())


class StepDerivatives:
    """One step of a symbolic model with its readings and derivatives, for many windows at once.

    Delays are not in the step: who needs them shifts the torques and reads the readings later.

    Args:
        symbolic: the model; its effects hold a `link_load` for every joint, in the joints' order.
        varied: parameters by which the step is differentiated, of `symbolic.parameters`.
        readings: channel.joint of the readings wanted, of `symbolic.reading_names`.
        steps: how many evaluations are to be expected, which decides whether compiling pays.
    """

    def __init__(
        self,
        symbolic: SymbolicModel,
        varied: Sequence[str],
        readings: Sequence[str],
        steps: int,
    ) -> None:
        self.symbolic, self.varied = symbolic, tuple(varied)
        h = ca.SX.sym("h")
        advance = make_step(symbolic.model, cast(Any, h))  # the schemes only compute with it
        discrete = DiscreteModel(symbolic, symbolic.robot.rates.physics)
        self.nx, self.size, self.n = symbolic.model.nx, discrete.plain, len(symbolic.robot.joints)
        names = [f"link_load.{joint.name}.torque" for joint in symbolic.model.joints]
        self._loads = [symbolic.parameters.index(name) for name in names]
        places = [symbolic.parameters.index(name) for name in varied]
        x, p = ca.SX.sym("x", self.size), symbolic.p
        state = discrete.unpack(x)
        stepped = advance(state, symbolic.u)
        after = ca.vertcat(symbolic.model.pack(stepped), stepped.acc, stepped.ddtheta, stepped.tau_rigid)
        true = symbolic.true(state)
        keys = dict(zip(symbolic.reading_names, symbolic.reading_keys(), strict=True))
        y = ca.vertcat(ca.SX(0, 1), *(symbolic.read(keys[r], true[keys[r]]) for r in readings))
        self._step = _Step(x, symbolic.u, p, symbolic.t, h, after, y, p[places], p[self._loads])
        self._steps = steps
        self._calls: dict[int, _Call] = {}
        self._body = PinBody(symbolic.robot.model)
        joints = symbolic.robot.joints
        self._rows = [joint.idx_v for joint in joints]
        self._columns = np.concatenate([10 * (joint.pin_id - 1) + np.arange(10) for joint in joints])

    def cost(self, columns: int) -> float:
        """[s] of a core, about, for one step of one window in so many directions; known before the
        derivatives are made, which takes seconds."""
        operations = round(BY_ONE * self._step.numbers * self._step.operations)
        each = COMPILED if compiling_pays(operations, self._steps) else INTERPRETED
        return each * operations + PRODUCT * self.size**2 * columns

    @cached_property
    def _functions(self) -> list[ca.Function]:
        """Derivatives by the state, and by all else: two programs are compiled side by side, each in less
        than half the time, and share little."""
        step = self._step
        by_step = [ca.jacobian(step.after, a) for a in (step.x, step.u, step.loads, step.varied)]
        by_reading = [ca.jacobian(step.y, a) for a in (step.x, step.varied)]
        first: Any = [step.after, by_step[0], step.y, by_reading[0]]  # the stubs know less than CasADi
        second: Any = [*by_step[1:], by_reading[1]]
        inputs = [step.x, step.u, step.p, step.t, step.h]
        functions = [
            ca.Function(f"flexjoint_by_{name}", inputs, [ca.densify(out) for out in ca.cse(outputs)])
            for name, outputs in (("state", first), ("inputs", second))
        ]
        pays = compiling_pays(sum(f.n_instructions() for f in functions), self._steps)
        return compiled(functions) if pays else functions

    def run(self, inputs: Inputs, numbers: np.ndarray, directions: Directions, rate: float) -> Run:
        """Simulate all windows at `rate` [Hz] with the parameters `numbers` (np,), with derivatives."""
        count, steps, _ = inputs.torque.shape
        call = self._call(count)
        x, u, p, t = call.x, call.u, call.p, call.t
        x[:], p[:], call.h[:] = 0.0, numbers, 1.0 / rate
        x[:, : self.nx] = inputs.start
        s = np.zeros((count, self.size, directions.start.shape[1]))
        s[:, : self.nx] = directions.start
        moved = np.flatnonzero(np.any(directions.parameters, axis=0))
        by_parameters = directions.parameters[:, moved]
        turned = np.zeros(0, int)
        if directions.inertial is not None:
            turned = np.flatnonzero(np.any(directions.inertial, axis=0))
            by_inertial = directions.inertial[:, turned]
        readings = np.empty((count, steps + 1, call.y.shape[1]))
        by = np.empty((*readings.shape, s.shape[2]))
        for k in range(steps + 1):
            j = min(k, steps - 1)  # the readings after the last step need no torque of their own
            u[:], t[:, 0] = inputs.torque[:, j], inputs.time + k / rate
            p[:, self._loads] = inputs.load[:, j]
            call.evaluate()
            readings[:, k] = call.y[:, :, 0]
            by[:, k] = call.y_by_x @ s
            by[:, k, :, moved] += (call.y_by_p @ by_parameters).transpose(2, 0, 1)
            if k == steps:
                break
            s = call.by_x @ s
            s[:, :, moved] += call.by_p @ by_parameters
            if directions.torque is not None:
                s += call.by_u @ directions.torque[:, j]
            if turned.size:
                along = self._regressor(x, call.after[:, :, 0], rate)
                s[:, :, turned] -= call.by_load @ (along @ by_inertial)
            x[:] = call.after[:, :, 0]
        return Run(readings, by)

    def _regressor(self, x: np.ndarray, after: np.ndarray, rate: float) -> np.ndarray:
        """(W, n, 10 n) derivative of the links' torques by their inertial parameters at a step's midpoint.
        M a + nle is linear in them (Atkeson, An and Hollerbach 1986): a change acts as a load of minus that.
        """
        nq, nv = self._body.nq, self._body.nv
        v, later = x[:, nq : nq + nv], after[:, nq : nq + nv]
        q = 0.5 * (x[:, :nq] + after[:, :nq])
        full = self._body.regressor_batch(q, 0.5 * (v + later), (later - v) * rate)
        return np.asarray(full[:, self._rows][:, :, self._columns])

    def _call(self, count: int) -> _Call:
        if count not in self._calls:
            self._calls[count] = _Call(self._functions, count)
        return self._calls[count]


class _Call:
    """The step for `count` windows at once, on arrays that it reads and writes in place: inputs (W, rows),
    outputs (W, rows, columns)."""

    def __init__(self, functions: Sequence[ca.Function], count: int) -> None:
        shared = functions[0]
        inputs = [np.zeros((count, shared.size1_in(k))) for k in range(shared.n_in())]
        self.x, self.u, self.p, self.t, self.h = inputs
        self._bound = [_bound(function, inputs) for function in functions]
        state, others = (views for _, _, views in self._bound)
        self.after, self.by_x, self.y, self.y_by_x = state
        self.by_u, self.by_load, self.by_p, self.y_by_p = others

    def evaluate(self) -> None:
        for _, evaluate, _ in self._bound:
            evaluate()


def _bound(
    function: ca.Function, inputs: Sequence[np.ndarray]
) -> tuple[Any, Callable[[], None], list[np.ndarray]]:
    """A function that reads these arrays: its buffer (which must live as long as they are used), what
    evaluates it, and what it writes to."""
    count = len(inputs[0])
    buffer: Any
    buffer, evaluate = function.map(count).buffer()
    for k, table in enumerate(inputs):
        buffer.set_arg(k, table.data)
    views = []
    for k in range(function.n_out()):
        # CasADi's matrices are stored by columns, those of all windows side by side
        block = np.zeros((count, function.size2_out(k), function.size1_out(k)))
        buffer.set_res(k, block.data)
        views.append(block.transpose(0, 2, 1))
    return buffer, evaluate, views


class Delays:
    """Dead times of commands and readings as functions of the parameters, with derivatives."""

    def __init__(
        self, symbolic: SymbolicModel, keys: Sequence[tuple[str, str]], varied: Sequence[str]
    ) -> None:
        flows, names = symbolic.model.flows, symbolic.model.robot.joint_names
        late: list[Value] = [flow.command_delay() for flow in flows]
        late += [flows[names.index(joint)].reading_delay(channel) for channel, joint in keys]
        places = [symbolic.parameters.index(name) for name in varied]
        column = ca.densify(ca.SX(ca.vertcat(*late)))
        by = ca.densify(ca.jacobian(column, symbolic.p[places]))
        self._function = ca.Function("delays", [symbolic.p], [column, by])
        self._joints = len(flows)

    def command(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) [s] and by the varied parameters."""
        late, by = (out.full() for out in self._function(numbers))
        return late[: self._joints, 0], by[: self._joints]

    def readings(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) [s] and by the varied parameters."""
        late, by = (out.full() for out in self._function(numbers))
        return late[self._joints :, 0], by[self._joints :]
