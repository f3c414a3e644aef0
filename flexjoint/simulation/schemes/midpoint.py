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
armature. Joints whose motors turn together are in coupled.py.

Where what rings turns within a few steps, that prediction fails, and velocity forces of the wrong sign make
energy and momentum. So a step whose midpoint comes out elsewhere than predicted takes the links' velocity
forces at the midpoint that came out, and again until it stays. Its end velocities are then put right
(`conservation`): the links gain, to rounding, the energy that torques and gravity did in work. With linear
springs the whole step is passive. What flies freely is put right in every step, and keeps its momentum. Where
repeating does not converge, the step takes the mass matrix of its start and no velocity forces: of order 1,
and passive however long it is.

Expressions are one pass, smooth in state and torque: they neither repeat nor put right. Nor do steps on rigid
ground, or of joints whose motors turn together.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import ModelError, StabilityWarning
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.contact.compliant import Touch
from flexjoint.model.contact.rigid import HalfStep, RigidContacts, RigidGround
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.joint import JointFlow
from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step, midpoint_matrix
from flexjoint.simulation.schemes.conservation import Conservation
from flexjoint.simulation.schemes.coupled import GroupStep, tied_step
from flexjoint.simulation.schemes.friction import SWEEPS, TINY, directed, friction_forces, rubbed
from flexjoint.simulation.schemes.midway import Midway

