"""Time stepping of the real machine: classical Runge-Kutta of order 4 between located events.

Within a step the modes of dry friction and gaps are fixed, so that the right-hand side is smooth; a step at
whose end a mode no longer holds is cut at that instant, found by bisection.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..robots import Robot
from .chain import Array
from .laws import Equations, Planted

EVENT_WIDTH = 1e-9  # s to which an event is located
MAX_EVENTS = 25  # per substep; beyond it the substep is finished in the modes it has


class _Compiled:
    """A CasADi function called on arrays that it owns, without conversions; columns become rows."""

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._run = function.buffer()
        self.inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self.outputs = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        for i, array in enumerate(self.inputs):
            if array.size:
                self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self.outputs):
            if array.size:
                self._buffer.set_res(i, memoryview(array))

    def __call__(self, *values: Array | float) -> list[Array]:
        """The outputs, overwritten by the next call."""
        for array, value in zip(self.inputs, values, strict=True):
            array[...] = value
        self._run()
        return self.outputs


class Machine:
    """The state of one real machine, advanced by control ticks of `substeps` steps of `step` seconds each."""

    def __init__(self, robot: Robot, effects: list[Planted], step: float, substeps: int) -> None:
        self.equations = equations = Equations(robot, effects)
        self.n, self.step, self.substeps = len(robot.joints), step, substeps
        self.switches = equations.switches
        self._point, self._one, self._tick = (_Compiled(f) for f in _functions(equations, step, substeps))
        self.x = np.concatenate([np.zeros(4 * self.n), equations.start])
        self.modes = np.zeros(len(self.switches))
        self.unfinished_events = 0

    def torque(self, u: Array, gates: Array, t: float) -> Array:
        """tau_t (n,) at the present state."""
        return self._point(self.x, u, self.modes, gates, t)[0][0].copy()

    def advance(self, u: Array, gates: Array, t: float) -> tuple[Array, Array]:
        """One control tick from time t: motor torques u (substeps, n), gates (substeps, effects).

        Returns the states (substeps, 5 n + m) and tau_t (substeps, n) at the end of each substep.
        """
        states, torques, starts, end = self._tick(self.x, u, self.modes, gates, t)
        broken = self.substeps
        if self.switches:
            if starts.min() < 0:
                wrong = np.flatnonzero((starts < 0).any(axis=1))
                broken = max(wrong[0] - 1, 0)  # what is wrong at a start happened in the substep before it
            elif end.min() < 0:
                broken = self.substeps - 1
        if broken == self.substeps:
            self.x = states[-1].copy()
            return states.copy(), torques.copy()
        states, torques = states.copy(), torques.copy()
        if broken:
            self.x = states[broken - 1].copy()
        for i in range(broken, self.substeps):
            self._careful(u[i], gates[i], t + i * self.step)
            states[i], torques[i] = self.x, self.torque(u[i], gates[i], t + (i + 1) * self.step)
        return states, torques

    def settle(self, u: Array, gates: Array, t: float) -> None:
        """Switch every mode that the present state and torque no longer allow."""
        for _ in range(2 * len(self.switches)):
            margin = self._point(self.x, u, self.modes, gates, t)[1][0]
            worst = int(np.argmin(margin))
            if margin[worst] >= 0:
                return
            self._switch(worst, u, gates, t)

    def _careful(self, u: Array, gates: Array, t: float) -> None:
        """One substep with its events."""
        self.settle(u, gates, t)
        left = self.step
        for _ in range(MAX_EVENTS):
            state, margin = self._one(self.x, u, self.modes, gates, t, left)
            if margin.min() >= 0:
                self.x = state[0].copy()
                return
            low, high = 0.0, left
            while high - low > EVENT_WIDTH:
                middle = (low + high) / 2
                low, high = (
                    (low, middle)
                    if self._one(self.x, u, self.modes, gates, t, middle)[1].min() < 0
                    else (middle, high)
                )
            state, margin = self._one(self.x, u, self.modes, gates, t, high)
            worst = int(np.argmin(margin[0]))
            self.x = state[0].copy()
            t, left = t + high, left - high
            self._switch(worst, u, gates, t)
            if left <= EVENT_WIDTH:
                return
        self.unfinished_events += 1
        self.x = self._one(self.x, u, self.modes, gates, t, left)[0][0].copy()

    def _switch(self, k: int, u: Array, gates: Array, t: float) -> None:
        switch = self.switches[k]
        if self.modes[k] != 0:
            self.modes[k] = 0
            if switch.kind == "gap":
                return
            sides = ("link", "motor") if self.equations.rigid[switch.joint] else (switch.kind,)
            for side in sides:
                self.x[{"link": self.n, "motor": 3 * self.n}[side] + switch.joint] = 0.0
            if self._point(self.x, u, self.modes, gates, t)[1][0, k] >= 0:
                return
        drive = self._point(self.x, u, self.modes, gates, t)[2][0, k]
        self.modes[k] = 1.0 if drive >= 0 else -1.0


def _functions(e: Equations, step: float, substeps: int) -> tuple[ca.Function, ca.Function, ca.Function]:
    """At a point: torque, margin, drive; one step of any length: state, margin; one tick: everything."""
    at = (e.x, e.u, e.modes, e.gates, e.t)
    point = ca.Function("point", at, [e.torque, e.margin, e.drive])
    rate = ca.Function("rate", at, [e.rate, e.margin])
    h = ca.SX.sym("h")
    k1, start = rate(*at)
    k2, _ = rate(e.x + h / 2 * k1, e.u, e.modes, e.gates, e.t + h / 2)
    k3, _ = rate(e.x + h / 2 * k2, e.u, e.modes, e.gates, e.t + h / 2)
    k4, _ = rate(e.x + h * k3, e.u, e.modes, e.gates, e.t + h)
    end = e.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    step_from = ca.Function("step_from", [*at, h], [end, start])
    one = ca.Function("one", [*at, h], [end, point(end, *at[1:4], e.t + h)[1]])

    x, modes, t = ca.MX.sym("x", *e.x.shape), ca.MX.sym("modes", *e.modes.shape), ca.MX.sym("t")
    u, gates = ca.MX.sym("u", e.u.numel(), substeps), ca.MX.sym("gates", e.gates.numel(), substeps)
    states, torques, starts, now = [], [], [], x
    for i in range(substeps):
        now, margin = step_from(now, u[:, i], modes, gates[:, i], t + i * step, step)
        torque, last, _ = point(now, u[:, i], modes, gates[:, i], t + (i + 1) * step)
        states.append(now)
        torques.append(torque)
        starts.append(margin)
    outputs = [ca.horzcat(*states), ca.horzcat(*torques), ca.horzcat(*starts), last]
    return point, one, ca.Function("tick", [x, u, modes, gates, t], outputs)
