"""Groups of joints that shafts tie together, in a step of the default scheme.

With a = h/2, motor velocities w (g,) of a group at the midpoint, shafts n_k, and the springs as in
midpoint.py,

    [sum_k n_k (B_k + a D_k) n_k' + a k_d] w = B dtheta + a (sum_k n_k T_k - r) + a k_d v_mid,

a small system instead of a division: w = c0 + C1 v_mid, and the links carry r + k_d c0 - kappa v with the
inertias a kappa, kappa = k_d - k_d C1, between them (`flexjoint.model.shafts.Tie`). Dry friction of shafts is
found at the predicted midpoint (Gauss-Seidel), and what sticks there stays on n_k w = 0 whatever the links
do. Of rigid joints the shafts' inertias and dampings act on the links, and their dry friction is solved
together with the links'."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.shafts import Group, Shaft
from flexjoint.simulation.schemes.friction import SWEEPS, directed, friction_forces, rubbed
from flexjoint.simulation.schemes.midway import Midway

REDUNDANT = 1e-9  # share by which sticking shafts may slip: more of them may stick than there are joints


@dataclass
class GroupStep:
    """What a group contributes to a step; lists follow the group's joints, or its shafts."""

    model: FlexibleJointModel
    group: Group
    signals: dict[int, Signals]  # of the joints at the predicted midpoint
    tau: list[Value]  # torque and armature on the links
    armature: list[Value]
    block: list[list[Value]]  # inertias between the links
    shaft_signals: list[Signals]
    friction: dict[int, Value] = field(default_factory=dict)  # of shafts on links, by place in the group

    def turn(self, w_mid: Value, v_mid: Value) -> None:
        """Write the motors' midpoint velocities, from those of the links."""

    def finish(
        self, before: Value, w_mid: Value, acc: Value, a: float, out: tuple[Value, Value, Value]
    ) -> None:
        """Write what is the group's of the motors' velocities and accelerations at the end, and of the
        torques through rigid transmissions; from the motors' velocities at the start and the midpoint, and
        the links' accelerations (nv,)."""


@dataclass
class RigidGroup(GroupStep):
    given: list[Value] = field(default_factory=list)  # torques of the shafts, dry friction aside
    inertia: list[list[Value]] = field(default_factory=list)

    def finish(
        self, before: Value, w_mid: Value, acc: Value, a: float, out: tuple[Value, Value, Value]
    ) -> None:
        left = [T - self.friction.get(k, 0.0) for k, T in enumerate(self.given)]
        at_joints, places = self.group.at_joints(left), self.model.places(self.group)
        for i, row in zip(self.group.joints, self.inertia, strict=True):
            taken = sum((b * acc[place] for b, place in zip(row, places, strict=True)), 0.0)
            out[2][self.model.rigid.index(i)] = at_joints[i] - taken


@dataclass
class FlexibleGroup(GroupStep):
    c0: Value = 0.0  # the motors' midpoint velocities are c0 + c1 v_mid: (g,) and (g, g)
    c1: Value = 0.0
    rubbing: list[Turning] = field(default_factory=list)

    @property
    def motors(self) -> list[int]:
        """Their places among the flexible joints."""
        return [self.model.flexible.index(i) for i in self.group.joints]

    def turn(self, w_mid: Value, v_mid: Value) -> None:
        velocity = self.model.vector(v_mid[place] for place in self.model.places(self.group))
        turning = self.c0 + self.c1 @ velocity
        for r, k in enumerate(self.motors):
            w_mid[k] = turning[r]

    def finish(
        self, before: Value, w_mid: Value, acc: Value, a: float, out: tuple[Value, Value, Value]
    ) -> None:
        motors = self.motors
        for item in self.rubbing:
            first, middle = (
                sum((n * x[motors[r]] for r, n in item.turns.items()), 0.0) for x in (before, w_mid)
            )
            end, rate = rubbed(first, middle, item.free, item.shed, 2.0 * a)
            slack, jerk = end - (2.0 * middle - first), rate - (middle - first) / a
            for r, k in enumerate(motors):
                out[0][k] = out[0][k] + item.response[r] * slack
                out[1][k] = out[1][k] + item.response[r] * jerk


