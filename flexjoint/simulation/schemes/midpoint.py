"""The default scheme: linearly implicit midpoint with dry friction as a set.

With a = h/2 the motor and spring equations at the midpoint,

    B (w - dtheta)/a = tau - D_m w - tau_t,    tau_t = r + k_d (w - v_mid),    k_d = a K + D,

are linear in the motor's midpoint velocity: w = c0 + c1 v_mid. That leaves the link a constant torque
r + k_d c0 - kappa v and, as v_mid = v + a acc, an armature a kappa, with kappa = k_d (1 - c1): one
articulated-body call solves the whole step. r = K phi for a linear spring; others are linearised. Forces
that depend on anything else are evaluated at the predicted midpoint (q + a v, v + a acc of the last step,
...), whose error is O(h^2), so order 2 holds; what resists a velocity is linearised in it. Compliant
contacts (`flexjoint.model.contact.compliant`) give such forces; anchors slip at the predicted midpoint. Rigid
ones (`flexjoint.model.contact.rigid`) are impulses on the links' midpoint and end velocities, with that
armature.

Where what rings turns within a few steps, that prediction fails, and velocity forces of the wrong sign make
energy and momentum. So a step whose midpoint comes out elsewhere than predicted takes the links' velocity
forces at the midpoint that came out, and again until it stays. Its end velocities are then put right
(`conservation`): the links gain, to rounding, the energy that torques and gravity did in work. With linear
springs the whole step is passive. What flies freely is put right in every step, and keeps its momentum. Where
repeating does not converge, the step takes the mass matrix of its start and no velocity forces: of order 1,
and passive however long it is.

Expressions are one pass, smooth in state and torque: they neither repeat nor put right. Nor do steps on rigid
ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.contact.compliant import Touch
from flexjoint.model.contact.rigid import HalfStep, RigidContacts, RigidGround
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.joint import JointFlow, neighbours
from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step, midpoint_matrix
from flexjoint.simulation.schemes.conservation import Conservation
from flexjoint.simulation.schemes.friction import SWEEPS, TINY, directed, friction_forces

MISSED = 3e-3  # of the largest velocity: a midpoint that is off by more was predicted badly
STAYS = 1e-4  # of it: a repeated one that moves by less stays
NEGLIGIBLE = 1e-7  # [rad] or [m] a step: a midpoint velocity may be off by as much at any rate
REPEATS = 8  # passes after the first; each shrinks the error about h |v| times
GROWS = 2.0  # times the error before: repeating does not converge


class LinearlyImplicitMidpoint(Scheme):
    """The default: stable for any stiffness and damping of the joints; dry friction sticks, and `width` is
    not used. See the head of this file."""

    name = DEFAULT
    order = 2
    sticks = True
    any_stiffness = True
    aba_calls = 1  # where the prediction holds
    repeats = True
    rigid_ground = True
    slips = True  # at its midpoint
    contact_damping = 1.0  # the damper sees a predicted velocity

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        return Midpoint(model, h).step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        return midpoint_matrix(A, h)


class Midpoint:
    """The scheme for one model and step h [s]; `step` maps (state, tau_m (n,)) to the state h later.

    Numbers and CasADi run through the same lines, except that expressions are one pass.
    """

    def __init__(self, model: FlexibleJointModel, h: float) -> None:
        self.model, self.h, self.a = model, h, 0.5 * h
        a, joints = self.a, model.joints
        drives = [model.flows[i].drive for i in model.flexible]
        self.K, self.B = (model.vector(getattr(d, name) for d in drives) for name in ("K", "B"))
        D, D_m = (model.vector(getattr(d, name) for d in drives) for name in ("D", "D_m"))
        self.kd = a * self.K + D
        self.den = self.B + a * (D_m + self.kd)
        self.c1 = a * self.kd / self.den
        self.kap = self.kd * (1.0 - self.c1)
        self.of_q = _places([joints[i].idx_q for i in model.flexible])
        self.of_v = _places([joints[i].idx_v for i in model.flexible])
        self.of_u = _places(list(model.flexible))
        self.armature = model.zeros(model.nv)
        self.armature[self.of_v] = a * self.kap
        self.special = [
            (i, model.flexible.index(i) if i in model.flexible else -1, flow)
            for i, flow in enumerate(model.flows)
            if flow.busy or flow.joint.rigid
        ]
        self.stateful = any(flow.stateful for flow in model.flows)
        self.rubbing = [
            i
            for i, flow in enumerate(model.flows)
            if flow.link_rubs or (flow.joint.rigid and flow.motor_rubs)
        ]
        self.sweeps = 1 if len(self.rubbing) == 1 else SWEEPS
        self.rotors = model.zeros(model.nv)
        for i in model.rigid:
            self.rotors[joints[i].idx_v] = model.flows[i].drive.B
        self.conservation = Conservation(model, h)
        # a single link has no velocity forces; impacts are no sign of a bad prediction
        self.repeats = model.nv > 1 and not isinstance(model.ground, RigidGround)
        self.turning = slice(3 if self.conservation.floating else 0, model.nv)  # whatever flies along
        self.rigid_contacts = (
            RigidContacts(model.ground, model.body, [model.flows[i].joint.name for i in self.rubbing], h)
            if isinstance(model.ground, RigidGround)
            else None
        )

    def step(self, x: State, tau_m: Value) -> State:
        guess = x.v + self.a * x.acc
        made = self.one_pass(x, tau_m, x.v, guess)
        if self.model.symbolic or not self.repeats:
            return made.end
        error, scale = self._missed_by(made.v_mid, guess)
        repeated = not error <= MISSED * scale
        if repeated:
            for _ in range(REPEATS):
                guess, before = made.v_mid, error
                made = self.one_pass(x, tau_m, guess, guess)
                error, scale = self._missed_by(made.v_mid, guess)
                if error <= STAYS * scale or not error <= GROWS * before:
                    break
        if error <= MISSED * scale:
            if not repeated and not self.conservation.free:
                return made.end
            v, fits = self._put_right(x, made)
            if fits:
                made.end.v = v
                return made.end
        still = np.zeros(self.model.nv)
        made = self.one_pass(x, tau_m, still, still)
        made.end.v, _ = self._put_right(x, made)
        return made.end

    def _missed_by(self, v_mid: np.ndarray, guess: np.ndarray) -> tuple[float, float]:
        """How far a midpoint velocity (nv,) is from its guess, and what that has to be compared with."""
        turning = self.turning
        error = float(np.abs(v_mid[turning] - guess[turning]).max())
        return error, max(float(np.abs(v_mid[turning]).max()), NEGLIGIBLE / (MISSED * self.h))

    def _put_right(self, x: State, made: Pass) -> tuple[np.ndarray, bool]:
        """The end velocity (nv,) of a pass from x that keeps what is to be kept, and whether it is sound."""
        keeps, end = self.conservation, made.end
        passed = 2.0 * made.v_mid - x.v
        before, after = keeps.totals(x.q, x.v), keeps.totals(end.q, passed)
        v, fits = keeps.put_right(before, after, end.q, passed, end.v, made.work)
        return v, bool(fits)

    def one_pass(self, x: State, tau_m: Value, way: Value, guess: Value) -> Pass:
        """The step with the links' velocity forces at `guess` (nv,), half a step along `way` (nv,); all else
        at the midpoint that is predicted."""
        model, a = self.model, self.a
        q_mid = model.body.integrate(x.q, a * x.v)
        v_mid = x.v + a * x.acc
        spring = self.K * (x.theta - _entries(x.q, self.of_q))
        c0 = (self.B * x.dtheta + a * (_entries(tau_m, self.of_u) - spring)) / self.den
        c1, armature = self.c1, self.armature
        tau = model.zeros(model.nv)
        tau[self.of_v] = spring + self.kd * c0 - self.kap * _entries(x.v, self.of_v)
        lines: dict[int, Line] = {}
        if self.special:
            c1, armature = ops.copy(c1), ops.copy(armature)
            at = _Midway(model, x, q_mid, v_mid, tau_m)
            for i, k, flow in self.special:
                line = _rigid(flow, at, i, a) if k < 0 else _flexible(flow, at, i, k, a)
                lines[i] = line
                tau[flow.joint.idx_v], armature[flow.joint.idx_v] = line.tau, line.armature
                if k >= 0:
                    c0[k], c1[k] = line.c0, line.c1
        touch = None
        half = None
        if model.ground is not None and self.rigid_contacts is None:
            touch = model.ground.touch(model.body, q_mid, v_mid, x.z, a)
            tau = tau + touch.tau
        if way is not x.v:
            q_mid = model.body.integrate(x.q, a * way)
        acc = model.body.aba(q_mid, guess, tau, armature)
        force = tau
        if self.rigid_contacts is not None:
            half = self.rigid_contacts.first_half(q_mid, x.v, x.z, acc, armature)
            acc = half.acc
        if self.rubbing:
            acc = self._rub(x, q_mid, guess, tau, armature, acc, lines)
            force = ops.copy(tau)
            for i in self.rubbing:
                place = model.joints[i].idx_v
                force[place] = force[place] - lines[i].friction
        v_mid = x.v + a * acc
        work = self.h * ops.dot(v_mid, force - (armature - self.rotors) * acc)
        return Pass(self._finish(x, tau_m, acc, c0, c1, lines, touch, half), v_mid, work)

    def _rub(
        self,
        x: State,
        q_mid: Value,
        v_mid: Value,
        tau: Value,
        armature: Value,
        acc: Value,
        lines: dict[int, Line],
    ) -> Value:
        """The acceleration under the links' dry friction f, which stops what it can of the midpoint velocity
        v + a (acc - M^-1 f).

        The columns M^-1 e_j come from the same ABA, which is affine in tau.
        """
        model, a = self.model, self.a
        places = [model.joints[i].idx_v for i in self.rubbing]
        columns, free, levels = [], [], []
        for i, place in zip(self.rubbing, places, strict=True):
            unit = ops.copy(tau)
            unit[place] = unit[place] + 1.0
            columns.append(model.body.aba(q_mid, v_mid, unit, armature) - acc)
            free.append(x.v[place] + a * acc[place])
            levels.append(lines[i].link_level(model.flows[i], x.z, free[-1]))
        coupling = [[a * column[place] for column in columns] for place in places]
        force = friction_forces(free, levels, coupling, self.sweeps, model.symbolic)
        count = range(len(places))
        for j in count:
            acc = acc - columns[j] * force[j]
        for j in count:
            line, own = lines[self.rubbing[j]], columns[j][places[j]]
            line.friction, line.link_sticks = force[j], ops.absolute(force[j]) < levels[j]
            line.link_free, line.link_shed = acc[places[j]] + own * force[j], own * levels[j]
        return acc

    def _finish(
        self,
        x: State,
        tau_m: Value,
        acc: Value,
        c0: Value,
        c1: Value,
        lines: dict[int, Line],
        touch: Touch | None,
        half: HalfStep | None,
    ) -> State:
        model, h, a = self.model, self.h, self.a
        v_mid = x.v + a * acc
        v = v_mid + a * acc
        carried = acc
        if self.rubbing:
            acc = ops.copy(acc)
        for i in self.rubbing:
            place, line = model.joints[i].idx_v, lines[i]
            v_mid[place] = ops.where(line.link_sticks, 0.0, v_mid[place])
            v[place], acc[place] = _rubbed(x.v[place], v_mid[place], line.link_free, line.link_shed, h)
        w_mid = c0 + c1 * _entries(v_mid, self.of_v)
        w = 2.0 * w_mid - x.dtheta
        ddtheta = (w_mid - x.dtheta) / a
        tau_rigid = ops.copy(x.tau_rigid)
        for i, k, flow in self.special:
            if k < 0:
                tau_rigid[model.rigid.index(i)] = lines[i].carried(carried[flow.joint.idx_v])
            elif flow.motor_rubs:
                line = lines[i]
                w[k], ddtheta[k] = _rubbed(x.dtheta[k], w_mid[k], line.free, line.shed, h)
        z = self._advance(x, tau_m, v_mid, w_mid) if self.stateful else x.z
        if touch is not None and model.ground is not None:
            rolled = [s + a * rate for s, rate in zip(touch.anchors, touch.rates, strict=True)]
            z = model.ground.with_anchors(model.body, z, rolled)
        q, theta = model.body.integrate(x.q, h * v_mid), x.theta + h * w_mid
        if half is not None and self.rigid_contacts is not None and model.ground is not None:
            v, forces = self.rigid_contacts.second_half(half, q, v)
            acc = (v - v_mid) / a  # of the second half: an impact is over then
            z = model.ground.with_anchors(model.body, z, forces.ravel().tolist())
        return State(x.t + h, q, v, theta, w, z, acc, ddtheta, tau_rigid)

    def _advance(self, x: State, tau_m: Value, v_mid: Value, w_mid: Value) -> Value:
        """Internal states a step later, driven by the midpoint's velocities."""
        model = self.model
        z = ops.copy(x.z)
        q_mid = model.body.integrate(x.q, self.a * v_mid)
        at = _Midway(model, x, q_mid, v_mid, tau_m)
        speeds = ops.items(w_mid)
        for i, k, flow in self.special:
            if not flow.stateful:
                continue
            s = at.signals(i, k, self.a)
            if k >= 0:
                s.theta, s.dtheta = at.theta[k] + self.a * speeds[k], speeds[k]
                s.phi, s.dphi = s.theta - s.q, s.dtheta - s.dq
            for slot, value in flow.advanced(s, at.z, self.h):
                z[slot] = value
        return z