MISSED = 3e-3  # of the largest velocity: a midpoint that is off by more was predicted badly
STAYS = 1e-4  # of it: a repeated one that moves by less stays
NEGLIGIBLE = 1e-7  # [rad] or [m] a step: a midpoint velocity may be off by as much at any rate
REPEATS = 8  # passes after the first; each shrinks the error about h |v| times
GROWS = 2.0  # times the error before: repeating does not converge
# [rad] a step by which a link turns at most where repeating converges: up to 3.6 it did on UR5 with 1e5 times
# its stiffness and a floating arm, released from up to 0.1 rad; from 2.5 on it sometimes did not
FOLLOWED = 2.0


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
            if i not in model.grouped and (flow.busy or flow.joint.rigid)
        ]
        self.stateful = any(flow.stateful for flow in model.flows) or any(
            shaft.flow.stateful for group in model.groups for shaft in group.shafts
        )
        self.rubbing = [
            i
            for i, flow in enumerate(model.flows)
            if flow.link_rubs or (flow.joint.rigid and flow.motor_rubs and i not in model.grouped)
        ]
        self.turning = [  # shafts that rub on links
            (g, shaft)
            for g, group in enumerate(model.groups)
            for shaft in group.shafts
            if group.rigid and shaft.flow.motor_rubs
        ]
        self.sweeps = 1 if len(self.rubbing) + len(self.turning) == 1 else SWEEPS
        if model.groups and isinstance(model.ground, RigidGround):
            raise ModelError(
                "rigid ground takes no motors that several joints share"
                f" ({model.joints[min(model.grouped)].name}); use ground: compliant"
            )
        self.rotors = model.zeros(model.nv)
        for i in model.rigid:
            self.rotors[joints[i].idx_v] = model.flows[i].drive.B
        self.conservation = Conservation(model, h)
        # a single link has no velocity forces; impacts are no sign of a bad prediction
        self.repeats = model.nv > 1 and not isinstance(model.ground, RigidGround) and not model.groups
        self.told = False  # whether it has warned
        self.bending = slice(3 if self.conservation.floating else 0, model.nv)  # whatever flies along
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
        turned = self.h * float(np.abs(x.v[self.bending]).max())
        if turned > FOLLOWED and not self.told:
            self.told = True
            warn_of_order_one(x.t, turned, 1.0 / self.h)
        still = np.zeros(self.model.nv)
        made = self.one_pass(x, tau_m, still, still)
        made.end.v, _ = self._put_right(x, made)
        return made.end

    def _missed_by(self, v_mid: np.ndarray, guess: np.ndarray) -> tuple[float, float]:
        """How far a midpoint velocity (nv,) is from its guess, and what that has to be compared with."""
        bending = self.bending
        error = float(np.abs(v_mid[bending] - guess[bending]).max())
        return error, max(float(np.abs(v_mid[bending]).max()), NEGLIGIBLE / (MISSED * self.h))

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
        groups: list[GroupStep] = []
        if self.special or model.groups:
            c1, armature = ops.copy(c1), ops.copy(armature)
            at = Midway(model, x, q_mid, v_mid, tau_m)
            for i, k, flow in self.special:
                line = _rigid(flow, at, i, a) if k < 0 else _flexible(flow, at, i, k, a)
                lines[i] = line
                tau[flow.joint.idx_v], armature[flow.joint.idx_v] = line.tau, line.armature
                if k >= 0:
                    c0[k], c1[k] = line.c0, line.c1
            for group in model.groups:
                groups.append(tied_step(model, group, at, a))
                for r, i in enumerate(group.joints):
                    lines[i] = Line(
                        groups[-1].signals[i], groups[-1].tau[r], groups[-1].armature[r], tied=True
                    )
                    place = model.joints[i].idx_v
                    tau[place], armature[place] = lines[i].tau, lines[i].armature
        touch = None
        half = None
        if model.ground is not None and self.rigid_contacts is None:
            touch = model.ground.touch(model.body, q_mid, v_mid, x.z, a)
            tau = tau + touch.tau
        if way is not x.v:
            q_mid = model.body.integrate(x.q, a * way)
        blocks = [(model.places(tied.group), tied.block) for tied in groups]
        accelerate = model.accelerating(q_mid, guess, armature, blocks)
        acc, force = accelerate(tau), tau
        if self.rigid_contacts is not None:
            half = self.rigid_contacts.first_half(q_mid, x.v, x.z, acc, armature)
            acc = half.acc
        rubs: list[Rub] = []
        if self.rubbing or self.turning:
            acc, rubs = self._rub(x, accelerate, tau, acc, lines, groups)
            force = ops.copy(tau)
            for i in self.rubbing:
                place = model.joints[i].idx_v
                force[place] = force[place] - lines[i].friction
        v_mid = x.v + a * acc
        work = self.h * ops.dot(v_mid, force - (armature - self.rotors) * acc)
        return Pass(self._finish(x, tau_m, acc, c0, c1, lines, groups, rubs, touch, half), v_mid, work)

    def _rub(
        self,
        x: State,
        accelerate: Callable[[Value], Value],
        tau: Value,
        acc: Value,
        lines: dict[int, Line],
        groups: Sequence[GroupStep],
    ) -> tuple[Value, list[Rub]]:
        """The acceleration under the links' dry friction f, which stops what it can of the midpoint velocity
        v + a (acc - M^-1 f), and that of shafts of rigid joints, n (v + a (acc - M^-1 n f)).

        The columns M^-1 e_j, or M^-1 n, come from the same ABA, which is affine in tau.
        """
        model, a = self.model, self.a
        found = [Rub({model.joints[i].idx_v: 1.0}) for i in self.rubbing]
        found += [
            Rub({model.joints[j].idx_v: share for j, share in shaft.turns.items()})
            for _, shaft in self.turning
        ]
        columns, free, levels = [], [], []
        for rub in found:
            unit = ops.copy(tau)
            for place, share in rub.turns.items():
                unit[place] = unit[place] + share
            columns.append(accelerate(unit) - acc)
            free.append(rub.along(x.v) + a * rub.along(acc))
        for i, velocity in zip(self.rubbing, free, strict=False):
            levels.append(lines[i].link_level(model.flows[i], x.z, velocity))
        for (g, shaft), velocity in zip(self.turning, free[len(self.rubbing) :], strict=True):
            s = groups[g].shaft_signals[model.groups[g].shafts.index(shaft)]
            s.dtheta = s.dq = directed(s.dtheta, velocity)
            levels.append(shaft.flow.motor_level(s, x.z))
        coupling = [[a * rub.along(column) for column in columns] for rub in found]
        force = friction_forces(free, levels, coupling, self.sweeps, model.symbolic)
        for column, own in zip(columns, force, strict=True):
            acc = acc - column * own
        for j, rub in enumerate(found):
            own = rub.along(columns[j])
            rub.sticks = ops.absolute(force[j]) < levels[j]
            rub.free, rub.shed = rub.along(acc) + own * force[j], own * levels[j]
            rub.response = columns[j] / own
        for i, own in zip(self.rubbing, force, strict=False):
            lines[i].friction = own
        for (g, shaft), own in zip(self.turning, force[len(self.rubbing) :], strict=True):
            groups[g].friction[model.groups[g].shafts.index(shaft)] = own
        return acc, found

    def _finish(
        self,
        x: State,
        tau_m: Value,
        acc: Value,
        c0: Value,
        c1: Value,
        lines: dict[int, Line],
        groups: Sequence[GroupStep],
        rubs: Sequence[Rub],
        touch: Touch | None,
        half: HalfStep | None,
    ) -> State:
        model, h, a = self.model, self.h, self.a
        v_mid = x.v + a * acc
        v = v_mid + a * acc
        carried = acc
        if rubs:
            acc = ops.copy(acc)
        for i, rub in zip(self.rubbing, rubs, strict=False):
            place = model.joints[i].idx_v
            v_mid[place] = ops.where(rub.sticks, 0.0, v_mid[place])
            v[place], acc[place] = rubbed(x.v[place], v_mid[place], rub.free, rub.shed, h)
        for rub in rubs[len(self.rubbing) :]:
            v_mid = v_mid - rub.response * ops.where(rub.sticks, rub.along(v_mid), 0.0)
            before, middle = rub.along(x.v), rub.along(v_mid)
            end, rate = rubbed(before, middle, rub.free, rub.shed, h)
            v, acc = v + rub.response * (end - rub.along(v)), acc + rub.response * (rate - rub.along(acc))
        w_mid = c0 + c1 * _entries(v_mid, self.of_v)
        for tied in groups:
            tied.turn(w_mid, v_mid)
        w = 2.0 * w_mid - x.dtheta
        ddtheta = (w_mid - x.dtheta) / a
        tau_rigid = ops.copy(x.tau_rigid)
        for i, k, flow in self.special:
            if k < 0:
                tau_rigid[model.rigid.index(i)] = lines[i].carried(carried[flow.joint.idx_v])
            elif flow.motor_rubs:
                line = lines[i]
                w[k], ddtheta[k] = rubbed(x.dtheta[k], w_mid[k], line.free, line.shed, h)
        for tied in groups:
            tied.finish(x.dtheta, w_mid, carried, a, (w, ddtheta, tau_rigid))
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
        at = Midway(model, x, q_mid, v_mid, tau_m)
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
        for group in model.groups:
            of = {}
            for i in group.joints:
                k = -1 if group.rigid else model.flexible.index(i)
                of[i] = s = at.signals(i, k, self.a)
                if k >= 0:
                    s.theta, s.dtheta = at.theta[k] + self.a * speeds[k], speeds[k]
                    s.phi, s.dphi = s.theta - s.q, s.dtheta - s.dq
            for shaft in group.shafts:
                for slot, value in shaft.flow.advanced(of[shaft.joint], at.z, self.h, shaft.signals(of)):
                    z[slot] = value
        return z