@dataclass(slots=True)
class Turning:
    """Dry friction of a shaft of flexible joints: accelerations without it and by its level, and how the
    motors' velocities change where it changes the shaft's by one."""

    turns: dict[int, Value]  # by place in the group
    free: Value
    shed: Value
    response: list[Value]


def tied_step(model: FlexibleJointModel, group: Group, at: Midway, a: float) -> GroupStep:
    """A group's contribution to a step of 2 a seconds."""
    of = {i: at.signals(i, -1 if group.rigid else model.flexible.index(i), a) for i in group.joints}
    return _rigid(model, group, of, at, a) if group.rigid else _flexible(model, group, of, at, a)


def _driven(shaft: Shaft, s: Signals, z: Value, a: float) -> tuple[Value, Value]:
    """What a shaft gives beside its damping and dry friction, and how much of that resists its velocity."""
    on_motor, resists = shaft.flow.motor(s, z, a)
    return (on_motor + shaft.flow.command(s, s.tau_m, z, 2.0 * a) if shaft.takes else on_motor), resists


def _rigid(
    model: FlexibleJointModel, group: Group, of: dict[int, Signals], at: Midway, a: float
) -> RigidGroup:
    shafts = [shaft.signals(of) for shaft in group.shafts]
    speeds = {i: at.v[model.joints[i].idx_v] for i in group.joints}
    given, numbers = [], []
    for shaft, s in zip(group.shafts, shafts, strict=True):
        driven, resists = _driven(shaft, s, at.z, a)
        speed = shaft.turned(speeds)
        given.append(driven + resists * (s.dq - speed) - shaft.D_m * speed)
        numbers.append(shaft.B + a * (shaft.D_m + resists))
    inertia, at_joints = group.matrix(numbers), group.at_joints(given)
    tau, armature = [], []
    for r, i in enumerate(group.joints):
        on_link, resists = model.flows[i].link(of[i], at.z, a)
        tau.append(at_joints[i] + on_link + resists * (of[i].dq - speeds[i]))
        armature.append(inertia[r][r] + a * resists)
    return RigidGroup(model, group, of, tau, armature, inertia, shafts, given=given, inertia=inertia)


def _flexible(
    model: FlexibleJointModel, group: Group, of: dict[int, Signals], at: Midway, a: float
) -> FlexibleGroup:
    count, symbolic = range(len(group.joints)), model.symbolic
    flows = [model.flows[i] for i in group.joints]
    before = [at.dtheta[model.flexible.index(i)] for i in group.joints]
    speeds = [at.v[flow.joint.idx_v] for flow in flows]
    spring, kd = [], []
    for i, flow in zip(group.joints, flows, strict=True):
        s = of[i]
        phi = at.theta[model.flexible.index(i)] - at.q[flow.joint.idx_q]
        tau_t, stiffness, damping = flow.linear_spring(s, at.z, a)
        spring.append(tau_t + stiffness * (phi - s.phi) - damping * s.dphi)
        kd.append(a * stiffness + damping)
        s.tau_t = spring[-1] + kd[-1] * s.dphi
    shafts = [shaft.signals(of) for shaft in group.shafts]
    pushes, numbers = [], []
    for shaft, s in zip(group.shafts, shafts, strict=True):
        driven, resists = _driven(shaft, s, at.z, a)
        pushes.append(driven + resists * s.dtheta)
        numbers.append(shaft.B + a * (shaft.D_m + resists))
    system, inertia, given = group.matrix(numbers), group.inertia, group.at_joints(pushes)
    rows = [[system[r][c] + (a * kd[r] if r == c else 0.0) for c in count] for r in count]
    eye = ops.matrix([[float(r == c) for c in count] for r in count], symbolic)
    inverse = ops.solve(ops.matrix(rows, symbolic), eye)
    push = model.vector(
        sum((inertia[r][c] * before[c] for c in count), 0.0) + a * (given[i] - spring[r])
        for r, i in enumerate(group.joints)
    )
    along = ops.matrix([[a * kd[r] if r == c else 0.0 for c in count] for r in count], symbolic)
    rubbing = [k for k, shaft in enumerate(group.shafts) if shaft.flow.motor_rubs]
    found: list[Turning] = []
    if rubbing:
        ahead = push + along @ model.vector(of[i].dq for i in group.joints)
        push, kept, found = _rub(model, group, rubbing, shafts, (inverse, ahead, push), before, at.z, a)
        inverse = kept @ inverse
    c0, c1 = inverse @ push, inverse @ along
    tau, armature, block = [], [], []
    for r, flow in enumerate(flows):
        kappa = [(kd[r] if r == c else 0.0) - kd[r] * c1[r, c] for c in count]
        on_link, resists = flow.link(of[group.joints[r]], at.z, a)
        carried = spring[r] + kd[r] * c0[r] - sum((kappa[c] * speeds[c] for c in count), 0.0)
        tau.append(carried + on_link + resists * (of[group.joints[r]].dq - speeds[r]))
        armature.append(a * (kappa[r] + resists))
        block.append([a * k for k in kappa])
    return FlexibleGroup(model, group, of, tau, armature, block, shafts, c0=c0, c1=c1, rubbing=found)


