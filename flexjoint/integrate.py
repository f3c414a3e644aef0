"""Integration schemes: one function each, behind one interface, for numbers and CasADi alike.

A scheme takes (model, h, width) and gives a step function (state, tau_m) -> state, h seconds later, under
motor torques tau_m (n,) [N m] held over the step, delays aside. The default and semi_implicit_euler treat
dry friction as a set, so that it sticks; the others smooth it as level tanh(velocity / width) and need the
width [rad/s] where there is any. docs/simulation.md compares them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Literal

from flexjoint import ops
from flexjoint.errors import SimulationError, unknown
from flexjoint.friction import SWEEPS, directed, settle
from flexjoint.implicit import implicit_midpoint
from flexjoint.midpoint import Midpoint
from flexjoint.model import FlexibleJointModel, Rates, State
from flexjoint.ops import Value
from flexjoint.reference import reference
from flexjoint.stability import check_stability  # noqa: F401  belongs to this interface

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
    """Velocities first, then positions from the new velocities; order 1. Dry friction is implicit: a set, so
    that it sticks; `width` is not used."""
    rub = _Rubbing(model, h)

    def step(x: State, tau_m: Value) -> State:
        r = rub(x, tau_m, model.rates(x, tau_m, None))
        v, dtheta = x.v + h * r.acc, x.dtheta + h * r.ddtheta
        return _moved(model, x, Rates(v, r.acc, dtheta, r.ddtheta, r.dz, r.tau_t), h)

    return step


def kashiri2017(
    model: FlexibleJointModel,
    h: float,
    width: float | None = None,
    motor_position: Literal["old", "new"] = "old",
) -> Step:
    """Kashiri et al. 2017, equations 5 and 6: the motor by explicit Euler, the link by the semi-implicit
    Euler of the physics engine; order 1.

    Whether the motor's position moves by its old or its new velocity the paper leaves open; the scheme
    named kashiri2017 takes the old one, kashiri2017_new the new one.
    """

    def step(x: State, tau_m: Value) -> State:
        r = model.rates(x, tau_m, width)
        dtheta = x.dtheta if motor_position == "old" else x.dtheta + h * r.ddtheta
        return _moved(model, x, Rates(x.v + h * r.acc, r.acc, dtheta, r.ddtheta, r.dz, r.tau_t), h)

    return step


def rk4(model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
    """Classical Runge-Kutta, four ABA calls; order 4, on a floating base in its exponential coordinates
    (Munthe-Kaas 1998)."""

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
            columns, settle(free, levels, coupling, sweeps, model.symbolic), strict=True
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


SCHEMES: Mapping[str, Scheme] = MappingProxyType(
    {
        DEFAULT: linearly_implicit_midpoint,
        "semi_implicit_euler": semi_implicit_euler,
        "explicit_euler": explicit_euler,
        "kashiri2017": kashiri2017,
        "kashiri2017_new": partial(kashiri2017, motor_position="new"),
        "rk4": rk4,
        "implicit_midpoint": implicit_midpoint,
        "reference": reference,
    }
)


STICKING = frozenset({DEFAULT, "semi_implicit_euler"})  # dry friction as a set, no width
NUMBERS_ONLY = frozenset({"implicit_midpoint", "reference"})  # they iterate, which expressions cannot


def make_step(model: FlexibleJointModel, h: float, scheme: str = DEFAULT, width: float | None = None) -> Step:
    """The step function of a scheme by its name.

    Raises UnknownNameError, or SimulationError when a scheme that smooths dry friction gets no width.
    """
    check_scheme(model, scheme, width)
    step = SCHEMES[scheme](model, h, width)
    if model.ground is None or scheme == DEFAULT:  # which lets anchors slip at its midpoint
        return step
    return lambda x, tau_m: slipped(model, step(x, tau_m))


def check_scheme(model: FlexibleJointModel, scheme: str, width: float | None) -> None:
    """Whether there is such a scheme, and a width where it wants one; raises as `make_step`."""
    if scheme not in SCHEMES:
        raise unknown("scheme", scheme, SCHEMES)
    rubs = any(flow.motor_rubs or flow.link_rubs for flow in model.flows)
    if rubs and scheme not in STICKING and not (width is not None and width > 0.0):
        raise SimulationError(
            f"{scheme} smooths dry friction as level tanh(velocity / width): give a width > 0 [rad/s], or"
            f" use {DEFAULT}, where it sticks (got width={width})"
        )
    if model.ground is not None and not model.ground.springy and scheme != DEFAULT:
        raise SimulationError(
            f"{scheme} takes no rigid ground, whose impulses belong to the step of {DEFAULT}: use that, or"
            " ground: compliant"
        )


def slipped(model: FlexibleJointModel, x: State) -> State:
    """The state with the anchors of contacts where they slip to."""
    if model.ground is not None:
        x.z = model.ground.slipped(model, x.q, x.v, x.z)
    return x