def warn_of_order_one(t: float, turned: float, rate: float) -> None:
    """Warn (StabilityWarning) that from time t [s] on there are steps of order 1, within which a link turned
    by so much [rad]."""
    warnings.warn(
        f"from t = {t:.4g} s on {DEFAULT} does not follow the motion at a physics rate of {rate:g} Hz: a link"
        f" turned by {turned:.3g} rad within a step, as where springs ring that next to nothing damps. Energy"
        " and momentum hold, but such steps are of order 1; use a physics rate of"
        f" {math.ceil(rate * turned / FOLLOWED):g} Hz or more",
        StabilityWarning,
        stacklevel=4,
    )


@dataclass(frozen=True, slots=True)
class Pass:
    """A step's end, its midpoint velocity v_mid (nv,) by the midpoint rule alone, and the work of the torques
    on the links over it [J]."""

    end: State
    v_mid: Value
    work: Value


@dataclass(slots=True)
class Rub:
    """Dry friction that acts on links, along `turns` by place in v: a link's own, or that of a shaft."""

    turns: dict[int, Value]
    sticks: Value = False
    free: Value = 0.0  # accelerations: without its friction, and by its level
    shed: Value = 0.0
    response: Value = 0.0  # (nv,) change of the velocities where it changes its own by one

    def along(self, velocity: Value) -> Value:
        return sum((share * velocity[place] for place, share in self.turns.items()), 0.0)


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
    motor: Value = 0.0  # a rigid joint's motor: torque, inertia, dry friction
    inertia: Value = 0.0
    motor_level: Value = 0.0
    tied: bool = False  # whether its motor is one of a group's shafts

    def link_level(self, flow: JointFlow, z: Value, velocity: Value) -> Value:
        """Bound of the dry friction on the link; a rigid joint's motor rubs there too."""
        s = self.signals
        s.dq = directed(s.dq, velocity)
        self.level = flow.link_level(s, z)
        if flow.joint.rigid and not self.tied:
            s.dtheta = s.dq
            self.motor_level = flow.motor_level(s, z)
            self.level = self.level + self.motor_level
        return self.level

    def carried(self, acc: Value) -> Value:
        """Torque through a rigid transmission: the motor's less what moves the motor and its friction."""
        return self.motor - self.inertia * acc - self.friction * self.motor_level / (self.level + TINY)


def _flexible(flow: JointFlow, at: Midway, i: int, k: int, a: float) -> Line:
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


def _rigid(flow: JointFlow, at: Midway, i: int, a: float) -> Line:
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


def _entries(vector: Value, places: Any) -> Value:
    """Entries of a vector; none of a CasADi scalar come as a row, which a column does not add to."""
    out = vector[places]
    return out.T if out.shape == (1, 0) else out


def _places(indices: list[int]) -> Any:
    """Indices of a vector's entries: a slice where they are consecutive (much quicker), else a list."""
    if indices == list(range(len(indices))):
        return slice(0, len(indices))
    return indices
