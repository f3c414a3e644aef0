"""Spatial algebra on CasADi SX, written plainly.

Six-vectors put the linear part first, as Pinocchio does; a body's frame is its joint's frame. The linear
part of an acceleration here is the conventional acceleration of the frame's origin, not the spatial one:
the two differ by omega x v (Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 2.11), and with the
conventional one no linear velocity is ever needed (Luh, Walker and Paul, 1980).

SX folds the constants 0 and 1 scalar by scalar, so that zero entries of a constant rotation, axis or
inertia cost no instruction: there is no second, sparse version of any formula. Entries that are computed
but not used (the lower triangle that `symmetric` drops) never reach a casadi.Function either.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import reduce

import casadi as ca
import numpy as np

# Below this square of the rotation angle a series is used: at 0.03 the closed form of `_cubic` has lost
# 6 eps / 0.03 = 4e-14 to cancellation, and the first dropped term of each series is below 1e-17.
_SMALL_ANGLE_SQUARED = 0.03


@dataclass(frozen=True)
class Placement:
    """A child frame seen from its parent: the origin (3,) in parent axes [m] and the rotation from child to
    parent axes as a product of one or more (3, 3) factors, the parent's first. Factors stay apart where
    two turns about single axes cost less than their dense product."""

    turns: tuple[ca.SX, ...]
    origin: ca.SX

    def __matmul__(self, other: Placement) -> Placement:
        return Placement((self.rotation @ other.rotation,), self.to_parent(other.origin) + self.origin)

    @property
    def rotation(self) -> ca.SX:
        """(3, 3)."""
        return reduce(operator.matmul, self.turns)

    def to_parent(self, vectors: ca.SX) -> ca.SX:
        """(3, n) vectors in child axes, in parent axes."""
        for turn in reversed(self.turns):
            vectors = turn @ vectors
        return vectors

    def to_child(self, vectors: ca.SX) -> ca.SX:
        """(3, n) vectors in parent axes, in child axes."""
        for turn in self.turns:
            vectors = turn.T @ vectors
        return vectors

    def tensor_to_parent(self, tensor: ca.SX) -> ca.SX:
        """(3, 3) in child axes, in parent axes."""
        for turn in reversed(self.turns):
            tensor = turn @ tensor @ turn.T
        return tensor

    def symmetric_to_parent(self, tensor: ca.SX) -> ca.SX:
        """Symmetric (3, 3) in child axes, in parent axes."""
        for turn in reversed(self.turns):
            tensor = symmetric(turn @ tensor @ turn.T)
        return tensor

    def wrench_to_parent(self, wrench: ca.SX) -> ca.SX:
        """(6, n) forces and moments about the child's origin, as such about the parent's."""
        force, moment = self.to_parent(wrench[:3, :]), self.to_parent(wrench[3:, :])
        return ca.vertcat(force, moment + skew(self.origin) @ force)

    def acceleration_to_child(self, acceleration: ca.SX) -> ca.SX:
        """(6,) acceleration of the child's frame when it is fixed in the parent, without the centripetal
        term, which `centripetal` gives."""
        linear, angular = acceleration[:3], acceleration[3:]
        return ca.vertcat(self.to_child(linear + ca.cross(angular, self.origin)), self.to_child(angular))

    def inertia_to_parent(self, inertia: ca.SX) -> ca.SX:
        """(6, 6) symmetric articulated inertia [[M, H'], [H, J]], moved to the parent's frame: with E the
        rotation and r the origin, M' = E M E', H' = E H E' + r x M', J' = E J E' + r x (E H E')' - H' x r
        (Featherstone 2008, sec. 7.1 and eq. 2.66)."""
        lever = skew(self.origin)
        mass = self.symmetric_to_parent(inertia[:3, :3])
        coupling = self.tensor_to_parent(inertia[3:, :3])
        moved = coupling + lever @ mass
        rotational = self.symmetric_to_parent(inertia[3:, 3:])
        rotational = symmetric(rotational + lever @ coupling.T - moved @ lever)
        return ca.blockcat([[mass, moved.T], [moved, rotational]])


@dataclass(frozen=True)
class RigidInertia:
    """Mass [kg], first moment m c (3,) [kg m] and rotational inertia (3, 3) about the frame's origin."""

    mass: ca.SX
    moment: ca.SX
    rotational: ca.SX

    @staticmethod
    def from_parameters(parameters: ca.SX) -> RigidInertia:
        """From (10,) m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz (Pinocchio's order of dynamic parameters)."""
        mass, moment = parameters[0], parameters[1:4]
        xx, xy, yy, xz, yz, zz = (parameters[k] for k in range(4, 10))
        return RigidInertia(mass, moment, ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    def __add__(self, other: RigidInertia) -> RigidInertia:
        return RigidInertia(
            self.mass + other.mass, self.moment + other.moment, self.rotational + other.rotational
        )

    def matrix(self) -> ca.SX:
        """(6, 6)."""
        coupling = skew(self.moment)
        return ca.blockcat([[self.mass * ca.SX.eye(3), coupling.T], [coupling, self.rotational]])

    def wrench(self, axes: ca.SX) -> ca.SX:
        """(6, n) inertia times n six-vectors."""
        linear, angular, coupling = axes[:3, :], axes[3:, :], skew(self.moment)
        return ca.vertcat(
            self.mass * linear - coupling @ angular, self.rotational @ angular + coupling @ linear
        )

    def to_parent(self, placement: Placement) -> RigidInertia:
        """The parallel-axis theorem (Featherstone 2008, eq. 2.66)."""
        lever = skew(placement.origin)
        moment = placement.to_parent(self.moment)
        moved = moment + self.mass * placement.origin
        rotational = placement.symmetric_to_parent(self.rotational)
        return RigidInertia(
            self.mass, moved, symmetric(rotational - lever @ skew(moment) - skew(moved) @ lever)
        )


def skew(vector: ca.SX) -> ca.SX:
    """(3, 3) matrix of the cross product with a vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    return ca.blockcat([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def symmetric(matrix: ca.SX) -> ca.SX:
    """The symmetric matrix of the upper triangle."""
    return ca.triu2symm(ca.triu(matrix))


def centripetal(spin: ca.SX) -> ca.SX:
    """(3, 3) matrix of omega x (omega x .)."""
    return symmetric(spin @ spin.T - ca.dot(spin, spin) * ca.SX.eye(3))


def body_regressor(spin: ca.SX, towards: ca.SX, acceleration: ca.SX) -> ca.SX:
    """(6, 10): times a body's inertial parameters it gives the wrench on it (Atkeson, An and Hollerbach,
    1986). `towards` is centripetal(spin); with E = alpha x + omega x omega x, the force is m a + E m c and
    the moment m c x a + J alpha + omega x J omega."""
    linear, angular = acceleration[:3], acceleration[3:]
    moment = _by_inertia(angular) + skew(spin) @ _by_inertia(spin)
    return ca.blockcat(
        [
            [linear, skew(angular) + towards, ca.SX(3, 6)],
            [ca.SX(3, 1), -skew(linear), moment],
        ]
    )


def _by_inertia(x: ca.SX) -> ca.SX:
    """(3, 6): J x as a matrix times Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    a, b, c = x[0], x[1], x[2]
    return ca.blockcat([[a, b, 0, c, 0, 0], [0, a, b, 0, c, 0], [0, 0, 0, a, b, c]])


def rotation_about(axis: np.ndarray, cosine: ca.SX, sine: ca.SX) -> ca.SX:
    """(3, 3) rotation about a constant unit axis (3,) (Rodrigues). In this grouping an axis of the frame
    leaves exact zeros and ones."""
    outer = np.outer(axis, axis)
    across = without_dust(np.eye(3) - outer)
    return ca.SX(outer) + sine * skew(ca.SX(axis)) + cosine * ca.SX(across)


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """(3, 3) rotation of a unit quaternion (4,) x, y, z, w."""
    x, y, z, w = (quaternion[k] for k in range(4))
    tx, ty, tz = 2 * x, 2 * y, 2 * z
    return ca.blockcat(
        [
            [1 - (ty * y + tz * z), ty * x - tz * w, tz * x + ty * w],
            [ty * x + tz * w, 1 - (tx * x + tz * z), tz * y - tx * w],
            [tz * x - ty * w, tz * y + tx * w, 1 - (tx * x + ty * y)],
        ]
    )


def quaternion_product(a: ca.SX, b: ca.SX) -> ca.SX:
    """(4,) Hamilton product of x, y, z, w quaternions."""
    va, vb, wa, wb = a[:3], b[:3], a[3], b[3]
    return ca.vertcat(wa * vb + wb * va + ca.cross(va, vb), wa * wb - ca.dot(va, vb))


def quaternion_exponential(rotation: ca.SX) -> ca.SX:
    """(4,) unit quaternion of a rotation vector (3,) [rad], smooth at 0."""
    half = rotation / 2
    squared = ca.dot(half, half)
    return ca.vertcat(sinc(squared) * half, cosine_of_square(squared))


def towards_unit(vector: ca.SX) -> ca.SX:
    """A vector of norm near 1, one Newton step nearer to it: without it round-off of many small steps adds
    up (Pinocchio's firstOrderNormalize)."""
    return vector * (3 - ca.dot(vector, vector)) / 2


def translation_of_twist(linear: ca.SX, rotation: ca.SX) -> ca.SX:
    """(3,) translation of the SE(3) exponential of a constant body twist for unit time: V(omega) v (Lynch
    and Park, Modern Robotics, 2017, eq. 3.88)."""
    squared = ca.dot(rotation, rotation)
    once = ca.cross(rotation, linear)
    # (1 - cos t) / t^2 = sinc(t / 2)^2 / 2 has no cancellation
    return linear + sinc(squared / 4) ** 2 / 2 * once + _cubic(squared) * ca.cross(rotation, once)


def sinc(squared: ca.SX) -> ca.SX:
    """sin(t) / t of t^2; smooth at 0, so that derivatives exist there."""
    angle = ca.sqrt(_away_from_zero(squared))
    series = _polynomial(squared, [1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800])
    return ca.if_else(squared < _SMALL_ANGLE_SQUARED, series, ca.sin(angle) / angle)


def cosine_of_square(squared: ca.SX) -> ca.SX:
    """cos(t) of t^2; smooth at 0."""
    angle = ca.sqrt(_away_from_zero(squared))
    series = _polynomial(squared, [1, -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800])
    return ca.if_else(squared < _SMALL_ANGLE_SQUARED, series, ca.cos(angle))


def _cubic(squared: ca.SX) -> ca.SX:
    """(t - sin t) / t^3 of t^2; smooth at 0."""
    safe = _away_from_zero(squared)
    angle = ca.sqrt(safe)
    series = _polynomial(squared, [1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800])
    return ca.if_else(squared < _SMALL_ANGLE_SQUARED, series, (angle - ca.sin(angle)) / (angle * safe))


def _away_from_zero(squared: ca.SX) -> ca.SX:
    """The branch that is not taken must stay finite: CasADi evaluates and differentiates both."""
    return ca.fmax(squared, _SMALL_ANGLE_SQUARED)


def _polynomial(x: ca.SX, coefficients: list[float]) -> ca.SX:
    total = ca.SX(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total


def without_dust(values: np.ndarray) -> np.ndarray:
    """The values with round-off removed: entries below 1e-15 of the largest become 0. A URDF's rpy leaves
    6e-17 where a 0 was meant, and every such entry would cost instructions."""
    values = np.asarray(values, dtype=float)
    return np.where(np.abs(values) < 1e-15 * np.max(np.abs(values), initial=0.0), 0.0, values)


def clean_rotation(rotation: np.ndarray) -> np.ndarray:
    """A rotation or a unit axis with round-off about 0, 1 and -1 removed."""
    nearest = np.round(rotation)
    return np.where(np.abs(rotation - nearest) < 1e-15, nearest, rotation)
