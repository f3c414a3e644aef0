"""Static law of a robot with flexible joints: what holds a link position at rest.

g(q) holds the links, a spring deflection that carries it puts the motor at theta_d = q_d + g(q_d)/K (Tomei
1991; Kameduła et al. 2016, section 3). Springs that are not linear are inverted by Newton's method, the
command's way to the motor too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import ModelError
from flexjoint.core.running.progress import Report, part, silent
from flexjoint.core.units import of_joint
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.joint import JointFlow, neighbours
from flexjoint.model.statics.forces import Contact, contact_forces, given_forces, unactuated
from flexjoint.model.statics.limits import Violation, beyond, checked_deflections
from flexjoint.model.statics.roots import increasing_roots

ROWS_TOLD = 200  # of a path, between two reports
SLOW = 1e12  # [s] that a step of a path takes: rate-free states do not care, others have relaxed
REACHED = 1e-9  # of the wanted torque: by how much the inverse of the command may miss it
SWEEPS = 200  # over joints whose commands act on each other


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """Rest at link positions q (N, nq); the other arrays are of the n actuated joints, in the model's order.

    theta (N, n): motor positions [rad]; deflection (N, n): theta - q.
    tau (N, n): what the springs carry [N m], and so the torque on the motors, their own effects aside.
    gravity (N, n): g(q) [N m].
    tau_m (N, n): the motor torque command that holds the pose, through command and motor effects [N m].
    friction (N, n): by how much the motor's torque may differ from that and dry friction still hold it [N m];
    of
        a motor that turns with several joints, at its own position.
    z (N, nz): internal states of effects.
    forces (N, c, 6): of the contacts on the robot, force before moment, along world axes [N, N m].
    unbalanced (N, nv - n): generalised forces of the coordinates without a motor that nothing holds.
    violations: the limits that are broken.
    """

    q: np.ndarray
    theta: np.ndarray
    deflection: np.ndarray
    tau: np.ndarray
    gravity: np.ndarray
    tau_m: np.ndarray
    friction: np.ndarray
    z: np.ndarray
    forces: np.ndarray
    unbalanced: np.ndarray
    violations: tuple[Violation, ...]


def equilibrium(
    model: FlexibleJointModel,
    q: np.ndarray,
    contacts: Sequence[Contact] = (),
    forces: np.ndarray | None = None,
    path: bool = False,
    max_deflection: Mapping[str, float] | None = None,
    progress: Report | None = None,
) -> Equilibrium:
    """theta_d, g(q_d), deflections and motor torques for link positions q (N, nq) or (nq,) [rad].

    Args:
        contacts: what carries the robot beside its base. Their forces are solved for such that the floating
            base and passive joints are at rest; the motors then give g - J_c' lambda. Without contacts those
            coordinates count as held by outside forces, which `unbalanced` gives.
        forces: (N, c, 6) or (c, 6) known forces of the contacts instead; what they leave is `unbalanced`.
        path: q is a path that is travelled slowly, in this order, from relaxed springs: hysteresis then
            remembers. Without, every pose stands for itself with internal states of effects at 0.
        max_deflection: largest `|theta - q|` by joint [rad], to be checked.
        progress: called with a share in [0, 1] and what is being done.

    Limits that are broken (motor torque, deflection, joint range, what the command can reach) are no error:
    `violations` names them.

    Raises:
        ModelError: shapes; a spring that cannot carry the load; contacts that cannot balance the base.
        UnknownNameError: a frame or joint that does not exist.
    """
    q = _rows(model, q)
    report = progress or silent
    limits = checked_deflections(model, max_deflection or {})
    gravity = model.body.gravity_torque_batch(q)
    made = np.zeros_like(gravity)
    acting = np.zeros((len(q), len(contacts), 6))
    if forces is not None:
        acting = _checked_forces(forces, len(q), len(contacts))
        made = given_forces(model, q, contacts, acting)
    elif contacts:
        acting, made = contact_forces(model, q, gravity, contacts)
    places = [joint.idx_v for joint in model.joints]
    # joint after joint is what follows, so columns are what lies together
    load = np.asfortranarray((gravity - made)[:, places] - _link_torque(model, q))
    links = np.asfortranarray(q[:, [joint.idx_q for joint in model.joints]])

    z = np.tile(model.rest().z, (len(q), 1))
    phi = np.zeros_like(load)
    friction = np.empty_like(load)
    for i, flow in enumerate(model.flows):
        link = links[:, i]
        own = part(report, i / len(model.flows), 1.0 / len(model.flows))
        own(0.0, flow.joint.name)
        if path and flow.stateful:
            phi[:, i] = _along(flow, link, load[:, i], z, own)
        elif not flow.joint.rigid:
            phi[:, i] = deflection(flow, link, load[:, i])
    resting = [_resting(links[:, i], phi[:, i], load[:, i]) for i in range(len(model.flows))]
    needed = _needed(model, resting, load, z)
    tau_m, given = _commands(model, resting, needed)
    commanded = _commanded(resting, tau_m)
    for i, (flow, s) in enumerate(_motors(model, commanded)):
        friction[:, i] = flow.motor_level(s, z.T)
        for slot, value in flow.steady_state(s, s.tau_m):
            z[:, slot] = value
    for group in model.groups:
        for shaft in group.shafts:
            if not shaft.takes:
                level = shaft.flow.motor_level(shaft.signals({i: commanded[i] for i in group.joints}), z.T)
                for i, share in shaft.turns.items():
                    friction[:, i] += np.abs(share) * level
    result = Equilibrium(
        q=q,
        theta=links + phi,
        deflection=phi,
        tau=load,
        gravity=gravity[:, places],
        tau_m=tau_m,
        friction=friction,
        z=z,
        forces=acting,
        unbalanced=(gravity - made)[:, unactuated(model)],
        violations=(),
    )
    return _with_violations(model, result, needed, given, limits)


def _with_violations(
    model: FlexibleJointModel,
    rest: Equilibrium,
    needed: np.ndarray,
    given: np.ndarray,
    max_deflection: Mapping[str, float],
) -> Equilibrium:
    """The equilibrium with its violations; needed and given (N, n) are the motor torques that the poses need
    and that their commands lead to."""
    found: list[Violation] = []
    lower, upper = model.robot.model.lowerPositionLimit, model.robot.model.upperPositionLimit
    sliding = model.robot.prismatic
    for i, joint in enumerate(model.joints):
        name, torque, place = joint.name, joint.torque_limit, joint.idx_q
        angle, effort = (of_joint(unit, name in sliding) for unit in ("rad", "N m"))
        found += beyond("motor torque", name, rest.tau_m[:, i], -torque, torque, effort)
        short = np.flatnonzero(given[:, i] != needed[:, i])
        if short.size:
            excess = np.abs(needed[short, i] - given[short, i])
            found.append(Violation("reachable torque", name, short, needed[short, i], excess, effort))
        limit = max_deflection.get(name, np.inf)
        found += beyond("deflection", name, rest.deflection[:, i], -limit, limit, angle)
        found += beyond("joint range", name, rest.q[:, place], lower[place], upper[place], angle)
    return replace(rest, violations=tuple(found))


def holding_torque(model: FlexibleJointModel, q: np.ndarray) -> np.ndarray:
    """(N, n) joint torques [N m] that hold the links at rest at q (N, nq): gravity less what link effects
    (a cable, a stop) give."""
    q = _rows(model, q)
    gravity = model.body.gravity_torque_batch(q)
    return gravity[:, [joint.idx_v for joint in model.joints]] - _link_torque(model, q)


def deflection(flow: JointFlow, q: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(N,) phi = theta - q at rest under tau_t = load (N,) [N m] with the link at q (N,), internal states of
    effects at 0.

    Raises ModelError when the spring cannot carry the load.
    """
    stiffness = flow.drive.K
    if not flow.nonlinear_spring:
        return load / stiffness
    z = [0.0] * (1 + max((part.slot for part in flow.stateful), default=0))
    phi, found = increasing_roots(
        lambda phi: flow.transmission(_resting(q, phi, 0.0), z) - load,
        load / stiffness,
        np.abs(load) / stiffness + 1e-3,
        stiffness,
    )
    if not np.all(found):
        raise _overloaded(flow, int(np.argmin(found)), load)
    return phi