@dataclass(frozen=True, slots=True)
class Pass:
    """A step's end, its midpoint velocity v_mid (nv,) by the midpoint rule alone, and the work of the torques
    on the links over it [J]."""

    end: State
    v_mid: Value
    work: Value


@dataclass(slots=True)
class Line:
    """What a joint with effects contributes to a step."""

    signals: Signals  # at the predicted midpoint
    tau: Value  # torque and armature on its link
    armature: Value
    c0: Value = 0.0  # the motor's midpoint velocity is c0 + c1 v_mid
    c1: Value = 0.0
    free: Value = 0.0  # accelerations of the motor: without dry friction, and by its level
    shed: Value = 0.0
    friction: Value = 0.0  # of the link, within its level
    level: Value = 0.0
    link_sticks: Value = False
    link_free: Value = 0.0  # accelerations of the link: without its dry friction, and by its level
    link_shed: Value = 0.0
    motor: Value = 0.0  # a rigid joint's motor: torque, inertia, dry friction
    inertia: Value = 0.0
    motor_level: Value = 0.0

    def link_level(self, flow: JointFlow, z: Value, velocity: Value) -> Value:
        """Bound of the dry friction on the link; a rigid joint's motor rubs there too."""
        s = self.signals
        s.dq = directed(s.dq, velocity)
        self.level = flow.link_level(s, z)
        if flow.joint.rigid:
            s.dtheta = s.dq
            self.motor_level = flow.motor_level(s, z)
            self.level = self.level + self.motor_level
        return self.level

    def carried(self, acc: Value) -> Value:
        """Torque through a rigid transmission: the motor's less what moves the motor and its friction."""
        return self.motor - self.inertia * acc - self.friction * self.motor_level / (self.level + TINY)