def _rub(
    model: FlexibleJointModel,
    group: Group,
    rubbing: Sequence[int],
    shafts: Sequence[Signals],
    system: tuple[Value, Value, Value],
    before: Sequence[Value],
    z: Value,
    a: float,
) -> tuple[Value, Value, list[Turning]]:
    """The push less the friction of shafts that slip, the projection that keeps those that stick at rest, and
    what the end of the step needs."""
    inverse, ahead, push = system
    count, symbolic = range(len(rubbing)), model.symbolic
    turns = [[group.shafts[k].share(i) for i in group.joints] for k in rubbing]
    N = ops.matrix(turns, symbolic)
    response = inverse @ N.T
    C = N @ response
    free = N @ (inverse @ ahead)
    levels = []
    for row, k in enumerate(rubbing):
        s = shafts[k]
        velocity = s.dtheta
        s.dtheta = directed(velocity, free[row])
        levels.append(a * group.shafts[k].flow.motor_level(s, z))
        s.dtheta = velocity
    coupling = [[C[i, j] for j in count] for i in count]
    sweeps = 1 if len(rubbing) == 1 else SWEEPS
    force = friction_forces([free[k] for k in count], levels, coupling, sweeps, symbolic)
    sticks = [ops.where(ops.absolute(force[k]) < levels[k], 1.0, 0.0) for k in count]
    held = ops.matrix(
        [
            [
                sticks[i] * coupling[i][j] * sticks[j]
                + ((1.0 - sticks[i]) + REDUNDANT * coupling[i][i] if i == j else 0.0)
                for j in count
            ]
            for i in count
        ],
        symbolic,
    )
    stuck = ops.matrix([[sticks[k] * n for n in turns[k]] for k in count], symbolic)
    eye = ops.matrix([[float(r == c) for c in range(len(before))] for r in range(len(before))], symbolic)
    kept = eye - inverse @ stuck.T @ ops.solve(held, stuck)
    push = push - N.T @ model.vector((1.0 - sticks[k]) * force[k] for k in count)
    found = []
    for k in count:
        first = sum((n * x for n, x in zip(turns[k], before, strict=True)), 0.0)
        slipping = free[k] - sum((coupling[k][j] * force[j] for j in count if j != k), 0.0)
        own = coupling[k][k]
        by_joint = [response[r, k] / own for r in range(len(before))]
        found.append(
            Turning(dict(enumerate(turns[k])), (slipping - first) / a, own * levels[k] / a, by_joint)
        )
    return push, kept, found
