"""A robot with flexible joints and the effects at work on it.

    M(q) a + nle(q, v) = tau_t + tau_link        B ddtheta + D_m dtheta + tau_t = tau + tau_motor
    tau_t = K (theta - q) + D (dtheta - dq) + ...

(Spong 1987; Kameduła et al. 2016, equations 1 to 3.) A rigid joint (infinite stiffness) has theta = q: its
motor's inertia and damping act on the link. A joint that is not actuated swings freely. Motors that turn with
several joints are shafts (`flexjoint.model.shafts`). The class serves numbers and CasADi alike: the body it
is given decides (`PinBody` or `SymbolicBody`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.ops import Value
from flexjoint.effects import Planned, Signals, Site, signal_order
from flexjoint.model.contact.compliant import Ground
from flexjoint.model.contact.rigid import RigidGround
from flexjoint.model.joint import JointFlow, Part, neighbours
from flexjoint.model.shafts import Group, Shaft, Tie, joined
from flexjoint.model.springs import VariableSpring, sprung
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.robot.robot import Robot

Made = TypeVar("Made")
MAX_STATES = 1  # internal states of one effect: its laws take a scalar z


@dataclass(slots=True)
class State:
    """State of a model at time t [s], and what the default scheme remembers of its last step.

    q (nq,), v (nv,) link positions and velocities in the body's order; theta, dtheta (nf,) of the
    flexible joints; z (nz,) internal states of effects, and anchors of contacts; acc (nv,), ddtheta (nf,)
    accelerations at the last step's midpoint; tau_rigid (nr,) transmission torques of the rigid joints there.
    NumPy or CasADi.
    """

    t: Value
    q: Value
    v: Value
    theta: Value
    dtheta: Value
    z: Value
    acc: Value
    ddtheta: Value
    tau_rigid: Value


@dataclass(frozen=True)
class Rates:
    """Time derivative of a state: v (nv,), acc (nv,), dtheta, ddtheta (nf,), dz (nz,); and the
    transmission torques tau_t (n,) of all actuated joints, for a rigid one what its link takes."""

    v: Value
    acc: Value
    dtheta: Value
    ddtheta: Value
    dz: Value
    tau_t: Value


class FlexibleJointModel:
    """The nominal robot with effects.

    Args:
        robot: what `flexjoint.robot.robot.load` gives; joints that an effect makes bend are flexible ones.
        effects: the effects at work; default those that the robot lists.
        body: PinBody for numbers, SymbolicBody for CasADi expressions (effects may then hold symbols).
        at: time [s] at which effects have to be at work; None: all are, whenever they set in or cease.
        springs: commanded stiffness and damping by joint, in place of the joints' own.

    Raises:
        ModelError: the same effect twice on a joint, a spring effect or command on a rigid joint, or a
            compliance on one that has a spring.
        UnknownNameError: an effect or spring on a joint that the robot does not actuate.
    """

    def __init__(
        self,
        robot: Robot,
        effects: Iterable[Planned] | None = None,
        body: Callable[..., Any] = PinBody,
        at: float | None = None,
        springs: Mapping[str, VariableSpring] | None = None,
    ) -> None:
        listed = signal_order(robot.effects if effects is None else effects)
        self.robot, self.effects = sprung(robot, listed)
        self.joints = self.robot.joints
        self.springs: dict[str, VariableSpring] = dict(springs or {})
        self._body_kind = body
        self._check()
        awake = [planned for planned in self.effects if at is None or planned.acts(at)]
        self._slots = {planned.key: k for k, planned in enumerate(x for x in self.effects if x.effect.states)}
        following = [
            x
            for x in self.effects
            if x.effect.overrides("steady_state") and at is not None and not x.acts(at)
        ]
        self.flows = tuple(
            JointFlow(
                joint,
                [self._part(x) for x in awake if x.joint == joint.name and not x.effect.reaches_before],
                self.springs.get(joint.name),
                [self._part(planned) for planned in following if planned.joint == joint.name],
            )
            for joint in self.joints
        )
        self.groups = self._groups([x for x in awake if x.effect.reaches_before])
        self.grouped = frozenset(j for group in self.groups for j in group.joints)
        self.body = self._edited_body(awake)
        self.nq, self.nv = self.body.nq, self.body.nv
        self.ground = self._ground()
        self.nz = len(self._slots) if self.ground is None else self.ground.slots.stop
        self.flexible = tuple(i for i, joint in enumerate(self.joints) if not joint.rigid)
        self.rigid = tuple(i for i, joint in enumerate(self.joints) if joint.rigid)
        self.nf = len(self.flexible)

    def _check(self) -> None:
        names = self.robot.joint_names
        seen: set[tuple[str, str | None]] = set()
        for planned in self.effects:
            if planned.joint is not None and planned.joint not in names:
                raise unknown("joint", planned.joint, names)
            if planned.key in seen:
                raise ModelError(f"{planned} is given twice; keep one entry")
            seen.add(planned.key)
            if len(planned.effect.states) > MAX_STATES:
                raise ModelError(f"{planned.effect.name} has {len(planned.effect.states)} states; 1 at most")
            if planned.effect.reaches_before and planned.joint == names[0]:
                raise ModelError(
                    f"{planned}: there is no joint before it; name the later one of the two joints"
                )
            if (
                planned.effect.overrides("delay")
                and planned.effect.site is Site.COMMAND
                and any(names.index(str(planned.joint)) in c.joints for c in self.robot.couplings)
            ):
                raise ModelError(
                    f"{planned}: the joint's motor is coupled, and late commands of such are not modelled"
                )
            if planned.effect.needs_spring and planned.joint and self.robot.joint(planned.joint).rigid:
                raise ModelError(f"{planned}: the joint is rigid; give it a finite stiffness first")
        for name in self.springs:
            if self.robot.joint(name).rigid:
                raise ModelError(f"springs: joint {name} is rigid; give it a finite stiffness first")

    def _part(self, planned: Planned) -> Part:
        slot = self._slots.get(planned.key, -1)
        return Part(planned.effect, planned.p, slot, self.effects.index(planned))

    def _groups(self, reaching: Sequence[Planned]) -> tuple[Group, ...]:
        """The joints that shafts tie together: by the robot file's couplings, and by effects."""
        names = self.robot.joint_names
        own: dict[int, Shaft] = {}
        for coupling in self.robot.couplings:
            for r, i in enumerate(coupling.joints):
                turns = {j: x for j, x in zip(coupling.joints, coupling.matrix[r], strict=True) if x != 0.0}
                takes = dict(zip(coupling.joints, coupling.inverse[:, r].tolist(), strict=True))
                own[i] = Shaft(i, turns, takes, self.flows[i])
        more = []
        for planned in reaching:
            i = names.index(str(planned.joint))
            for one in planned.parts:
                share, before = one.effect.shares(one.p)
                part = Part(one.effect, one.p, -1, self.effects.index(planned))
                more.append(Shaft(i, {i: share, i - 1: before}, {}, JointFlow(self.joints[i], [part])))
        groups = []
        for some in joined([*(c.joints for c in self.robot.couplings), *(shaft.turns for shaft in more)]):
            joints = tuple(sorted(some))
            rigid = {self.joints[i].rigid for i in joints}
            if len(rigid) > 1:
                listed = " and ".join(self.joints[i].name for i in joints)
                raise ModelError(
                    f"{listed} share a motor, and not all are rigid: give each a stiffness, or .inf to each"
                )
            shafts = [own.get(i) or Shaft(i, {i: 1.0}, {i: 1.0}, self.flows[i]) for i in joints]
            shafts += [shaft for shaft in more if shaft.joint in some]
            groups.append(Group(joints, tuple(shafts), rigid.pop()))
        return tuple(groups)

    def _edited_body(self, awake: Sequence[Planned]) -> Any:
        nominal = self._body_kind(self.robot.model)
        rows: dict[int, Any] = {}
        gravity = None
        for planned in awake:
            if planned.effect.overrides("edit_inertial") and planned.joint is not None:
                row = self.robot.joint(planned.joint).pin_id - 1
                now = rows.get(row, [nominal.inertial[row, k] for k in range(10)])
                rows[row] = planned.effect.edit_inertial(now, planned.p)
            if planned.effect.overrides("edit_gravity"):
                now = [nominal.gravity[k] for k in range(3)] if gravity is None else gravity
                gravity = planned.effect.edit_gravity(now, planned.p)
        if not rows and gravity is None:
            return nominal
        inertial = nominal.inertial.copy() if isinstance(nominal.inertial, np.ndarray) else nominal.inertial
        inertial = inertial if isinstance(inertial, np.ndarray) else ca.SX(inertial)
        for row, values in rows.items():
            for k in range(10):
                inertial[row, k] = values[k]
        return self._body_kind(self.robot.model, inertial, None if gravity is None else self.vector(gravity))

    def _ground(self) -> Ground | None:
        kinds = {"compliant": Ground, "rigid": RigidGround}
        if self.robot.ground not in kinds:
            raise unknown("ground", self.robot.ground, kinds)
        if not self.robot.contacts:
            return None
        if self.robot.ground == "rigid" and self.symbolic:
            raise ModelError(
                "rigid ground is solved in numbers, step by step: there is neither a symbolic nor a compiled"
                " model of it; take engine='pin', or ground: compliant"
            )
        return kinds[self.robot.ground](self.robot.contacts, self.robot.model, len(self._slots))

    # --- effects in time -------------------------------------------------------------------------
    @cached_property
    def onsets(self) -> tuple[float, ...]:
        """Times at which effects set in or cease [s], increasing."""
        return tuple(sorted({t for planned in self.effects for t in planned.changes}))

    @cached_property
    def phases(self) -> tuple[tuple[float, FlexibleJointModel], ...]:
        """The model before the first onset (from -inf) and from each onset on."""
        if not self.onsets:
            return ((-math.inf, self),)
        kind, springs = self._body_kind, self.springs
        return self.by_phase(lambda t: FlexibleJointModel(self.robot, self.effects, kind, t, springs))

    def by_phase(self, make: Callable[[float], Made]) -> tuple[tuple[float, Made], ...]:
        """The begin of each phase [s] and what `make` makes of it: once for phases in which the same effects
        act."""
        made: dict[tuple[bool, ...], Made] = {}
        out = []
        for t in (-math.inf, *self.onsets):
            acting = tuple(bool(planned.acts(t)) for planned in self.effects)
            if acting not in made:
                made[acting] = make(t)
            out.append((t, made[acting]))
        return tuple(out)

    @cached_property
    def rubs(self) -> bool:
        """Whether there is dry friction anywhere."""
        shafts = (shaft.flow for group in self.groups for shaft in group.shafts)
        return any(flow.motor_rubs or flow.link_rubs for flow in (*self.flows, *shafts))

    # --- numbers or expressions ------------------------------------------------------------------
    @property
    def symbolic(self) -> bool:
        """Whether its values are CasADi expressions."""
        return self._body_kind is not PinBody

    def vector(self, values: Iterable[Value]) -> Value:
        """A vector of scalars, NumPy or CasADi as the model is."""
        return ops.vector(values, self.symbolic)

    def zeros(self, size: int) -> Value:
        """(size,) zeros, NumPy or CasADi as the model is."""
        return ops.zeros(size, self.symbolic)

    # --- states ----------------------------------------------------------------------------------
    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of x: q (nq), v (nv), theta and dtheta (nf), z (nz), in this order.

        A position or velocity that is no actuated joint's is named by its place, e.g. q[0].
        """
        q = [f"q[{k}]" for k in range(self.nq)]
        v = [f"v[{k}]" for k in range(self.nv)]
        for joint in self.joints:
            q[joint.idx_q], v[joint.idx_v] = f"q.{joint.name}", f"dq.{joint.name}"
        moving = [self.joints[i].name for i in self.flexible]
        z = [f"{effect}.{joint}" for effect, joint in self._slots]
        z += self.ground.names if self.ground is not None else ()
        return (*q, *v, *(f"theta.{n}" for n in moving), *(f"dtheta.{n}" for n in moving), *z)

    @property
    def nx(self) -> int:
        """Size of the state x, whose entries `state_names` has."""
        return self.nq + self.nv + 2 * self.nf + self.nz

    def slot(self, effect: str, joint: str) -> int:
        """Place in z of an effect's internal state; UnknownNameError when it has none."""
        if (effect, joint) not in self._slots:
            raise unknown("internal state", f"{effect}.{joint}", [f"{e}.{j}" for e, j in self._slots])
        return self._slots[effect, joint]

    def rest(self, q: Value = None, t: float = 0.0) -> State:
        """The state at rest at the configuration q (nq,) (default: neutral) with relaxed springs."""
        q = self.vector(self.body.neutral.tolist()) if q is None else q
        theta = self.vector(q[self.joints[i].idx_q] for i in self.flexible)
        z = self.vector(x.effect.states[0] for x in self.effects if x.effect.states)
        if self.ground is not None:
            below = self.ground.below(self.body, q)
            z = ca.vertcat(z, below) if self.symbolic else np.concatenate([z, below])
        return self._remembering_nothing(t, q, self.zeros(self.nv), theta, self.zeros(self.nf), z)

    def _remembering_nothing(
        self, t: Value, q: Value, v: Value, theta: Value, dtheta: Value, z: Value
    ) -> State:
        forgotten = self.zeros(self.nv), self.zeros(self.nf), self.zeros(len(self.rigid))
        return State(t, q, v, theta, dtheta, z, *forgotten)

    def pack(self, state: State) -> Value:
        """x (nx,) of a state, in the order of `state_names`."""
        parts = (state.q, state.v, state.theta, state.dtheta, state.z)
        return ca.vertcat(*parts) if self.symbolic else np.concatenate(parts)

    def unpack(self, x: Value, t: Value = 0.0) -> State:
        """The state of x (nx,), with nothing remembered of a last step."""
        parts, start = [], 0
        for size in (self.nq, self.nv, self.nf, self.nf, self.nz):
            parts.append(x[start : start + size])
            start += size
        return self._remembering_nothing(t, *parts)

    # --- continuous dynamics ---------------------------------------------------------------------
    def signals(
        self, state: State, i: int, tau_m: Value, beside: tuple[Value, Value] = (0.0, 0.0)
    ) -> Signals:
        """What the laws of the actuated joint i may see at a state; tau_t is 0 for a rigid joint. `beside`
        are the commands of the joints before and after it."""
        joint = self.joints[i]
        q, dq = state.q[joint.idx_q], state.v[joint.idx_v]
        theta, dtheta = q, dq
        if not joint.rigid:
            k = self.flexible.index(i)
            theta, dtheta = state.theta[k], state.dtheta[k]
        s = Signals(state.t, q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, tau_m, *beside)
        if not joint.rigid:
            s.tau_t = self.flows[i].transmission(s, state.z)
        return s

    def rates(self, state: State, tau_m: Value, width: Value | None) -> Rates:
        """Time derivative of a state under the motor torques tau_m (n,) [N m], delays aside.

        Dry friction is smoothed: level tanh(velocity / width), width [rad/s]. It creeps instead of
        sticking; the default scheme of `integrate` does not smooth. With a width of None there is none.
        """
        tau, armature = self.zeros(self.nv), self.zeros(self.nv)
        ddtheta, dz, tau_t = self.zeros(self.nf), self.zeros(self.nz), self.zeros(len(self.joints))
        of: dict[int, Signals] = {}
        for i, flow in enumerate(self.flows):
            s = self.signals(state, i, tau_m[i], neighbours(tau_m, i))
            joint, link = flow.joint, flow.torques(s, state.z)[1]
            if width is not None:
                link = link - flow.link_level(s, state.z) * ops.tanh(s.dq / width)
            if i in self.grouped:
                of[i] = s
                tau[joint.idx_v] = link if joint.rigid else s.tau_t + link
                tau_t[i] = s.tau_t
                continue
            motor = _driven(flow, s, state.z, width)
            if joint.rigid:
                tau[joint.idx_v] = motor + link
                armature[joint.idx_v] = flow.drive.B
                tau_t[i] = motor
            else:
                tau[joint.idx_v] = s.tau_t + link
                ddtheta[self.flexible.index(i)] = (motor - s.tau_t) / flow.drive.B
                tau_t[i] = s.tau_t
            for slot, rate in flow.rates(s, state.z):
                dz[slot] = rate
        for group in self.groups:
            self._turn(group, of, state.z, width, (tau, armature, ddtheta, dz, tau_t))
        if self.ground is not None:
            touch = self.ground.touch(self.body, state.q, state.v, state.z)
            tau = tau + touch.tau
            dz[self.ground.slots] = self.vector(touch.rates)
        blocks = [(self.places(group), group.inertia) for group in self.groups if group.rigid]
        acc = self.accelerating(state.q, state.v, armature, blocks)(tau)
        for i, taken in self._taken(acc):
            tau_t[i] = tau_t[i] - taken
        return Rates(state.v, acc, state.dtheta, ddtheta, dz, tau_t)

    def _turn(
        self,
        group: Group,
        of: Mapping[int, Signals],
        z: Value,
        width: Value | None,
        out: tuple[Value, Value, Value, Value, Value],
    ) -> None:
        """Write what a group's shafts give: torques and armatures of links, accelerations of motors, rates of
        internal states, torques through rigid transmissions."""
        tau, armature, ddtheta, dz, tau_t = out
        given = group.at_joints([self._given(shaft, of, z, width, dz) for shaft in group.shafts])
        inertia = group.inertia
        if group.rigid:
            for r, (i, place) in enumerate(zip(group.joints, self.places(group), strict=True)):
                tau[place], tau_t[i], armature[place] = tau[place] + given[i], given[i], inertia[r][r]
            return
        pull = self.vector(given[i] - of[i].tau_t for i in group.joints)
        turning = ops.solve(ops.matrix(inertia, self.symbolic), pull)
        for r, i in enumerate(group.joints):
            ddtheta[self.flexible.index(i)] = turning[r]

    def _given(
        self, shaft: Shaft, of: Mapping[int, Signals], z: Value, width: Value | None, dz: Value
    ) -> Value:
        """What a shaft gives at its own position; the rates of internal states go into dz."""
        s = shaft.signals(of)
        for slot, rate in shaft.flow.rates(of[shaft.joint], z, s):
            dz[slot] = rate
        return _driven(shaft.flow, s, z, width, shaft.D_m, bool(shaft.takes))

    def _taken(self, acc: Value) -> list[tuple[int, Value]]:
        """Each rigid joint, with what its motor, or the shafts that it turns, take of their torques."""
        out = [
            (i, self.flows[i].drive.B * acc[self.joints[i].idx_v])
            for i in self.rigid
            if i not in self.grouped
        ]
        for group in self.groups:
            places = self.places(group)
            for i, row in zip(group.joints, group.inertia, strict=True) if group.rigid else ():
                out.append((i, sum((b * acc[place] for b, place in zip(row, places, strict=True)), 0.0)))
        return out

    def motor_torques(self, of: Sequence[Signals], ddtheta: Sequence[Value], z: Value) -> list[Value]:
        """Torques at the joints that the motors need for their own motion, with accelerations `ddtheta` of
        all: for inertia and damping, less what effects on them give; dry friction aside."""
        out = []
        for flow, s, acceleration in zip(self.flows, of, ddtheta, strict=True):
            drive = flow.drive
            out.append(drive.B * acceleration + drive.D_m * s.dtheta - flow.torques(s, z)[0])
        for group in self.groups:
            needed = []
            for shaft in group.shafts:
                s = shaft.signals({i: of[i] for i in group.joints})
                turning = shaft.turned({i: ddtheta[i] for i in group.joints})
                needed.append(shaft.B * turning + shaft.D_m * s.dtheta - shaft.flow.torques(s, z)[0])
            for i, torque in group.at_joints(needed).items():
                out[i] = torque
        return out

    def places(self, group: Group) -> list[int]:
        """Places in v of a group's joints."""
        return [self.joints[i].idx_v for i in group.joints]

    def accelerating(
        self,
        q: Value,
        v: Value,
        armature: Value,
        blocks: Sequence[tuple[Sequence[int], Sequence[Sequence[Value]]]],
    ) -> Callable[[Value], Value]:
        """The accelerations (nv,) by joint forces, with an armature (nv,), and `blocks` of inertia between
        joints (see `Tie`)."""

        def alone(tau: Value) -> Value:
            return self.body.aba(q, v, tau, armature)

        return Tie(alone, blocks, self.nv, self.symbolic) if blocks else alone

    def rhs(self, x: Value, tau_m: Value, width: Value, t: Value = 0.0) -> Value:
        """dx/dt (nx,) of x (nx,): `rates` as one vector. Only where nq = nv (every joint has one axis)."""
        if self.nq != self.nv:
            raise ModelError("rhs needs nq = nv; use rates and body.integrate for a floating base")
        r = self.rates(self.unpack(x, t), tau_m, width)
        parts = (r.v, r.acc, r.dtheta, r.ddtheta, r.dz)
        return ca.vertcat(*parts) if self.symbolic else np.concatenate(parts)


def _driven(
    flow: JointFlow,
    s: Signals,
    z: Value,
    width: Value | None,
    damping: Value | None = None,
    commanded: bool = True,
) -> Value:
    """What a motor gives, its inertia aside; `damping` in place of its drive's."""
    torque = flow.command(s, s.tau_m, z) if commanded else 0.0
    torque = torque + flow.torques(s, z)[0] - (flow.drive.D_m if damping is None else damping) * s.dtheta
    if width is not None:
        torque = torque - flow.motor_level(s, z) * ops.tanh(s.dtheta / width)
    return torque