def _flexible(flow: JointFlow, at: _Midway, i: int, k: int, a: float) -> Line:
    """A flexible joint with effects; the formulas of this file's head with all terms."""
    s = at.signals(i, k, a)
    drive, w, phi, v = flow.drive, at.dtheta[k], at.theta[k] - at.q[flow.joint.idx_q], at.v[flow.joint.idx_v]
    if flow.nonlinear_spring:
        tau_t, stiffness, damping = flow.linear_spring(s, at.z, a)
        r, kd = tau_t + stiffness * (phi - s.phi) - damping * s.dphi, a * stiffness + damping
    else:
        r, kd = drive.K * phi, a * drive.K + drive.D
    s.tau_t = r + kd * s.dphi
    on_motor, resists = flow.motor(s, at.z, a)
    den = drive.B + a * (drive.D_m + resists + kd)
    commanded = flow.command(s, s.tau_m, at.z, 2.0 * a)
    push = drive.B * w + a * (commanded + on_motor + resists * s.dtheta - r)
    c0, c1, free, shed = push / den, a * kd / den, 0.0, 0.0
    if flow.motor_rubs:
        wanted = push + a * kd * s.dq  # den times the midpoint velocity that dry friction has to stop
        velocity = s.dtheta
        s.dtheta = directed(velocity, wanted)
        level = a * flow.motor_level(s, at.z)
        s.dtheta = velocity
        sticks = ops.absolute(wanted) <= level
        free, shed = (wanted / den - w) / a, level / (a * den)
        c0 = ops.where(sticks, 0.0, (push - ops.where(wanted < 0.0, -level, level)) / den)
        c1 = ops.where(sticks, 0.0, c1)
    kap = kd * (1.0 - c1)
    on_link, link_resists = flow.link(s, at.z, a)
    tau = r + kd * c0 - kap * v + on_link + link_resists * (s.dq - v)
    return Line(s, tau, a * (kap + link_resists), c0, c1, free, shed)