def _along(
    flow: JointFlow, q: np.ndarray, load: np.ndarray, z: np.ndarray, report: Report = silent
) -> np.ndarray:
    """As `deflection`, but each row starts from the internal states of the one before. Writes the joint's
    states into z (N, nz), whose first row is where they start."""
    phi = np.zeros_like(load)
    if not flow.joint.rigid:
        phi[0] = deflection(flow, q[:1], load[:1])[0]
    stiffness = flow.drive.K
    for k in range(1, len(load)):
        if k % ROWS_TOLD == 0:
            report(k / len(load), flow.joint.name)
        z[k, :] = np.where(_own(flow, z.shape[1]), z[k - 1], z[k])
        before = z[k].tolist()

        def moved(x: np.ndarray, k: int = k, before: list[float] = before) -> list[np.ndarray | float]:
            s = _resting(q[k], x, load[k])
            s.dq = (q[k] - q[k - 1]) / SLOW
            s.dphi = (x - phi[k - 1]) / SLOW
            s.dtheta = s.dq + s.dphi
            after: list[np.ndarray | float] = list(before)
            for slot, value in flow.advanced(s, before, SLOW):
                after[slot] = value
            return after

        def missing(x: np.ndarray, k: int = k) -> np.ndarray:
            return flow.transmission(_resting(q[k], x, 0.0), moved(x)) - load[k]

        if not flow.joint.rigid:
            reach = np.array([abs(load[k] - load[k - 1]) / stiffness + 1e-6])
            x, found = increasing_roots(missing, phi[k - 1 : k], reach, stiffness)
            if not found[0]:
                raise _overloaded(flow, k, load)
            phi[k] = x[0]
        z[k, :] = [float(np.ravel(value)[0]) for value in moved(phi[k : k + 1])]
    return phi


