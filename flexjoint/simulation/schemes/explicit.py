"""Explicit schemes and the semi-implicit Euler scheme: velocities and positions by rates at known states."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import SimulationError
from flexjoint.core.ops import Value
from flexjoint.model.dynamics import FlexibleJointModel, Rates, State
from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step
from flexjoint.simulation.schemes.friction import SWEEPS, directed, friction_forces


class ExplicitEuler(Scheme):
    """Everything from the present velocities. Grows on undamped springs at any step."""

    name = "explicit_euler"
    order = 1
    keeps_energy = 0.1
    keeps_momentum = 0.0
    aba_calls = 1

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        def step(x: State, tau_m: Value) -> State:
            return _moved(model, x, model.rates(x, tau_m, width), h)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        return np.asarray(np.eye(len(A)) + h * A)


class SemiImplicitEuler(Scheme):
    """Velocities first, then positions from the new velocities. Dry friction is implicit: a set, so that it
    sticks; `width` is not used."""

    name = "semi_implicit_euler"
    order = 1
    keeps_energy = 0.1
    keeps_momentum = 0.0
    sticks = True
    aba_calls = 1
    contact_damping = 2.0

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        if model.groups and model.rubs:
            names = ", ".join(model.joints[i].name for i in sorted(model.grouped))
            raise SimulationError(
                f"{self.name} takes no dry friction beside coupled motors ({names}); use {DEFAULT}, or a"
                " scheme that smooths it"
            )
        rub = _Rubbing(model, h)

        def step(x: State, tau_m: Value) -> State:
            r = rub(x, tau_m, model.rates(x, tau_m, None))
            v, dtheta = x.v + h * r.acc, x.dtheta + h * r.ddtheta
            return _moved(model, x, Rates(v, r.acc, dtheta, r.ddtheta, r.dz, r.tau_t), h)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        return _euler_matrix(A, h, np.ones(len(A) // 2))


class Kamedula2016(Scheme):
    """Kameduła et al. 2016, equations 5 and 6: the motor by explicit Euler, the link by the semi-implicit
    Euler of the physics engine.

    Whether the motor's position moves by its old or its new velocity the paper leaves open: here by the old
    one, in Kamedula2016New by the new one.
    """

    name = "kamedula2016"
    order = 1
    keeps_energy = 0.1
    keeps_momentum = 0.0
    aba_calls = 1
    contact_damping = 2.0
    new_motor_velocity: ClassVar[bool] = False

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        def step(x: State, tau_m: Value) -> State:
            r = model.rates(x, tau_m, width)
            dtheta = x.dtheta + h * r.ddtheta if self.new_motor_velocity else x.dtheta
            return _moved(model, x, Rates(x.v + h * r.acc, r.acc, dtheta, r.ddtheta, r.dz, r.tau_t), h)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        new = np.ones(len(A) // 2)
        new[links:] = 1.0 if self.new_motor_velocity else 0.0
        return _euler_matrix(A, h, new)


class Kamedula2016New(Kamedula2016):
    """As Kamedula2016, the motor's position moved by its new velocity."""

    name = "kamedula2016_new"
    new_motor_velocity = True


class RK4(Scheme):
    """Classical Runge-Kutta; on a floating base in its exponential coordinates (Munthe-Kaas 1998)."""

    name = "rk4"
    order = 4
    keeps_momentum = 0.25  # of energy, it only loses some
    aba_calls = 4

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        def step(x: State, tau_m: Value) -> State:
            r1 = model.rates(x, tau_m, width)
            r2 = _onward(model, x, r1, 0.5 * h, tau_m, width)
            r3 = _onward(model, x, r2, 0.5 * h, tau_m, width)
            r4 = _onward(model, x, r3, h, tau_m, width)
            mean = Rates(
                *(
                    (getattr(r1, n) + 2.0 * (getattr(r2, n) + getattr(r3, n)) + getattr(r4, n)) / 6.0
                    for n in ("v", "acc", "dtheta", "ddtheta", "dz", "tau_t")
                )
            )
            return _moved(model, x, mean, h)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        hA, one = h * A, np.eye(len(A))
        return np.asarray(one + hA @ (one + hA / 2 @ (one + hA / 3 @ (one + hA / 4))))


def _euler_matrix(A: np.ndarray, h: float, new: np.ndarray) -> np.ndarray:
    """Of an Euler scheme whose positions move by the new velocity where `new` (n,) is 1, else by the old."""
    n = len(new)
    eye = np.eye(n)
    lower = np.hstack([h * A[n:, :n], eye + h * A[n:, n:]])
    old = np.hstack([eye, h * np.diag(1.0 - new)])
    return np.vstack([old + h * np.diag(new) @ lower, lower])