def _rigid(flow: JointFlow, at: _Midway, i: int, a: float) -> Line:
    """A rigid joint: the motor's inertia and damping act on the link."""
    s = at.signals(i, -1, a)
    drive, v = flow.drive, at.v[flow.joint.idx_v]
    on_motor, resists = flow.motor(s, at.z, a)
    on_link, link_resists = flow.link(s, at.z, a)
    motor = flow.command(s, s.tau_m, at.z, 2.0 * a) + on_motor + resists * (s.dq - v) - drive.D_m * v
    inertia = drive.B + a * (drive.D_m + resists)
    line = Line(s, motor + on_link + link_resists * (s.dq - v), inertia + a * link_resists)
    line.motor, line.inertia = motor, inertia
    return line


class _Midway:
    """A state and its predicted midpoint as scalars, and the signals of a joint there."""

    def __init__(self, model: FlexibleJointModel, x: State, q_mid: Value, v_mid: Value, tau_m: Value) -> None:
        items = ops.items
        self.model, self.joints, self.t = model, model.joints, x.t
        self.q, self.v, self.q_mid, self.v_mid = items(x.q), items(x.v), items(q_mid), items(v_mid)
        self.theta, self.dtheta, self.ddtheta = items(x.theta), items(x.dtheta), items(x.ddtheta)
        self.z, self.tau_m, self.tau_rigid = items(x.z), items(tau_m), items(x.tau_rigid)

    def signals(self, i: int, k: int, a: float) -> Signals:
        """Of the actuated joint i, the k-th flexible one (-1: rigid); phi from the present velocities."""
        joint, beside = self.joints[i], neighbours(self.tau_m, i)
        q, dq, t = self.q_mid[joint.idx_q], self.v_mid[joint.idx_v], self.t + a
        if k < 0:
            tau_t = self.tau_rigid[self.model.rigid.index(i)]
            return Signals(t, q, dq, q, dq, 0.0, 0.0, tau_t, self.tau_m[i], *beside)
        theta, dtheta = self.theta[k] + a * self.dtheta[k], self.dtheta[k] + a * self.ddtheta[k]
        return Signals(t, q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, self.tau_m[i], *beside)


