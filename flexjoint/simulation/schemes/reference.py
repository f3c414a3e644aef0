"""Tight reference solutions, to measure other schemes by: adaptive, error-controlled, restarted at kinks.

`reference` is a scheme like the others: the motor torque is held over a step, and each step is solved anew,
so a control tick is never stepped over. `continuous_control` closes the loop without ticks: the law acts at
every instant, the solver stops and restarts where a torque enters or leaves saturation and where the
reference jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np
from scipy.integrate import DOP853, LSODA, Radau
from scipy.optimize import brentq

from flexjoint.core.errors import ModelError, SimulationError
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.simulation.schemes.base import Scheme, Step, exact_matrix
from flexjoint.simulation.schemes.modes import linearised

RTOL, ATOL = 1e-11, 1e-12  # of the explicit solver
LOOSER = 1e2  # on both tolerances of the implicit solver, whose Newton iterations end at rounding
STIFF = 30.0  # max |lambda| h above which an explicit solver takes many steps within h
FIRST = 1e-3  # [s] first step that continuous control tries after a restart
LOOKS = 2  # places within a solver's step where saturation is looked for
SAME_TIME = 1e-12  # [s]
AFTER = 2e-9  # [s] right after a jump, beyond what `flexjoint.simulation.references` counts as its time
Method = Literal["auto", "DOP853", "Radau", "LSODA"]
SOLVERS: Mapping[str, Any] = {"DOP853": DOP853, "Radau": Radau, "LSODA": LSODA}
References = Callable[[float], Mapping[str, np.ndarray]]


class Reference(Scheme):
    """Each step by an adaptive solver at rtol 1e-11 (DOP853), where it is stiff by an implicit one (Radau,
    rtol 1e-9). Numbers only; dry friction is smoothed over `width` [rad/s].

    A step raises SimulationError when the solver gives up.
    """

    name = "reference"
    order = None
    any_stiffness = True
    adaptive = True

    def __init__(self, method: Method = "auto") -> None:
        self.method: Method = method

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        if model.symbolic:
            raise ModelError(
                f"{self.name} adapts its steps, which expressions cannot; use rk4 with small steps"
            )
        chosen: list[str] = []

        def step(x: State, tau_m: Value) -> State:
            if not chosen:
                chosen.append(_method(model, x, h, self.method))
            flow = _Flow(model, x, width, lambda _t, _state: tau_m)
            solver = _solver(chosen[0], flow, x.t, flow.start, x.t + h, h)
            while solver.status == "running":
                _advance(solver)
            return flow.state(x.t + h, solver.y)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        return exact_matrix(A, h)


class SaturatingLaw(Protocol):
    """What `continuous_control` needs of a law: the torque before saturation, and its limit (n,)."""

    reads: Any
    limit: Value

    def demand(self, reference: Mapping[str, Value], reading: Mapping[str, Value]) -> Value: ...


@dataclass(frozen=True)
class Continuous:
    """A continuous-control solution at times (N,) [s]: states (N, nx) in the order of `state_names`, motor
    torques tau_m (N, n), transmission torques tau_t (N, n) [N m], and how long each torque was saturated
    (n,) [s]."""

    time: np.ndarray
    x: np.ndarray
    tau_m: np.ndarray
    tau_t: np.ndarray
    saturated: np.ndarray


def continuous_control(
    model: FlexibleJointModel,
    start: State,
    law: SaturatingLaw,
    references: References,
    times: np.ndarray,
    breaks: Sequence[float] = (),
    width: float | None = None,
    method: Method = "auto",
) -> Continuous:
    """The loop closed at every instant; sensing delays and delayed commands are refused.

    Args:
        references: q_ref, theta_ref, dtheta_ref, tau_ff, each (n,), at a time [s]; at a break the value from
            its left.
        times: (N,) increasing, from start.t on, where the solution is wanted.
        breaks: times at which the references jump.

    Raises:
        ModelError: the model delays commands or readings. SimulationError: the solver gives up.
    """
    _refuse_delays(model)
    times = np.asarray(times, dtype=float)
    loop = _Loop(model, law, references)
    flow = _Flow(model, start, width, loop.torque)
    chosen = _method(model, start, FIRST, method)
    rows: list[np.ndarray] = []
    y, t, k = flow.start, start.t, 0
    inner = sorted(b for b in breaks if start.t < b < times[-1])
    saturated = np.zeros(len(model.joints))
    for until in [*inner, float(times[-1])]:
        loop.after(t)
        loop.mode = loop.modes(t, flow.state(t, y))
        while t < until - SAME_TIME:
            solver = _solver(chosen, flow, t, y, until, FIRST)
            while solver.status == "running":
                _advance(solver)
                dense = solver.dense_output()  # also of a step without rows: an event may lie within
                event = _event(loop, flow, dense, solver.t_old, solver.t)
                reached = solver.t if event is None else event[0]
                while k < len(times) and times[k] <= reached + SAME_TIME:
                    row = dense(min(times[k], reached)) if times[k] > solver.t_old else solver.y_old
                    rows.append(loop.row(times[k], flow.state(times[k], row)))
                    k += 1
                saturated += (loop.mode != 0) * (reached - solver.t_old)
                t, y = reached, solver.y.copy() if event is None else dense(reached)
                if event is not None:
                    loop.mode[event[1]] = event[2]
                    break
    table = np.array(rows)
    n, nx = len(model.joints), model.nx
    return Continuous(times, table[:, :nx], table[:, nx : nx + n], table[:, nx + n :], saturated)


class _Loop:
    """The law on the true state, with each torque's saturation (-1, 0, 1) held until an event says so."""

    def __init__(self, model: FlexibleJointModel, law: SaturatingLaw, references: References) -> None:
        self.model, self.law, self.references = model, law, references
        self.limit = np.broadcast_to(np.asarray(law.limit, dtype=float), (len(model.joints),))
        self.mode = np.zeros(len(model.joints), dtype=int)
        self._from = -np.inf

    def after(self, t: float) -> None:
        """From now on the references are those right after t, where one may have jumped."""
        self._from = t

    def demand(self, t: float, x: State) -> np.ndarray:
        seen = self._from + AFTER if t <= self._from + AFTER else t
        return np.asarray(self.law.demand(self.references(seen), self._reading(x)))

    def torque(self, t: float, x: State) -> np.ndarray:
        wanted = self.demand(t, x)
        return np.where(self.mode == 0, wanted, self.mode * np.where(self.mode == 0, 0.0, self.limit))

    def modes(self, t: float, x: State) -> np.ndarray:
        wanted = self.demand(t, x)
        return np.where(wanted > self.limit, 1, np.where(wanted < -self.limit, -1, 0))

    def row(self, t: float, x: State) -> np.ndarray:
        """State, motor and transmission torques at a time, references from the left."""
        tau = np.clip(self.law.demand(self.references(t), self._reading(x)), -self.limit, self.limit)
        tau_t = self.model.rates(x, tau, None).tau_t
        return np.concatenate([self.model.pack(x), tau, tau_t])

    def _reading(self, x: State) -> dict[str, np.ndarray]:
        model, n = self.model, len(self.model.joints)
        out = {name: np.empty(n) for name in self.law.reads}
        for i, flow in enumerate(model.flows):
            s = model.signals(x, i, 0.0)
            for name, values in out.items():
                values[i] = flow.read(name, Signals(t=x.t), getattr(s, name))
        return out


