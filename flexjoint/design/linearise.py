"""Linearise a robot with flexible joints about a point.

The rigid body's derivatives come from Pinocchio (Carpentier and Mansard 2018) or from its CasADi twin;
springs, motors and effects are differentiated by CasADi, joint by joint: they never see M(q), so the parts
are assembled by the chain rule through the joint torques.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.ops import Value
from flexjoint.design.linear_model import LinearModel
from flexjoint.design.quasilinear import CHOICES, Nonsmooth, describing, kinked
from flexjoint.effects import SENSOR_CHANNELS, Planned, Signals
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.rigidbody.symbolic import SymbolicBody


def linearise(
    model: FlexibleJointModel,
    at: State | np.ndarray | None = None,
    tau: np.ndarray | None = None,
    *,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
    width: float | None = None,
    method: Literal["numeric", "symbolic"] = "numeric",
) -> LinearModel:
    """A, B, C, D about a point, with named signals.

    States: q (nv), v (nv), theta and dtheta of flexible joints, internal states of effects, named as in
    `FlexibleJointModel.state_names`; positions are tangent, so nv of them. Inputs tau_m.joint [N m], outputs
    channel.joint as the sensors read them (q, dq, theta, dtheta, tau_t). Dead times of effects and of the
    robot's `sensing_delay` are kept as input_delay and output_delay.

    Args:
        at: a state, or link positions (nq,) at which the robot rests with its springs carrying the load
            (default: neutral).
        tau: (n,) motor torques [N m]; default: those that hold `at`, of a pose; 0 for a state.
        nonsmooth: what to do with effects that have kinks; it must be chosen where there are any. null: leave
            them out. slope: the local slope of their laws, dry friction smoothed as level tanh(velocity /
            width). At rest that makes a huge damper of the friction, and a gap takes the spring away: right
            for the motion of a smoothed model within its width, wrong for gain design. describing: see
            `quasilinear.describing`.
        amplitude: of each swinging signal, by name, for nonsmooth="describing".
        width: of the smoothed dry friction [rad/s], for nonsmooth="slope".
        method: numeric is by Pinocchio; symbolic differentiates the CasADi twin. Both give the same.

    Raises:
        ModelError: kinks and no choice, a missing amplitude or width, wrong shapes, no equilibrium; contacts
            with the ground.
    """
    refuse_what_is_unknown(model)
    own, effects = model, model.effects
    rough = kinked(effects)
    _check_choice(rough, nonsmooth, width)
    if nonsmooth == "null":
        effects = tuple(planned for planned in effects if planned not in rough)
        own = FlexibleJointModel(model.robot, effects)
    point, torque = _point(model, own, at, tau)
    if nonsmooth == "describing":
        effects = tuple(
            describing(planned, _signals(own, planned, point, torque), amplitude or {})
            if planned in rough
            else planned
            for planned in effects
        )
        own = FlexibleJointModel(model.robot, effects)
    x = own.pack(point)
    torques = _JointTorques.of(own, width, point.t)
    if method == "symbolic":
        values = [value.full() for value in symbolic_linearisation(own, width, point.t)(x, torque)]
        A, B, C, D, drift = values
    elif method == "numeric":
        force, by_x, by_u, _, C, D = (value.full() for value in torques.function(x, torque))
        tau_v, armature = force[: own.nv, 0], torques.armature
        derivatives = own.body.aba_derivatives(point.q, point.v, tau_v, armature)
        A, B = _assembled(own, derivatives, by_x, by_u, point.v)
        acc = own.body.aba(point.q, point.v, tau_v, armature)
        drift = np.concatenate([point.v, acc, point.dtheta, force[own.nv :, 0]])
    else:
        raise unknown("method", method, ("numeric", "symbolic"))
    names = model.robot.joint_names
    sensing = model.robot.file.sensing_delay
    late = [float(own.flows[i].reading_delay(c)) + sensing for c, i in torques.readings]
    return LinearModel(
        A=A,
        B=B,
        C=C,
        D=D,
        states=_tangent_names(own),
        inputs=tuple(f"tau_m.{name}" for name in names),
        outputs=tuple(f"{channel}.{names[i]}" for channel, i in torques.readings),
        input_delay=np.array([float(flow.command_delay()) for flow in own.flows]),
        output_delay=np.array(late),
        drift=np.ravel(drift),
        dt=None,
        name=model.robot.name,
    )


def symbolic_linearisation(
    model: FlexibleJointModel, width: float | None = None, t: float = 0.0
) -> ca.Function:
    """linearisation(x, u) -> A, B, C, D, drift as one casadi.Function, of the state x (nx,) of
    `model.state_names` and the motor torques u (n,): for use inside other CasADi expressions. Kinks count
    with their local slope; `width` as for `linearise`.

    The articulated-body algorithm is differentiated by q, v and tau, and the rest assembled around it: on
    CENTAURO with a fixed base 114 thousand instructions, instead of 187 for the whole right-hand side
    differentiated at once. The matrices are sparse.
    """
    refuse_what_is_unknown(model)
    twin = FlexibleJointModel(model.robot, model.effects, SymbolicBody)
    body, nv = twin.body, twin.nv
    torques = _JointTorques.of(model, width, t)
    x, u = ca.SX.sym("x", twin.nx), ca.SX.sym("u", len(twin.joints))
    force, by_x, by_u, _, C, D = torques.function(x, u)
    q, v, tau, step = (ca.SX.sym("", size) for size in (twin.nq, nv, nv, nv))
    acc = body.aba(q, v, tau, ca.SX(torques.armature))
    moved = ca.substitute(ca.jacobian(body.integrate(q, step), step), step, ca.SX.zeros(nv))
    outputs = [acc, ca.jacobian(acc, q) @ moved, ca.jacobian(acc, v), ca.jacobian(acc, tau)]
    aba = ca.Function("aba", [q, v, tau], outputs)
    now_v = x[twin.nq : twin.nq + nv]
    value, *derivatives = aba(x[: twin.nq], now_v, force[:nv])
    A, B = _assembled(twin, derivatives, by_x, by_u, now_v)
    state = twin.unpack(x)
    drift = ca.vertcat(now_v, value, state.dtheta, force[nv:])
    return ca.Function(
        "linearisation", [x, u], [A, B, C, D, drift], ["x", "u"], ["A", "B", "C", "D", "drift"]
    )


def refuse_what_is_unknown(model: FlexibleJointModel) -> None:
    """Raises ModelError for a model with contacts, or with motors that several rigid joints share, which a
    linear model here knows nothing of."""
    for group in model.groups:
        if group.rigid:
            listed = " and ".join(model.joints[i].name for i in group.joints)
            raise ModelError(
                f"{listed} are rigid and share a motor, which linear models cannot have; give them a"
                " stiffness, or leave the coupling out"
            )
    if model.ground is not None:
        raise ModelError(
            f"{model.robot.name} stands on contacts, which linear models cannot have: fix its base"
            " (grounded=True of flexjoint.robot.robot.load), or take them away (dataclasses.replace(robot,"
            " contacts=()))"
        )


# --- joint torques ----------------------------------------------------------------------------------------
class _Inert(SymbolicBody):
    """A body that shows the joint torques it is given instead of moving under them."""

    def aba(self, q: ca.SX, v: ca.SX, tau: ca.SX, armature: ca.SX) -> ca.SX:
        return tau


@dataclass(frozen=True)
class _JointTorques:
    """function(x, u) -> f, df/dx, df/du, y, dy/dx, dy/du with f the joint torques (nv,), ddtheta and dz: all
    of the model's rates but the rigid body's; columns of positions are tangent. armature (nv,) of rigid
    joints' motors."""

    function: ca.Function
    armature: np.ndarray
    readings: tuple[tuple[str, int], ...]

    @staticmethod
    def of(model: FlexibleJointModel, width: float | None, t: float) -> _JointTorques:
        own = FlexibleJointModel(model.robot, model.effects, _Inert)
        x, u = ca.SX.sym("x", own.nx), ca.SX.sym("u", len(own.joints))
        state = own.unpack(x, t)
        rates = own.rates(state, u, 1.0 if width is None else width)
        f = ca.vertcat(rates.acc, rates.ddtheta, rates.dz)
        readings = [
            (channel, i)
            for i, joint in enumerate(own.joints)
            for channel in SENSOR_CHANNELS
            if not (joint.rigid and channel == "tau_t")
        ]
        y = []
        for channel, i in readings:
            true = getattr(own.signals(state, i, u[i]), channel)
            y.append(own.flows[i].read(channel, Signals(t=t), true))
        tangent = ca.sparsify(ca.DM(_tangent(own)))
        outputs: list[Any] = []
        for value in (f, ca.vertcat(*y)):
            outputs += [value, ca.jacobian(value, x) @ tangent, ca.jacobian(value, u)]
        armature = np.zeros(own.nv)
        for i in own.rigid:
            armature[own.joints[i].idx_v] = own.flows[i].drive.B
        return _JointTorques(ca.Function("torques", [x, u], outputs), armature, tuple(readings))