def _own(flow: JointFlow, size: int) -> np.ndarray:
    """(nz,) which internal states are this joint's."""
    out = np.zeros(size, dtype=bool)
    out[[part.slot for part in flow.stateful]] = True
    return out


def _needed(
    model: FlexibleJointModel, resting: Sequence[Signals], load: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """(N, n) torques that the motors have to give, each at its own position: of a coupled one not the
    joint's."""
    needed = np.empty_like(load)
    for i, (flow, s) in enumerate(_motors(model, resting)):
        needed[:, i] = s.tau_t - flow.torques(s, z.T)[0]
    for group in model.groups:
        at_joints = np.zeros((len(model.flows), len(load)))
        of = {i: resting[i] for i in group.joints}
        for shaft in group.shafts:
            if not shaft.takes:  # what else acts on these joints
                torque = shaft.flow.torques(shaft.signals(of), z.T)[0]
                for i, share in shaft.turns.items():
                    at_joints[i] += share * torque
        for shaft in group.shafts:
            if shaft.takes:
                needed[:, shaft.joint] -= shaft.torque({i: at_joints[i] for i in group.joints})
    return needed


def _motors(model: FlexibleJointModel, of: Sequence[Signals]) -> list[tuple[JointFlow, Signals]]:
    """Each joint's motor, with what its laws see."""
    out = list(zip(model.flows, of, strict=True))
    for group in model.groups:
        for shaft in group.shafts:
            if shaft.takes:
                out[shaft.joint] = shaft.flow, shaft.signals({i: of[i] for i in group.joints})
    return out


def _commanded(resting: Sequence[Signals], tau_m: np.ndarray) -> list[Signals]:
    """The signals with commands (N, n), of which they are views."""
    out = []
    for i, s in enumerate(resting):
        before, after = neighbours(tau_m.T, i)
        out.append(replace(s, tau_m=tau_m[:, i], tau_m_before=before, tau_m_after=after))
    return out


def _commands(
    model: FlexibleJointModel, resting: Sequence[Signals], needed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, n) the commands that give the motors the torques needed, and the torques that they do give: joint
    after joint, again as long as a command acts on a neighbour's motor too."""
    tau_m, given = _at_joints(model, needed), np.empty_like(needed)
    own = needed.copy()  # commands, each at its motor
    commanded = _commanded(resting, tau_m)
    for _ in range(SWEEPS):
        before = tau_m.copy()
        for i in range(len(model.flows)):
            flow, s = _motors(model, commanded)[i] if i in model.grouped else (model.flows[i], commanded[i])
            own[:, i], given[:, i] = _command(flow, s, needed[:, i])
            tau_m[:, i] = own[:, i]
            if i in model.grouped:
                tau_m[:] = _at_joints(model, own)
        if np.all(np.abs(tau_m - before) <= REACHED * (1.0 + np.abs(tau_m))):
            return tau_m, given
    raise ModelError(
        "the joints' commands act on each other so much that none hold this pose; check the effects on the"
        " command"
    )


def _at_joints(model: FlexibleJointModel, motors: np.ndarray) -> np.ndarray:
    """(N, n) torques at the joints from those of the motors."""
    out = motors.copy()
    for group in model.groups:
        own = [motors[:, shaft.joint] if shaft.takes else 0.0 for shaft in group.shafts]
        for i, torque in group.at_joints(own).items():
            out[:, i] = torque
    return out


def _command(flow: JointFlow, s: Signals, needed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The commands (N,) that give the motor torques needed (N,), and the torques that they do give: less
    where the command saturates."""
    start = needed.copy()
    if np.array_equal(flow.steady_command(s, start), needed):
        return start, needed.copy()
    reach = np.abs(needed) + 1.0
    rises = flow.steady_command(s, start + reach) - flow.steady_command(s, start - reach)
    way = np.where(rises < 0.0, -1.0, 1.0)  # a gain below -1 turns the command round
    x, found = increasing_roots(
        lambda x: way * (flow.steady_command(s, x) - needed), start, reach, steepness=1.0
    )
    tau_m = np.where(found, x, needed)
    given = flow.steady_command(s, tau_m) + np.zeros_like(needed)
    close = found & (np.abs(given - needed) <= REACHED * (1.0 + np.abs(needed)))
    return tau_m, np.where(close, needed, given)


def _link_torque(model: FlexibleJointModel, q: np.ndarray) -> np.ndarray:
    """(N, n) torques of link effects at rest."""
    out = np.zeros((len(q), len(model.joints)))
    z = np.zeros((model.nz, 1))
    for i, flow in enumerate(model.flows):
        x = q[:, flow.joint.idx_q]
        out[:, i] = flow.torques(Signals(q=x, theta=x), z)[1]
    return out


def _resting(q: np.ndarray, phi: np.ndarray, tau_t: np.ndarray | float) -> Signals:
    """Signals of a joint at rest."""
    return Signals(q=q, theta=q + phi, phi=phi, tau_t=tau_t)


def _overloaded(flow: JointFlow, pose: int, load: np.ndarray) -> ModelError:
    return ModelError(
        f"pose {pose}: the spring of joint {flow.joint.name} cannot carry the load of {load[pose]:.6g} N m at"
        " rest; check its effects' parameters"
    )


def _rows(model: FlexibleJointModel, q: np.ndarray) -> np.ndarray:
    if model.symbolic:
        raise ModelError("equilibrium needs numbers: build the model with PinBody, its default")
    rows = np.atleast_2d(np.asarray(q, dtype=float))
    if rows.ndim != 2 or rows.shape[1] != model.nq or len(rows) == 0:
        raise ModelError(f"q: expected (N, {model.nq}) link positions, N > 0, got shape {np.shape(q)}")
    wrong = np.flatnonzero(~np.all(np.isfinite(rows), axis=1))
    if wrong.size:
        raise ModelError(f"q: pose {wrong[0]} has a number that is not finite; leave such poses out")
    return rows


def _checked_forces(forces: np.ndarray, poses: int, contacts: int) -> np.ndarray:
    values = np.asarray(forces, dtype=float)
    if values.shape == (contacts, 6):
        values = np.broadcast_to(values, (poses, contacts, 6))
    if values.shape != (poses, contacts, 6) or not np.all(np.isfinite(values)):
        raise ModelError(
            f"forces: expected finite numbers of shape ({poses}, {contacts}, 6), force before moment of each"
            f" contact, got shape {np.shape(forces)}"
        )
    return np.array(values)
