"""The equations of motion of a machine that has some of the effects of catalogue.py.

phi = theta - q, w = dtheta. Everything acts in this order where several effects share a site:

- command: tau_m is scaled by (1 + gain), shifted by the offset, clipped; then comes the share of a
  neighbour's command; their sum is delayed and lags. All this acts on held numbers and lives in simulate.py.
  The outcome is clipped to +-stall - drop w, and cogging is added last (it is a force of the motor, not of
  its drive).
- motor: B theta'' = tau - tau_t - (D_m + coefficient) w - s level, where s in {-1, 0, 1} is the state of
  the dry friction (0: stuck, w = 0) and `level` the sum of all dry laws. Dry friction sticks exactly: a
  stuck motor leaves when the net torque exceeds the level at rest, a slipping one is caught at the instant
  w = 0 (Karnopp's model with located events), so no creep and no smoothing width. A stuck link has its
  acceleration removed from M q'' = tau_link by striking its row and column. Dahl's friction is a torque -z
  and never sticks; a breakaway level falls with the path since its start, z = 1 there.
- coupled_friction, differential_friction (a shaft of each sign): a shaft turns with w_s = w + s w_before,
  s = 1 (sum) or -1 (difference), and rubs with f = level tanh(w_s/creep) + coefficient w_s: motor -f, the
  motor before -s f. It alone creeps instead of sticking, at 5 mrad/s or more: two motors that are held by one
  shaft are no switch of a joint.
- transmission: e = phi + transmission error, less half the gap on the engaged side (dead zone, located
  events as well); tau_t = K e + cubic e^3 + D phi' (0 inside the gap) + z + preload, with the z of Dahl's
  hysteresis as a state, or a creeping spring's stiffness z in its place.
- link: payload joins the body's mass, tilt turns gravity, the others are torques on q.
- sensor: sensing.py.

A rigid joint (infinite stiffness) has theta = q: B joins the link's inertia, motor and link rub as one, and
tau_t is what its link takes, which laws that depend on the load are given by repeated substitution.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..catalogue import BEYOND, CATALOGUE, DRY_MOTOR, DRY_OUTSIDE, SHARED, Law, Planted, check, law, neighbour
from ..robots import Robot
from . import outside
from .chain import Array, body_load, inverse_dynamics, mass_matrix, point_load

__all__ = [
    "BEYOND",
    "CATALOGUE",
    "DRY_MOTOR",
    "Equations",
    "Law",
    "Planted",
    "Switch",
    "check",
    "law",
    "neighbour",
]


BY_LOAD = ("load_friction", "drive_efficiency", "gear_ripple", "loaded_drag")
CREEP = 5e-3  # rad/s of a shared friction, at least
SUBSTITUTIONS = 4  # of a rigid joint's tau_t into BY_LOAD; each leaves some 10 % of the error before


@dataclass(frozen=True)
class Switch:
    """A place where the equations change: dry friction (mode -1, 0 stuck, 1) or a gap (-1, 0 inside, 1)."""

    kind: str  # "motor", "link" or "gap"
    joint: int


class Equations:
    """The right-hand side, as symbols, for one real robot with its planted effects.

    State x (5 n + m,): q, dq, theta, dtheta, z (of the one law of WITH_STATE on the joint), and angle and
    speed of every wobbling mass. `modes` (number of
    switches,) and `gates` (number of effects, 1 when active) are constant over a step. Attributes after
    construction: `rate` x', `torque` tau_t (n,), `margin` (switches,) that is negative when a mode no longer
    holds, `drive` (switches,) whose sign is the next mode, `start` (n + m,) of z and the masses, `rigid` (n,)
    flags, and `balance` (2 n,) [N m], what motors and links lack for given `accelerations` (2 n,) of links
    and motors; a rigid joint's is all in the motor's.
    """

    def __init__(self, robot: Robot, effects: list[Planted]) -> None:
        check(robot, effects)
        n = len(robot.joints)
        self.robot, self.effects = robot, effects
        self.rigid = np.isinf(robot.stiffness)
        self.switches = tuple(
            Switch(kind, j)
            for j in range(n)
            for kind, names in self._rubbing(j)
            if any(p.effect in names and p.joint == robot.joints[j] for p in effects)
        )
        self.masses = [k for k, p in enumerate(effects) if p.effect == outside.WOBBLING]
        more = outside.WOBBLING_STATES * len(self.masses)
        self.x = ca.SX.sym("x", 5 * n + more)
        self.accelerations = ca.SX.sym("a", 2 * n)
        self.u, self.t = ca.SX.sym("u", n), ca.SX.sym("t")
        self.modes = ca.SX.sym("modes", len(self.switches))
        self.gates = ca.SX.sym("gates", len(effects))
        self.q, self.dq, self.theta, self.dtheta, self.z = ca.vertsplit(self.x[: 5 * n], n)
        fresh = {p.joint for p in effects if p.effect == "breakaway_friction"}
        self.start = np.array([float(joint in fresh) for joint in robot.joints] + [0.0] * more)
        self._write()

    def _rubbing(self, j: int) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Kinds of switches of a joint and the effects that make them."""
        motor, link = (*DRY_MOTOR, *DRY_OUTSIDE), ("link_coulomb_friction",)
        if self.rigid[j]:
            return (("motor", (*motor, *link)),)
        return (("motor", motor), ("link", link), ("gap", ("backlash",)))

    def _seen(self, j: int, tau_t: ca.SX, planted: Planted | None = None) -> outside.At:
        """What a law outside the catalogue sees of joint j."""
        own = (self.q[j], self.dq[j], self.theta[j], self.dtheta[j])
        side: tuple[ca.SX, ...] = ()
        if planted is not None and "side" in planted.parameters:
            k = neighbour(self.robot, planted)
            side = (self.q[k], self.dq[k])
        return outside.At(*own, self.u[j], self.t, tau_t, float(self.robot.stiffness[j]), *side)

    def _outside(self, laws: dict[str, outside.Torque], j: int, tau_t: ca.SX) -> ca.SX:
        """The gated sum of some laws outside the catalogue at joint j."""
        total, here = ca.SX(0), self.robot.joints[j]
        for k, p in enumerate(self.effects):
            if p.effect not in laws:
                continue
            on_side = p.effect in outside.ON_BOTH and neighbour(self.robot, p) == j
            if p.joint == here or on_side:
                seen = self._seen(self.robot.index(p.joint), tau_t, p)
                total += self.gates[k] * laws[p.effect](p, seen)
        return total

    def _on(self, effect: str, joint: int) -> tuple[Planted, ca.SX] | None:
        """The planted effect on a joint (by index) and its gate; None when it is absent."""
        for k, planted in enumerate(self.effects):
            if planted.effect == effect and planted.joint == self.robot.joints[joint]:
                return planted, self.gates[k]
        return None

    def _size(self, effect: str, joint: int, parameter: str) -> ca.SX:
        """The gated value of a parameter in which the law is linear; 0 when the effect is absent."""
        found = self._on(effect, joint)
        return ca.SX(0) if found is None else found[1] * found[0].value(parameter)

    def _mode(self, kind: str, joint: int) -> ca.SX | None:
        switch = Switch(kind, joint)
        return self.modes[self.switches.index(switch)] if switch in self.switches else None

    def _spring(self, j: int) -> tuple[ca.SX, ca.SX]:
        """tau_t and the deflection that the gap sees, of joint j."""
        robot = self.robot
        phi, dphi = self.theta[j] - self.q[j], self.dtheta[j] - self.dq[j]
        deflection = phi
        if found := self._on("transmission_error", j):
            p, gate = found
            deflection += (
                gate * p.value("amplitude") * ca.sin(p.value("cycles") * self.theta[j] + p.value("phase"))
            )
        deflection += self._outside(outside.DEFLECTION, j, ca.SX(0))
        side, engaged, half_gap = ca.SX(0), ca.SX(1), ca.SX(0)
        if (mode := self._mode("gap", j)) is not None:
            side, engaged, half_gap = mode, mode * mode, self._size("backlash", j, "gap") / 2
        e = engaged * (deflection - side * half_gap)
        stiffness = robot.stiffness[j] * (1 + self._size("spring_stiffness", j, "scale"))
        damping = robot.damping[j] * (1 + self._size("spring_damping", j, "scale"))
        torque = stiffness * e + self._size("hardening_spring", j, "cubic") * e**3 + engaged * damping * dphi
        if found := self._on("spring_hysteresis", j):
            torque += found[1] * self.z[j]
        torque += self._outside(outside.SPRING, j, ca.SX(0))
        torque += self._size("spring_creep", j, "stiffness") * self.z[j]
        return torque + self._size("spring_preload", j, "torque"), deflection

    def _state_rate(self, j: int) -> ca.SX:
        """dz/dt of joint j."""
        z, w = self.z[j], self.dtheta[j]
        dphi = w - self.dq[j]
        if found := self._on("spring_hysteresis", j):
            p, gate = found
            return gate * (p.value("level") / p.value("scale") * dphi - ca.fabs(dphi) * z / p.value("scale"))
        if found := self._on("spring_creep", j):
            p, gate = found
            return gate * (dphi - z / p.value("time_constant"))
        if found := self._on("dahl_friction", j):
            p, gate = found
            return gate * (w * p.value("level") - ca.fabs(w) * z) / p.value("scale")
        if found := self._on("breakaway_friction", j):
            p, gate = found
            return -gate * ca.fabs(w) / p.value("distance") * z
        return ca.SX(0)

    def _dry_levels(self, j: int, torque: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Dry friction of motor j for forward and for backward motion [N m]."""
        w = self.dtheta[j]
        common = self._size("motor_coulomb_friction", j, "level")
        common += self._size("load_friction", j, "coefficient") * ca.fabs(torque)
        if found := self._on("stribeck_friction", j):
            p, gate = found
            bump = ca.exp(-((w / p.value("velocity")) ** 2))
            common += gate * (p.value("level") + p.value("static_extra") * bump)
        if found := self._on("friction_drift", j):
            p, gate = found
            common += gate * p.value("level") * ca.exp(-ca.fmax(self.t, 0) / p.value("time_constant"))
        common += self._size("breakaway_friction", j, "level") * self.z[j]
        if found := self._on("rough_spot", j):
            p, gate = found
            away = (self.theta[j] - p.value("position")) / p.value("width")
            common += gate * p.value("level") * ca.exp(-(away**2))
        common += self._outside(outside.DRY, j, torque)
        if self.rigid[j]:
            common += self._size("link_coulomb_friction", j, "level")
        forward = common + self._size("asymmetric_friction", j, "level_positive")
        backward = common + self._size("asymmetric_friction", j, "level_negative")
        driving = self._size("drive_efficiency", j, "loss_driving")
        backdriving = self._size("drive_efficiency", j, "loss_backdriving")
        up, down = ca.fmax(torque, 0), ca.fmax(-torque, 0)  # loads that forward, backward motion drives
        return forward + driving * up + backdriving * down, backward + driving * down + backdriving * up

    def _loads_and_gravity(self) -> tuple[list, ca.SX]:
        loads = [body_load(body) for body in self.robot.bodies]
        gravity = ca.SX(self.robot.gravity)
        for k, planted in enumerate(self.effects):
            if planted.effect == "payload":
                j = self.robot.index(planted.joint)
                position = np.array(planted.parameters["position"], dtype=float)
                loads[j] = loads[j] + point_load(self.gates[k] * planted.value("mass"), position)
            elif planted.effect == "base_tilt":
                tilted = ca.SX(_tilted(planted.value("roll"), planted.value("pitch"), self.robot.gravity))
                gravity = gravity + self.gates[k] * (tilted - gravity)
        return loads, gravity

    def _link_torque(self, j: int) -> ca.SX:
        """Smooth torques on link j beside the transmission."""
        torque = -self._size("link_viscous_friction", j, "coefficient") * self.dq[j]
        if found := self._on("cable_spring", j):
            p, gate = found
            torque += gate * p.value("stiffness") * (p.value("rest") - self.q[j])
        if found := self._on("end_stop", j):
            p, gate = found
            beyond = self.q[j] - p.value("position")
            pressed = ca.fmax(beyond, 0) if p.value("position") >= 0 else ca.fmin(beyond, 0)
            torque -= gate * p.value("stiffness") * pressed
        torque -= self._size("quadratic_drag", j, "coefficient") * ca.fabs(self.dq[j]) * self.dq[j]
        if found := self._on("periodic_disturbance", j):
            p, gate = found
            angle = 2 * np.pi * p.value("frequency") * self.t + p.value("phase")
            torque += gate * p.value("amplitude") * ca.sin(angle)
        for i, k in enumerate(self.masses):
            if self.effects[k].joint == self.robot.joints[j]:
                pull, _ = outside.wobbling(self.effects[k], *self._mass_state(i), ca.SX(0))
                torque += self.gates[k] * pull
        return torque + self._outside(outside.LINK, j, ca.SX(0))

    def _mass_state(self, i: int) -> tuple[ca.SX, ca.SX]:
        first = 5 * len(self.robot.joints) + outside.WOBBLING_STATES * i
        return self.x[first], self.x[first + 1]

    def _write(self) -> None:
        """Assemble the right-hand side and what decides over the modes."""
        self._levels: dict[Switch, tuple[ca.SX, ca.SX]] = {}  # dry friction forward, backward
        self._net: dict[Switch, ca.SX] = {}  # torque that a stuck motor or link has to withstand
        n = len(self.robot.joints)
        springs = [(ca.SX(0), ca.SX(0)) if self.rigid[j] else self._spring(j) for j in range(n)]
        ddq, tau_t, link_lack = self._link_accelerations([spring[0] for spring in springs])
        ddtheta, motor_lack = [], []
        for j in range(n):
            acceleration, lack = self._motor_acceleration(j, tau_t[j])
            ddtheta.append(ddq[j] if self.rigid[j] else acceleration)
            motor_lack.append(lack)
            if self.rigid[j]:
                motor_lack[j] += link_lack[j]
                link_lack[j] = ca.SX(0)
        dz = [self._state_rate(j) for j in range(n)]
        masses = []
        for i, k in enumerate(self.masses):
            angle, speed = self._mass_state(i)
            link = ddq[self.robot.index(self.effects[k].joint)]
            masses += [speed, outside.wobbling(self.effects[k], angle, speed, link)[1]]
        self.rate = ca.densify(ca.vertcat(self.dq, ddq, self.dtheta, *ddtheta, *dz, *masses))
        self.torque = ca.densify(ca.vertcat(*tau_t))
        self.balance = ca.densify(ca.vertcat(*motor_lack, *link_lack))
        margins, drives = [], []
        for k, switch in enumerate(self.switches):
            margin, drive = self._decision(switch, self.modes[k], springs[switch.joint][1])
            margins.append(margin)
            drives.append(drive)
        self.margin = ca.densify(ca.vertcat(ca.SX(0, 1), *margins))
        self.drive = ca.densify(ca.vertcat(ca.SX(0, 1), *drives))

    def _motor_torque(self, j: int, tau_t: ca.SX) -> ca.SX:
        """Torques on motor j beside dry friction; a rigid joint's transmission is no force of its own."""
        drive = self.u[j]
        if found := self._on("torque_speed_limit", j):
            p, gate = found
            drop = p.value("drop") * self.dtheta[j]
            held = ca.fmin(ca.fmax(drive, -p.value("stall") - drop), p.value("stall") - drop)
            drive += gate * (held - drive)
        if found := self._on("cogging", j):
            p, gate = found
            angle = p.value("cycles") * self.theta[j] + p.value("phase")
            drive += gate * p.value("amplitude") * ca.sin(angle)
        viscous = self.robot.motor_damping[j] + self._size("motor_viscous_friction", j, "coefficient")
        total = drive - (0 if self.rigid[j] else tau_t) - viscous * self.dtheta[j]
        total += self._outside(outside.MOTOR, j, tau_t)
        if found := self._on("dahl_friction", j):
            total -= found[1] * self.z[j]
        return total - self._shared_friction(j)

    def _creep(self, level: float, own: int, before: int) -> float:
        """Speed [rad/s] at which a shared friction creeps: what its level makes of the motors in 0.4 ms, two
        of the machine's steps, and CREEP at least."""
        lightness = 0.0 if self.rigid[own] else float(np.sum(1.0 / self.robot.motor_inertia[[own, before]]))
        return max(CREEP, 4e-4 * level * lightness)

    def _shared_friction(self, j: int) -> ca.SX:
        """What shafts that turn with joint j and the one before, or the one behind, take of motor j's
        torque."""
        total = ca.SX(0)
        for k, p in enumerate(self.effects):
            if p.effect not in SHARED:
                continue
            own, before = self.robot.index(p.joint), neighbour(self.robot, p)
            for sign, level, coefficient in _shafts(p):
                w = self.dtheta[own] + sign * self.dtheta[before]
                f = level * ca.tanh(w / self._creep(level, own, before)) + coefficient * w
                f *= self.gates[k]
                total += f if j == own else sign * f if j == before else 0
        return total

    def _motor_inertia(self, j: int) -> ca.SX:
        return self.robot.motor_inertia[j] * (1 + self._size("motor_inertia", j, "scale"))

    def _motor_acceleration(self, j: int, tau_t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """theta'' of a flexible joint, and what the motor lacks for a given one; a rigid joint's lack is
        that of its motor alone."""
        total = self._motor_torque(j, tau_t)
        inertia, given = self._motor_inertia(j), self.accelerations[len(self.rigid) + j]
        if (mode := self._mode("motor", j)) is None:
            return total / inertia, total - inertia * given
        switch = Switch("motor", j)
        levels = self._dry_levels(j, tau_t)
        if not self.rigid[j]:
            self._levels[switch], self._net[switch] = levels, total
        rubbing = total - _friction(mode, levels)
        return mode * mode * rubbing / inertia, rubbing - inertia * given

    def _link_accelerations(self, tau_t: list[ca.SX]) -> tuple[ca.SX, list[ca.SX], list[ca.SX]]:
        """q'', the transmissions' torques with those of rigid joints in place of their zeros, and what the
        links lack for given accelerations."""
        n, bodies = len(tau_t), list(self.robot.bodies)
        loads, gravity = self._loads_and_gravity()
        bias = inverse_dynamics(bodies, loads, gravity, self.q, self.dq, ca.SX(n, 1))
        carried = mass_matrix(bodies, loads, self.q)
        matrix, free = ca.SX(carried), ca.SX.ones(n)
        own = [self._link_torque(j) - bias[j] for j in range(n)]
        push = ca.vertcat(*[tau_t[j] - bias[j] + self._link_torque(j) for j in range(n)])
        for j in range(n):
            if self.rigid[j]:
                matrix[j, j] += self._motor_inertia(j)
                if (mode := self._mode("motor", j)) is not None:
                    free[j] = mode * mode
                continue
            if (mode := self._mode("link", j)) is not None:
                level = self._size("link_coulomb_friction", j, "level")
                self._levels[Switch("link", j)] = (level, level)
                push[j] -= mode * level
                free[j] = mode * mode
        lack = push - carried @ self.accelerations[:n]
        factors = ca.ldl(ca.diag(free) @ matrix @ ca.diag(free) + ca.diag(1 - free))
        tau_t = [-own[j] if self.rigid[j] else tau_t[j] for j in range(n)]  # at rest
        fed_back = any(p.effect in BY_LOAD for p in self.effects)
        for _ in range(SUBSTITUTIONS if self.rigid.any() and fed_back else 1):
            whole = ca.SX(push)
            for j in np.flatnonzero(self.rigid):
                whole[j] += self._rigid_push(int(j), tau_t[j])
            ddq = ca.ldl_solve(free * whole, *factors)
            held = carried @ ddq
            tau_t = [held[j] - own[j] if self.rigid[j] else tau_t[j] for j in range(n)]
        for switch in self.switches:
            j = switch.joint
            if switch.kind == "link" or (switch.kind == "motor" and self.rigid[j]):
                self._net[switch] = whole[j] - matrix[j, :] @ ddq
        return ddq, tau_t, [lack[j] for j in range(n)]

    def _rigid_push(self, j: int, tau_t: ca.SX) -> ca.SX:
        """What a rigid joint's motor adds to its link, dry friction of both included."""
        total = self._motor_torque(j, tau_t)
        if (mode := self._mode("motor", j)) is None:
            return total
        self._levels[Switch("motor", j)] = levels = self._dry_levels(j, tau_t)
        return total - _friction(mode, levels)

    def _decision(self, switch: Switch, mode: ca.SX, deflection: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Margin and drive of a switch."""
        j = switch.joint
        if switch.kind == "gap":
            half_gap = self._size("backlash", j, "gap") / 2
            inside, outside, drive = half_gap - ca.fabs(deflection), mode * deflection - half_gap, deflection
        else:
            (forward, backward), drive = self._levels[switch], self._net[switch]
            inside = ca.fmin(forward - drive, backward + drive)
            outside = mode * (self.dtheta[j] if switch.kind == "motor" else self.dq[j])
        return ca.if_else(mode == 0, inside, outside), drive


def _friction(mode: ca.SX, levels: tuple[ca.SX, ca.SX]) -> ca.SX:
    """mode * (level of the direction of motion)."""
    forward, backward = levels
    return mode * ((1 + mode) * forward + (1 - mode) * backward) / 2


def _tilted(roll: float, pitch: float, gravity: Array) -> Array:
    """(Rx(roll) Ry(pitch))^T g."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return (rx @ ry).T @ gravity


def _shafts(p: Planted) -> tuple[tuple[float, float, float], ...]:
    """Sign, level and coefficient of each shaft that a shared friction is on."""
    if p.effect == "coupled_friction":
        return ((1.0 if p.word("speed") == "sum" else -1.0, p.value("level"), p.value("coefficient")),)
    ways = ((1.0, "sum"), (-1.0, "difference"))
    return tuple((sign, p.value(f"level_{way}"), p.value(f"coefficient_{way}")) for sign, way in ways)