def _tangent(model: FlexibleJointModel) -> np.ndarray:
    """(nx, nt) dx by the tangent state, where laws of effects can see it: positions of actuated joints, which
    have one axis each."""
    rest = model.nv + 2 * model.nf + model.nz
    out = np.zeros((model.nx, model.nv + rest))
    for joint in model.joints:
        out[joint.idx_q, joint.idx_v] = 1.0
    out[model.nq :, model.nv :] = np.eye(rest)
    return out


def _assembled(
    model: FlexibleJointModel, derivatives: Any, by_x: Value, by_u: Value, v: Value
) -> tuple[Value, Value]:
    """A and B from the derivatives of aba by q, v, tau and those of the joint torques."""
    by_q, by_v, by_tau = derivatives
    nv, nf = model.nv, model.nf
    size = by_x.shape[1]
    symbolic = isinstance(by_x, ca.SX)
    A, B = (ca.SX(size, n) if symbolic else np.zeros((size, n)) for n in (size, by_u.shape[1]))
    motor = 2 * nv + nf
    A[:nv, nv : 2 * nv] = ca.SX.eye(nv) if symbolic else np.eye(nv)
    _turn(model, A, v)
    A[nv : 2 * nv, :] = by_tau @ by_x[:nv, :]
    A[nv : 2 * nv, :nv] += by_q
    A[nv : 2 * nv, nv : 2 * nv] += by_v
    A[2 * nv : motor, motor : motor + nf] = ca.SX.eye(nf) if symbolic else np.eye(nf)
    A[motor:, :] = by_x[nv:, :]
    B[nv : 2 * nv, :] = by_tau @ by_u[:nv, :]
    B[motor:, :] = by_u[nv:, :]
    return A, B


