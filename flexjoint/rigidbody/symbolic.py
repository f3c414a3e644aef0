"""Rigid-body algorithms of a pin.Model on CasADi SX: the twin of `numeric.PinBody`.

The recursive algorithms of Featherstone, Rigid Body Dynamics Algorithms (2008), in each body's own frame:
Newton-Euler (ch. 5), composite rigid body (ch. 6), articulated body (ch. 7). See `spatial` for the
convention on accelerations that leaves linear velocities out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.core.errors import ModelError
from flexjoint.rigidbody.coriolis import coriolis_matrix
from flexjoint.rigidbody.joints import Joint, joints_of
from flexjoint.rigidbody.numeric import (
    checked_gravity,
    checked_inertial,
    find_frame,
    frames_by_name,
    inertial_of,
    read_only,
)
from flexjoint.rigidbody.spatial import (
    Placement,
    RigidInertia,
    body_regressor,
    centripetal,
    clean_rotation,
    skew,
    symmetric,
    without_dust,
)

Parameters = ca.SX | np.ndarray | None


@dataclass(frozen=True)
class _Motion:
    """Per joint in the model's order: placements in the parents, angular velocities (3,), the matrices of
    omega x (omega x .), and the part (6,) of the relative accelerations that velocities make."""

    placements: list[Placement]
    spins: list[ca.SX]
    centripetals: list[ca.SX]
    products: list[ca.SX]


class SymbolicBody:
    """PinBody's methods as CasADi SX expressions: same names, arguments, shapes and frames.
    `flexjoint.rigidbody.functions.make_function` makes a casadi.Function of one of them.

    Args:
        model: copied; never written on. Joints: revolute, unbounded revolute, prismatic (aligned or not),
            translation, spherical, planar, free-flyer, and revolute or prismatic ones that mimic another.
        inertial: (njoints - 1, 10) symbols, expressions or numbers that replace the model's inertial
            parameters: m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint frame's origin, SI.
        gravity: (3,) linear gravity in base axes that replaces the model's [m/s^2].
        armature: (nv,) rotor inertias that replace the model's [kg m^2].

    Raises:
        ModelError: a joint of another type (named with it), arguments of the wrong shape.
    """

    symbolic: ClassVar[bool] = True

    def __init__(
        self,
        model: pin.Model,
        inertial: Parameters = None,
        gravity: Parameters = None,
        armature: Parameters = None,
    ) -> None:
        self.nq: int = model.nq
        self.nv: int = model.nv
        self.neutral: np.ndarray = read_only(pin.neutral(model))
        self.armature: np.ndarray | ca.SX = _armature(model, armature)
        self.inertial: ca.SX = _inertial_expression(model, inertial)
        self.gravity: ca.SX = _gravity_expression(model, gravity)
        self._model = model.copy()
        self._frames = frames_by_name(model)
        self._joints: list[Joint] = joints_of(model)
        self._inertias = [
            RigidInertia.from_parameters(self.inertial[k, :].T) for k in range(len(self._joints))
        ]

    # ------------------------------------------------------------------ dynamics

    def aba(self, q: ca.SX, v: ca.SX, tau: ca.SX, armature: ca.SX) -> ca.SX:
        """Acceleration (nv,) under the joint forces tau; armature (nv,) is added to the model's own.

        The articulated-body algorithm (Featherstone 2008, table 7.1). A joint of several degrees of freedom
        is eliminated one axis after the other, which is the LDL' factorisation of its D without ever
        forming it. With mimic joints, bodies no longer move independently, and the mass matrix is solved.
        """
        q, v, tau = self._column(q, "q"), self._column(v, "v"), self._column(tau, "tau")
        armature = self._column(armature, "armature")
        if any(joint.mimics for joint in self._joints):
            return _solved(self.mass_matrix(q) + ca.diag(armature), tau - self.nle(q, v))
        armature = armature + ca.SX(self.armature)
        motion = self._motion(q, v)
        inertias = [inertia.matrix() for inertia in self._inertias]
        biases = [self._bias(k, motion) for k in range(len(self._joints))]
        columns: list[ca.SX] = [ca.SX(6, 1)] * self.nv
        inverses: list[ca.SX] = [ca.SX(1, 1)] * self.nv
        forces: list[ca.SX] = [ca.SX(1, 1)] * self.nv

        for k in reversed(range(len(self._joints))):
            joint = self._joints[k]
            for axis, dof in _axes(joint):
                columns[dof] = column = inertias[k] @ axis
                inverses[dof] = inverse = 1 / (axis.T @ column + armature[dof])
                forces[dof] = force = tau[dof] - axis.T @ biases[k]
                scaled = column * inverse
                inertias[k] = symmetric(inertias[k] - scaled @ column.T)
                biases[k] = biases[k] + scaled * force
            if joint.parent:
                parent, placement = joint.parent - 1, motion.placements[k]
                bias = biases[k] + inertias[k] @ motion.products[k]
                inertias[parent] = inertias[parent] + placement.inertia_to_parent(inertias[k])
                biases[parent] = biases[parent] + placement.wrench_to_parent(bias)

        result = ca.SX.zeros(self.nv)
        accelerations: list[ca.SX] = []
        base = self._base_acceleration()
        for k, joint in enumerate(self._joints):
            carrying = accelerations[joint.parent - 1] if joint.parent else base
            acceleration = motion.placements[k].acceleration_to_child(carrying) + motion.products[k]
            for axis, dof in reversed(_axes(joint)):
                result[dof] = inverses[dof] * (forces[dof] - columns[dof].T @ acceleration)
                acceleration = acceleration + axis * result[dof]
            accelerations.append(acceleration)
        return result

    def rnea(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """Joint forces (nv,) of the acceleration a, the model's own armature included."""
        q, v, a = self._column(q, "q"), self._column(v, "v"), self._column(a, "a")
        return self._newton_euler(q, v, a, self._base_acceleration()) + ca.SX(self.armature) * a

    def _newton_euler(self, q: ca.SX, v: ca.SX, a: ca.SX, base: ca.SX) -> ca.SX:
        """Joint forces (nv,) without the armature's, the base accelerating by base (6,)."""
        motion = self._motion(q, v)
        wrenches = [
            inertia.wrench(acceleration) + self._bias(k, motion)
            for k, (inertia, acceleration) in enumerate(
                zip(self._inertias, self._accelerations(motion, a, base), strict=True)
            )
        ]
        tau = ca.SX.zeros(self.nv)
        for k in reversed(range(len(self._joints))):
            joint = self._joints[k]
            tau[joint.v] += ca.SX(joint.axes).T @ wrenches[k]
            if joint.parent:
                moved = motion.placements[k].wrench_to_parent(wrenches[k])
                wrenches[joint.parent - 1] = wrenches[joint.parent - 1] + moved
        return tau

    def nle(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Coriolis, centrifugal and gravity forces (nv,)."""
        return self.rnea(q, v, ca.SX.zeros(self.nv))

    def gravity_torque(self, q: ca.SX) -> ca.SX:
        """Joint forces (nv,) that hold q at rest: each joint bears the weight of all that it carries."""
        placements = self._placements(q)
        carried = self._carried_masses(placements)
        tau = ca.SX.zeros(self.nv)
        upwards: list[ca.SX] = []
        for joint, placement, (mass, moment) in zip(self._joints, placements, carried, strict=True):
            upwards.append(placement.to_child(upwards[joint.parent - 1] if joint.parent else -self.gravity))
            wrench = ca.vertcat(mass * upwards[-1], ca.cross(moment, upwards[-1]))
            tau[joint.v] += ca.SX(joint.axes).T @ wrench
        return tau

    def coriolis_torque(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Coriolis and centrifugal forces (nv,)."""
        q, v = self._column(q, "q"), self._column(v, "v")
        return self._newton_euler(q, v, ca.SX.zeros(self.nv), ca.SX.zeros(6))

    def coriolis_matrix(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """C (nv, nv) of the Christoffel symbols: C v is coriolis_torque, dM/dt - 2 C is skew."""
        return coriolis_matrix(self._joints, self._inertias, self._column(q, "q"), self._column(v, "v"))

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """(nv, nv), dense and symmetric, the model's own armature included (Featherstone 2008, table 6.2)."""
        placements = self._placements(q)
        composites = list(self._inertias)
        mass = ca.SX.zeros(self.nv, self.nv)
        for k in reversed(range(len(self._joints))):
            joint = self._joints[k]
            if joint.parent:
                moved = composites[k].to_parent(placements[k])
                composites[joint.parent - 1] = composites[joint.parent - 1] + moved
            wrench = composites[k].wrench(ca.SX(joint.axes))
            mass[joint.v, joint.v] += symmetric(ca.SX(joint.axes).T @ wrench)
            for ancestor, carried in self._carried_up(k, placements, wrench):
                block = ca.SX(ancestor.axes).T @ carried
                mass[ancestor.v, joint.v] += block
                mass[joint.v, ancestor.v] += block.T
        return mass + ca.diag(ca.SX(self.armature))

    def regressor(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """(nv, 10 (njoints - 1)), sparse: times the stacked inertial parameters it gives rnea without the
        armature's share. Columns of bodies that a joint does not carry are structural zeros."""
        q, v, a = self._column(q, "q"), self._column(v, "v"), self._column(a, "a")
        motion = self._motion(q, v)
        result = ca.SX(self.nv, 10 * len(self._joints))
        for k, acceleration in enumerate(self._accelerations(motion, a, self._base_acceleration())):
            columns = slice(10 * k, 10 * k + 10)
            wrench = body_regressor(motion.spins[k], motion.centripetals[k], acceleration)
            result[self._joints[k].v, columns] += ca.SX(self._joints[k].axes).T @ wrench
            for ancestor, carried in self._carried_up(k, motion.placements, wrench):
                result[ancestor.v, columns] += ca.SX(ancestor.axes).T @ carried
        return result

    def totals(self, q: ca.SX, v: ca.SX, whole: bool) -> list[ca.SX]:
        """As PinBody.totals."""
        q, v = self._column(q, "q"), self._column(v, "v")
        placements = self._placements(q)
        velocities: list[ca.SX] = []
        wrenches: list[ca.SX] = []
        kinetic = ca.dot(ca.SX(self.armature), v * v) / 2
        for joint, placement, inertia in zip(self._joints, placements, self._inertias, strict=True):
            velocity = joint.velocity(v)
            if joint.parent:
                velocity = velocity + placement.acceleration_to_child(velocities[joint.parent - 1])
            velocities.append(velocity)
            wrenches.append(inertia.wrench(velocity))
            kinetic = kinetic + ca.dot(velocity, wrenches[-1]) / 2
        carried = list(self._inertias)
        total, momentum = RigidInertia(ca.SX(0), ca.SX.zeros(3), ca.SX.zeros(3, 3)), ca.SX.zeros(6)
        for k in reversed(range(len(self._joints))):
            moved = carried[k].to_parent(placements[k])
            wrench = placements[k].wrench_to_parent(wrenches[k])
            if parent := self._joints[k].parent:
                carried[parent - 1] = carried[parent - 1] + moved
                wrenches[parent - 1] = wrenches[parent - 1] + wrench
            else:
                total, momentum = total + moved, momentum + wrench
        found = [kinetic, *ca.vertsplit(total.moment)]
        if not whole:
            return found
        lever = skew(total.moment / total.mass)
        about = total.rotational + lever @ skew(total.moment)
        angular = momentum[3:] - lever @ momentum[:3]
        entries = [about[j, k] for j, k in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
        return [*found, *ca.vertsplit(momentum[:3]), *ca.vertsplit(angular), *entries, total.mass]

    # ------------------------------------------------------------------ kinematics

    def integrate(self, q: ca.SX, dv: ca.SX) -> ca.SX:
        """Configuration (nq,) after a unit time at the velocity dv (nv,); smooth at dv = 0.

        A free-flyer that turns by more than half a revolution in the step may get the quaternion of
        opposite sign to PinBody's: the same rotation.
        """
        q, dv = self._column(q, "q"), self._column(dv, "dv")
        return ca.vertcat(*(joint.kind.step(q[joint.q], dv[joint.v]) for joint in self._joints))

    def frame_placement(self, q: ca.SX, frame: str) -> ca.SX:
        """(4, 4) homogeneous placement of a frame in the base; the zeros of its last row are structural."""
        placement, _ = self._frame(self._world(q), frame)
        return ca.blockcat([[placement.rotation, placement.origin], [ca.SX(1, 3), ca.SX(1)]])

    def frame_jacobian(self, q: ca.SX, frame: str) -> ca.SX:
        """(6, nv), linear part first, of the frame's origin along base axes (LOCAL_WORLD_ALIGNED)."""
        world = self._world(q)
        placement, parent = self._frame(world, frame)
        jacobian = ca.SX.zeros(6, self.nv)
        while parent:
            joint, here = self._joints[parent - 1], world[parent - 1]
            linear, angular = here.rotation @ ca.SX(joint.axes[:3]), here.rotation @ ca.SX(joint.axes[3:])
            lever = placement.origin - here.origin
            linear = linear + ca.horzcat(*(ca.cross(angle, lever) for angle in ca.horzsplit(angular)))
            jacobian[:, joint.v] += ca.vertcat(linear, angular)
            parent = joint.parent
        return jacobian

    def frame_motions(self, q: ca.SX, frames: Sequence[str]) -> list[tuple[ca.SX, ca.SX]]:
        """frame_placement and frame_jacobian of several frames."""
        return [(self.frame_placement(q, name), self.frame_jacobian(q, name)) for name in frames]

    def center_of_mass(self, q: ca.SX) -> ca.SX:
        """(3,) in the base, of the moving bodies: what is fixed to the base does not count."""
        placements = self._placements(q)
        total, moments = ca.SX(0), ca.SX.zeros(3)
        for joint, placement, carried in zip(
            self._joints, placements, self._carried_masses(placements), strict=True
        ):
            if not joint.parent:
                mass, moment = _moved(placement, *carried)
                total, moments = total + mass, moments + moment
        return moments / total

    # ------------------------------------------------------------------ shared parts

    def _column(self, value: ca.SX, name: str) -> ca.SX:
        size = self.nq if name == "q" else self.nv
        column = ca.densify(ca.SX(value))
        if column.shape != (size, 1):
            raise ModelError(f"{name}: expected a column of {size} entries, got shape {column.shape}")
        return column

    def _motion(self, q: ca.SX, v: ca.SX) -> _Motion:
        """The outward pass that needs positions and velocities only."""
        motion = _Motion([], [], [], [])
        for joint in self._joints:
            placement, relative = joint.placement(q), joint.velocity(v)
            if joint.parent:
                carried = placement.to_child(motion.spins[joint.parent - 1])
                towards = placement.to_child(motion.centripetals[joint.parent - 1] @ placement.origin)
            else:
                carried = towards = ca.SX.zeros(3)
            linear, angular = relative[:3], relative[3:]
            spin = carried + angular
            # second derivative of the origin: centripetal, Coriolis 2 omega_p x v, and omega_J x v because
            # the relative velocity is constant in the turning child frame
            product = towards + ca.cross(carried + spin, linear)
            motion.placements.append(placement)
            motion.spins.append(spin)
            motion.centripetals.append(centripetal(spin))
            motion.products.append(ca.vertcat(product, ca.cross(carried, angular)))
        return motion

    def _base_acceleration(self) -> ca.SX:
        """(6,) against gravity, which makes every weight."""
        return ca.vertcat(-self.gravity, ca.SX.zeros(3))

    def _accelerations(self, motion: _Motion, a: ca.SX, base: ca.SX) -> list[ca.SX]:
        """(6,) of each body's frame at the joint accelerations a."""
        accelerations: list[ca.SX] = []
        for placement, product, joint in zip(motion.placements, motion.products, self._joints, strict=True):
            parent = accelerations[joint.parent - 1] if joint.parent else base
            carried = placement.acceleration_to_child(parent)
            accelerations.append(carried + product + joint.velocity(a))
        return accelerations

    def _placements(self, q: ca.SX) -> list[Placement]:
        """Of each joint's frame in its parent's."""
        q = self._column(q, "q")
        return [joint.placement(q) for joint in self._joints]

    def _carried_masses(self, placements: list[Placement]) -> list[tuple[ca.SX, ca.SX]]:
        """Mass and first moment (3,), about its frame, of all that each joint carries."""
        carried = [(inertia.mass, inertia.moment) for inertia in self._inertias]
        for k in reversed(range(len(self._joints))):
            if parent := self._joints[k].parent:
                mass, moment = _moved(placements[k], *carried[k])
                carried[parent - 1] = carried[parent - 1][0] + mass, carried[parent - 1][1] + moment
        return carried

    def _bias(self, k: int, motion: _Motion) -> ca.SX:
        """(6,) wrench that body k needs at zero acceleration: omega x (omega x m c), omega x J omega."""
        inertia, spin = self._inertias[k], motion.spins[k]
        return ca.vertcat(motion.centripetals[k] @ inertia.moment, ca.cross(spin, inertia.rotational @ spin))

    def _carried_up(self, k: int, placements: list[Placement], wrench: ca.SX) -> list[tuple[Joint, ca.SX]]:
        """The wrench on body k in the frame of each of its ancestors, from the nearest to the root's."""
        carried = []
        joint = self._joints[k]
        while joint.parent:
            wrench = placements[joint.index - 1].wrench_to_parent(wrench)
            joint = self._joints[joint.parent - 1]
            carried.append((joint, wrench))
        return carried

    def _world(self, q: ca.SX) -> list[Placement]:
        """The placement of each joint's frame in the base."""
        world: list[Placement] = []
        for joint, local in zip(self._joints, self._placements(q), strict=True):
            world.append(world[joint.parent - 1] @ local if joint.parent else local)
        return world

    def _frame(self, world: list[Placement], name: str) -> tuple[Placement, int]:
        """The frame in the base and its parent joint."""
        frame = self._model.frames[find_frame(self._frames, name)]
        local = Placement(
            (ca.SX(clean_rotation(frame.placement.rotation)),),
            ca.SX(without_dust(frame.placement.translation)),
        )
        parent = int(frame.parentJoint)
        return (world[parent - 1] @ local if parent else local), parent


def _axes(joint: Joint) -> list[tuple[ca.DM, int]]:
    """The motion axes (6,) as sparse constants, each with its index in v."""
    return [(ca.sparsify(ca.DM(joint.axes[:, k])), joint.v.start + k) for k in range(joint.axes.shape[1])]


def _moved(placement: Placement, mass: ca.SX, moment: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Mass and first moment (3,) about the parent's frame."""
    return mass, placement.to_parent(moment) + mass * placement.origin


def _solved(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """(n,) solution for a symmetric positive definite (n, n) matrix, by LDL'."""
    diagonal, upper, order = ca.ldl(matrix)
    return ca.ldl_solve(right, diagonal, upper, order)


def _armature(model: pin.Model, armature: Parameters) -> np.ndarray | ca.SX:
    """(nv,)."""
    if isinstance(armature, ca.SX):
        if armature.shape != (model.nv, 1):
            raise ModelError(f"armature: expected shape {(model.nv, 1)}, got {armature.shape}")
        return ca.densify(armature)
    values = np.array(model.armature if armature is None else armature, dtype=float)
    if values.shape != (model.nv,) or not np.all(np.isfinite(values)):
        raise ModelError(f"armature: expected {model.nv} finite numbers [kg m^2], got {armature!r}")
    return read_only(values)


def _inertial_expression(model: pin.Model, inertial: Parameters) -> ca.SX:
    """(njoints - 1, 10)."""
    if isinstance(inertial, ca.SX):
        if inertial.shape != (model.njoints - 1, 10):
            raise ModelError(f"inertial: expected shape {(model.njoints - 1, 10)}, got {inertial.shape}")
        return ca.densify(inertial)
    values = inertial_of(model) if inertial is None else checked_inertial(model, inertial)
    groups = (slice(0, 1), slice(1, 4), slice(4, 10))
    return ca.SX(np.array([np.concatenate([without_dust(row[g]) for g in groups]) for row in values]))


def _gravity_expression(model: pin.Model, gravity: Parameters) -> ca.SX:
    """(3,)."""
    if isinstance(gravity, ca.SX):
        if gravity.shape != (3, 1):
            raise ModelError(f"gravity: expected shape (3, 1), got {gravity.shape}")
        return ca.densify(gravity)
    return ca.SX(model.gravity.linear if gravity is None else checked_gravity(gravity))