def _event(loop: _Loop, flow: _Flow, dense: Any, begin: float, end: float) -> tuple[float, int, int] | None:
    """The first change of saturation within a solver's step: time, joint, and the mode after it."""

    def beyond(t: float, i: int, side: int) -> float:
        return float(side * loop.demand(t, flow.state(t, dense(t)))[i] - loop.limit[i])

    looks = np.linspace(begin, end, LOOKS + 1)
    for low, high in pairwise(looks):
        wanted = loop.demand(high, flow.state(high, dense(high)))
        found = []
        for i, mode in enumerate(loop.mode):
            side = int(mode) if mode else (1 if wanted[i] >= 0.0 else -1)
            over = side * wanted[i] - loop.limit[i]
            if (over < 0.0) == (mode == 0) or over == 0.0:
                continue
            at_low = beyond(low, i, side)
            crossed = at_low * over < 0.0
            when = brentq(beyond, low, high, (i, side), xtol=1e-14, rtol=1e-14) if crossed else high
            found.append((max(float(when), begin + SAME_TIME), i, 0 if mode else side))
        if found:
            return min(found)
    return None


class _Flow:
    """dy/dt of a model from a state on: y = (xi, v, theta, dtheta, z), where q = q0 integrated by xi (which
    is q - q0 where every joint has one axis)."""

    def __init__(
        self,
        model: FlexibleJointModel,
        x: State,
        width: float | None,
        torque: Callable[[float, State], np.ndarray],
    ) -> None:
        self.model, self.origin, self.width, self.torque = model, x, width, torque
        self.flat = model.nq == model.nv
        nv, nf = model.nv, model.nf
        ends = np.cumsum([0, nv, nv, nf, nf, model.nz])
        self.parts = [slice(*ends[k : k + 2]) for k in range(5)]
        self.start = np.concatenate([np.zeros(nv), x.v, x.theta, x.dtheta, x.z])

    def state(self, t: float, y: np.ndarray) -> State:
        xi, v, theta, dtheta, z = (y[part] for part in self.parts)
        q = self.origin.q + xi if self.flat else self.model.body.integrate(self.origin.q, xi)
        x = self.origin
        return State(t, q, v, theta, dtheta, z, x.acc, x.ddtheta, x.tau_rigid)

    def __call__(self, t: float, y: np.ndarray) -> np.ndarray:
        x = self.state(t, y)
        r = self.model.rates(x, self.torque(t, x), self.width)
        rate = r.v
        if not self.flat:
            slope = self.model.body.integrate_slope(self.origin.q, y[: self.model.nv])
            rate = np.linalg.solve(slope, r.v)
        return np.concatenate([rate, r.acc, r.dtheta, r.ddtheta, r.dz])


def _method(model: FlexibleJointModel, x: State, h: float, method: Method) -> str:
    if method != "auto":
        return method
    fastest = np.max(np.abs(np.linalg.eigvals(linearised(model, x))))
    return "Radau" if fastest * h > STIFF else "DOP853"


def _solver(method: str, flow: _Flow, t: float, y: np.ndarray, until: float, first: float) -> Any:
    loose = 1.0 if method == "DOP853" else LOOSER
    return SOLVERS[method](
        flow, t, y, until, rtol=loose * RTOL, atol=loose * ATOL, first_step=min(first, until - t)
    )


def _advance(solver: Any) -> None:
    solver.y_old = solver.y.copy()
    message = solver.step()
    if solver.status == "failed":
        raise SimulationError(
            f"the reference solver gave up at t = {solver.t:.6g} s: {message or 'its step became too small'};"
            " check the effects' parameters, or widen the smoothing of dry friction"
        )


def _refuse_delays(model: FlexibleJointModel) -> None:
    if longest_delay(model) > 0.0:
        raise ModelError(
            "continuous control cannot have delays: take delays of command, sensors and `sensing_delay` out"
            " of the robot, or use closed_loop with the scheme reference"
        )
    if model.ground is not None:
        raise ModelError(
            "continuous control cannot have contacts, whose anchors slip between steps: use closed_loop with"
            " the scheme reference"
        )