def _turn(model: FlexibleJointModel, A: Value, v: Value) -> None:
    """A free-flyer's deviation is measured in its moving frame: d(dq)/dt = dv - v x dq, in motion vectors
    (Featherstone 2008, chapter 2)."""
    for joint in list(model.robot.model.joints)[1:]:
        if joint.nv == 1:
            continue
        blocks: tuple[tuple[int, int, list[list[Value]]], ...]
        own = v[joint.idx_v : joint.idx_v + joint.nv]
        if joint.shortname() == "JointModelFreeFlyer":
            linear, angular = _cross(own[:3]), _cross(own[3:])
            blocks = ((0, 0, angular), (0, 3, linear), (3, 3, angular))
        elif joint.shortname() == "JointModelSpherical":
            blocks = ((0, 0, _cross(own)),)
        elif joint.shortname() == "JointModelTranslation" or (isinstance(v, np.ndarray) and not np.any(own)):
            blocks = ()
        else:
            raise ModelError(
                f"a moving joint of type {joint.shortname()} cannot be linearised; take it at rest"
            )
        for row, column, block in blocks:
            for i in range(3):
                for k in range(3):
                    A[joint.idx_v + row + i, joint.idx_v + column + k] -= block[i][k]


def _cross(w: Value) -> list[list[Value]]:
    return [[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]]


# --- the point --------------------------------------------------------------------------------------------
def _check_choice(rough: tuple[Planned, ...], nonsmooth: str | None, width: float | None) -> None:
    if nonsmooth is not None and nonsmooth not in CHOICES:
        raise unknown("nonsmooth", nonsmooth, CHOICES)
    if rough and nonsmooth is None:
        choices = "; ".join(f"{name!r}: {what}" for name, what in CHOICES.items())
        raise ModelError(
            f"{', '.join(map(str, rough))} cannot be linearised without a choice; give nonsmooth = {choices}"
        )
    dry = [planned for planned in rough if planned.effect.overrides("level")]
    if dry and nonsmooth == "slope" and not (width is not None and width > 0.0):
        raise ModelError(
            f"{dry[0]}: dry friction has no slope at rest; give the width > 0 [rad/s] over which to smooth"
            f" it, or choose"
            f" nonsmooth='describing' or 'null' (got width={width})"
        )


def _point(
    model: FlexibleJointModel, own: FlexibleJointModel, at: State | np.ndarray | None, tau: np.ndarray | None
) -> tuple[State, np.ndarray]:
    """The state, with the internal states that `own` has, and the motor torques (n,)."""
    n = len(model.joints)
    if isinstance(at, State):
        state = own.unpack(np.zeros(own.nx), at.t)
        state.q, state.v, state.theta, state.dtheta = at.q, at.v, at.theta, at.dtheta
        kept = [model.state_names.index(name) for name in own.state_names[own.nx - own.nz :]]
        state.z = model.pack(at)[kept]
        torque = np.zeros(n)
    else:
        q = own.body.neutral if at is None else np.asarray(at, dtype=float)
        if q.shape != (model.nq,) or not np.all(np.isfinite(q)):
            raise ModelError(f"at: expected a State or ({model.nq},) finite link positions, got {at!r}")
        rest = equilibrium(own, q)
        state = own.rest(q.copy())
        state.theta, state.z, torque = rest.theta[0, list(own.flexible)], rest.z[0], rest.tau[0]
    if tau is not None:
        torque = np.asarray(tau, dtype=float)
        if torque.shape != (n,):
            raise ModelError(
                f"tau: expected ({n},) motor torques [N m], one per joint, got shape {torque.shape}"
            )
    return state, torque


def _signals(model: FlexibleJointModel, planned: Planned, state: State, tau: np.ndarray) -> Signals:
    i = model.robot.joint_names.index(str(planned.joint))
    return model.signals(state, i, float(tau[i]))


def _tangent_names(model: FlexibleJointModel) -> tuple[str, ...]:
    """Names of the tangent state: a position that is no actuated joint's is named by its place in v."""
    names = [f"q[{k}]" for k in range(model.nv)]
    for joint in model.joints:
        names[joint.idx_v] = f"q.{joint.name}"
    return (*names, *model.state_names[model.nq :])