def _onward(
    model: FlexibleJointModel, x: State, r: Rates, h: float, tau_m: Value, width: float | None
) -> Rates:
    """Rates h seconds after x at constant rates r; the base's velocity as that of its exponential
    coordinates xi = h v about x: xi' = v + [xi, v]/2 + [xi, [xi, v]]/12 to the order that counts."""
    then = model.rates(_moved(model, x, r, h), tau_m, width)
    if not model.robot.floating:
        return then
    xi, v = h * r.v[:6], then.v[:6]
    once = _bracket(model, xi, v)
    rate = ops.copy(then.v)
    rate[:6] = v + once / 2.0 + _bracket(model, xi, once) / 12.0
    return Rates(rate, then.acc, then.dtheta, then.ddtheta, then.dz, then.tau_t)


def _bracket(model: FlexibleJointModel, xi: Value, v: Value) -> Value:
    """Lie bracket of two twists (6,), linear part first."""

    def cross(a: Value, b: Value) -> list[Value]:
        return [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]

    linear = [p + q for p, q in zip(cross(xi[3:6], v[:3]), cross(xi[:3], v[3:6]), strict=True)]
    return model.vector([*linear, *cross(xi[3:6], v[3:6])])


def _moved(model: FlexibleJointModel, x: State, r: Rates, h: float) -> State:
    """The state after h seconds at constant rates."""
    return State(
        x.t + h,
        model.body.integrate(x.q, h * r.v),
        x.v + h * r.acc,
        x.theta + h * r.dtheta,
        x.dtheta + h * r.ddtheta,
        x.z + h * r.dz,
        r.acc,
        r.ddtheta,
        r.tau_t[list(model.rigid)] if model.rigid else x.tau_rigid,
    )


class _Rubbing:
    """Dry friction at the end of a semi-implicit Euler step: what stops a velocity in it, up to the level."""

    def __init__(self, model: FlexibleJointModel, h: float) -> None:
        self.model, self.h = model, h
        self.motors = [(k, i) for k, i in enumerate(model.flexible) if model.flows[i].motor_rubs]
        self.links = [
            i
            for i, flow in enumerate(model.flows)
            if flow.link_rubs or (flow.joint.rigid and flow.motor_rubs)
        ]
        self.armature = model.zeros(model.nv)
        for i in model.rigid:
            self.armature[model.joints[i].idx_v] = model.flows[i].drive.B

    def __call__(self, x: State, tau_m: Value, r: Rates) -> Rates:
        """The rates r of a step without dry friction, with it."""
        if not self.motors and not self.links:
            return r
        return Rates(r.v, self._links(x, tau_m, r), r.dtheta, self._motors(x, tau_m, r), r.dz, r.tau_t)

    def _motors(self, x: State, tau_m: Value, r: Rates) -> Value:
        model, h = self.model, self.h
        ddtheta = r.ddtheta
        for k, i in self.motors:
            free = x.dtheta[k] + h * ddtheta[k]
            s, drive = model.signals(x, i, tau_m[i]), model.flows[i].drive
            s.dtheta = directed(s.dtheta, free)
            stopped = h * model.flows[i].motor_level(s, x.z) / drive.B
            ddtheta[k] = (free - ops.clip(free, -stopped, stopped) - x.dtheta[k]) / h
        return ddtheta

    def _links(self, x: State, tau_m: Value, r: Rates) -> Value:
        model, h, acc = self.model, self.h, r.acc
        if not self.links:
            return acc
        places = [model.joints[i].idx_v for i in self.links]
        rest = model.zeros(model.nv)
        still = model.body.aba(x.q, rest, rest, self.armature)
        columns, free, levels = [], [], []
        for i, place in zip(self.links, places, strict=True):
            unit = model.zeros(model.nv)
            unit[place] = 1.0
            columns.append(model.body.aba(x.q, rest, unit, self.armature) - still)
            free.append(x.v[place] + h * acc[place])
            levels.append(self._level(x, tau_m, r, i, free[-1]))
        coupling = [[h * column[place] for column in columns] for place in places]
        sweeps = 1 if len(places) == 1 else SWEEPS
        for column, force in zip(
            columns, friction_forces(free, levels, coupling, sweeps, model.symbolic), strict=True
        ):
            acc = acc - column * force
        return acc

    def _level(self, x: State, tau_m: Value, r: Rates, i: int, velocity: Value) -> Value:
        """Bound of the dry friction on a link; a rigid joint's motor rubs there too."""
        flow, s = self.model.flows[i], self.model.signals(x, i, tau_m[i])
        s.dq = directed(s.dq, velocity)
        level = flow.link_level(s, x.z)
        if flow.joint.rigid:
            s.dtheta, s.tau_t = s.dq, r.tau_t[i]
            level = level + flow.motor_level(s, x.z)
        return level
