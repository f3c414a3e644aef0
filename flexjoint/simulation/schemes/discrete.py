"""A step of a scheme and its measurement as casadi.Functions with delays: to use, save or export as C."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from flexjoint.core.errors import ModelError
from flexjoint.core.files import write_text
from flexjoint.core.functions import c_source, renamed
from flexjoint.core.ops import Value
from flexjoint.effects import SENSOR_CHANNELS
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.simulation.schemes.base import DEFAULT
from flexjoint.simulation.schemes.catalogue import make_step


@dataclass(frozen=True)
class Delay:
    """A ring buffer in the discrete state: the last `rows` values of a joint's command or true signal."""

    channel: str  # tau_m, or the sensor's channel
    joint: int
    rows: int
    begin: int  # place of the latest value in the discrete state


class DiscreteModel:
    """One step of a scheme and its measurement.

    The discrete state holds the continuous state, what the default scheme remembers (acc, ddtheta,
    tau_rigid) and, per delay, the latest commands or true signals, newest first (`delays`). They are read
    by linear interpolation, so derivatives by a delay exist. `state_names` names its entries.

    Args:
        rate: steps per second [Hz]. scheme, width: see `flexjoint.simulation.schemes`; delays are included.

    Raises ModelError, UnknownNameError or SimulationError for a rate, scheme or width that is none.
    """

    def __init__(
        self, symbolic: SymbolicModel, rate: float, scheme: str = DEFAULT, width: float | None = None
    ) -> None:
        if not rate > 0.0:
            raise ModelError(f"rate: expected steps per second > 0, got {rate}")
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
        """The discrete state of a numeric state; before it, it and tau_m (n,) were constant."""
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
