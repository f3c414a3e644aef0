"""Integration schemes: one function each, behind one interface, for numbers and CasADi alike.

A scheme takes (model, h, width) and gives a step function (state, tau_m) -> state, h seconds later, under
motor torques tau_m (n,) [N m] held over the step, delays aside. Only the default treats dry friction as a
set, so that it sticks; the others smooth it as level tanh(velocity / width) and need the width [rad/s].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from flexjoint.errors import SimulationError, unknown
from flexjoint.midpoint import Midpoint
from flexjoint.model import FlexibleJointModel, Rates, State
from flexjoint.ops import Value

Step = Callable[[State, Value], State]
Scheme = Callable[[FlexibleJointModel, float, float | None], Step]

DEFAULT = "linearly_implicit_midpoint"


def linearly_implicit_midpoint(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """The default: one ABA call per step, order 2, stable for any stiffness and damping of the joints; dry
    friction sticks. See `flexjoint.midpoint`; `width` is not used."""
    return Midpoint(model, h).step


def explicit_euler(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """Everything from the present velocities; order 1. Grows on undamped springs at any step."""

    def step(x: State, tau_m: Value) -> State:
        return _moved(model, x, model.rates(x, tau_m, width), h)

    return step


def semi_implicit_euler(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """Velocities first, then positions from the new velocities; order 1."""

    def step(x: State, tau_m: Value) -> State:
        r = model.rates(x, tau_m, width)
        new = Rates(x.v + h * r.acc, r.acc, x.dtheta + h * r.ddtheta, r.ddtheta, r.dz, r.tau_t)
        return _moved(model, x, new, h)

    return step


def kashiri2017(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """Kashiri et al. 2017, equations 5 and 6: the motor by explicit Euler from the old velocity, the link
    by the semi-implicit Euler of the physics engine. With the new motor velocity it is
    `semi_implicit_euler`: the paper leaves that open."""

    def step(x: State, tau_m: Value) -> State:
        r = model.rates(x, tau_m, width)
        new = Rates(x.v + h * r.acc, r.acc, x.dtheta, r.ddtheta, r.dz, r.tau_t)
        return _moved(model, x, new, h)

    return step


def rk4(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """Classical Runge-Kutta, four ABA calls; order 4 where every joint has one axis."""

    def step(x: State, tau_m: Value) -> State:
        r1 = model.rates(x, tau_m, width)
        r2 = model.rates(_moved(model, x, r1, 0.5 * h), tau_m, width)
        r3 = model.rates(_moved(model, x, r2, 0.5 * h), tau_m, width)
        r4 = model.rates(_moved(model, x, r3, h), tau_m, width)
        mean = Rates(
            *(
                (getattr(r1, n) + 2.0 * (getattr(r2, n) + getattr(r3, n)) + getattr(r4, n)) / 6.0
                for n in ("v", "acc", "dtheta", "ddtheta", "dz", "tau_t")
            )
        )
        return _moved(model, x, mean, h)

    return step


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
        x.tau_rigid,
    )


SCHEMES: Mapping[str, Scheme] = MappingProxyType(
    {
        DEFAULT: linearly_implicit_midpoint,
        "semi_implicit_euler": semi_implicit_euler,
        "explicit_euler": explicit_euler,
        "kashiri2017": kashiri2017,
        "rk4": rk4,
    }
)


def make_step(model: FlexibleJointModel, h: float, scheme: str = DEFAULT, width: float | None = None) -> Step:
    """The step function of a scheme by its name.

    Raises UnknownNameError, or SimulationError when a scheme that smooths dry friction gets no width.
    """
    if scheme not in SCHEMES:
        raise unknown("scheme", scheme, SCHEMES)
    rubs = any(flow.motor_rubs or flow.link_rubs for flow in model.flows)
    if scheme != DEFAULT:
        if rubs and not (width is not None and width > 0.0):
            raise SimulationError(
                f"{scheme} smooths dry friction as level tanh(velocity / width): give a width > 0 [rad/s], or"
                f" use {DEFAULT}, where it sticks (got width={width})"
            )
        width = 1.0 if width is None else width
    return SCHEMES[scheme](model, h, width)


def check_stability(model: FlexibleJointModel, x: State, h: float, scheme: str) -> None:
    """Refuse an explicit scheme whose step is too long for the springs of the model at a state.

    The step is linearised about the state without gravity, velocity terms, effects and kinks (springs,
    dampers, masses). Raises SimulationError with the longest stable step.
    """
    if scheme == DEFAULT:
        return
    if _growth(model, x, h, scheme) <= 1.0:
        return
    shorter = h
    while _growth(model, x, shorter, scheme) > 1.0 and shorter > 1e-7:
        shorter *= 0.8
    advice = f"a physics rate of {1.0 / shorter:.3g} Hz or more, or " if shorter > 1e-7 else ""
    raise SimulationError(
        f"{scheme} diverges on this robot at a physics rate of {1.0 / h:g} Hz; use {advice}{DEFAULT}, which"
        " is stable for any stiffness"
    )


def _growth(model: FlexibleJointModel, x: State, h: float, scheme: str) -> float:
    """Largest factor by which a step of the scheme lets a mode grow (1 or less: none grows)."""
    A = _linear(model, x)
    n = model.nv + model.nf
    eye = np.eye(n)
    position, velocity = A[n:, :n], A[n:, n:]
    if scheme == "rk4":
        hA = h * A
        step = np.eye(2 * n) + hA @ (
            np.eye(2 * n) + hA / 2 @ (np.eye(2 * n) + hA / 3 @ (np.eye(2 * n) + hA / 4))
        )
    else:
        lower = np.hstack([h * position, eye + h * velocity])
        new = np.zeros(n) if scheme == "explicit_euler" else np.ones(n)
        if scheme == "kashiri2017":
            new[model.nv :] = 0.0
        old = np.hstack([eye, h * np.diag(1.0 - new)])
        step = np.vstack([old + h * np.diag(new) @ lower, lower])
    # a free drift is a double eigenvalue of 1: rounding moves it by about the root of the precision
    return float(np.max(np.abs(np.linalg.eigvals(step)))) - 1e-6


def _linear(model: FlexibleJointModel, x: State) -> np.ndarray:
    """d(v, dtheta, acc, ddtheta)/d(q, theta, v, dtheta) of masses, springs and dampers."""
    nv, nf = model.nv, model.nf
    mass, stiffness, damping = (np.zeros((nv + nf, nv + nf)) for _ in range(3))
    mass[:nv, :nv] = model.body.mass_matrix(x.q)
    for i, flow in enumerate(model.flows):
        place, drive = flow.joint.idx_v, flow.drive
        if flow.joint.rigid:
            mass[place, place] += drive.B
            damping[place, place] += drive.D_m
            continue
        k = nv + model.flexible.index(i)
        mass[k, k] = drive.B
        damping[k, k] += drive.D_m
        for matrix, number in ((stiffness, drive.K), (damping, drive.D)):
            matrix[np.ix_([place, k], [place, k])] += number * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.block(
        [
            [np.zeros((nv + nf, nv + nf)), np.eye(nv + nf)],
            [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
        ]
    )