def _rubbed(start: Value, midpoint: Value, free: Value, shed: Value, h: float) -> tuple[Value, Value]:
    """Velocity and acceleration at the end of a step with dry friction, from the velocities at its start
    and midpoint and the accelerations without friction and by its level alone.

    A motion that comes to rest within the step stays there, or turns and goes on for what is left of it:
    the midpoint rule alone would ring about rest for ever.
    """
    side = ops.where(start < 0.0, -1.0, 1.0)
    braking = shed - side * free
    onward = ops.maximum(-side * free - shed, 0.0)
    speed = ops.absolute(start)
    rests = ops.both(speed > 0.0, speed < h * braking)
    left = h - speed / ops.maximum(braking, TINY)
    end = ops.where(rests, -side * onward * left, 2.0 * midpoint - start)
    return end, ops.where(rests, -side * onward, (midpoint - start) / (0.5 * h))


def _entries(vector: Value, places: Any) -> Value:
    """Entries of a vector; none of a CasADi scalar come as a row, which a column does not add to."""
    out = vector[places]
    return out.T if out.shape == (1, 0) else out


def _places(indices: list[int]) -> Any:
    """Indices of a vector's entries: a slice where they are consecutive (much quicker), else a list."""
    if indices == list(range(len(indices))):
        return slice(0, len(indices))
    return indices
