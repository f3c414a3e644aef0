"""What a tree of rigid bodies keeps over a step, and end velocities that keep it.

Energy: T1 + U1 - T0 - U0 is the work of the joints' torques at the midpoint. Momentum, where no ground is
touched: P1 - P0 = m g h, and the angular one about the centre of mass stays. A midpoint rule on coordinates
q and v misses both by O(h^3) a step, for M changes with q; what rings about a step's length adds these up.

The end velocities are put right by the least change in the metric of the mass matrix: momentum by moving the
robot as if its joints were locked (what Papadopoulos and Dubowsky 1991 call the locked inertia), energy by
scaling all motion relative to that. Both leave order 2 as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.numbers import floats

ROUNDING = 1e-13  # of the energies that are added up: a smaller difference is none
LITTLE = 0.25  # of the kinetic energy; what is put right by more was no midpoint
TINY = 1e-300  # keeps a division by an energy of 0 finite


class Conservation:
    """The totals of a model's bodies, and end velocities of steps of h seconds that keep them.

    Attributes:
        floating: whether all bodies hang on one free base. free: whether, besides, no ground is there, so
            that the total momentum is known.
    """

    def __init__(self, model: FlexibleJointModel, h: float) -> None:
        tree = model.robot.model
        self.model, self.h = model, h
        self.floating = floats(tree) and list(tree.parents[1:]).count(0) == 1
        self.free = self.floating and model.ground is None
        self.rotors = [(model.joints[i].idx_v, model.flows[i].drive.B) for i in model.rigid]

    def totals(self, q: Value, v: Value) -> list[Value]:
        """`totals` of the body, with the kinetic energy of rigid joints' motors, whose inertia is the link's;
        of a floating robot, kinetic energy as seen from its centre of mass."""
        own = 0.0
        for place, inertia in self.rotors:
            own = own + 0.5 * inertia * v[place] * v[place]
        if not self.floating:
            kinetic, *rest = self.model.body.totals(q, v, False)
            return [kinetic + own, *rest]
        # as seen from its base: a robot that is far away, or fast, would lose digits
        here, moving = ops.copy(q), ops.copy(v)
        here[:3], moving[:3] = 0.0, 0.0
        kinetic, *rest = self.model.body.totals(here, moving, True)
        mass, momentum = rest[15], rest[3:6]
        kinetic = kinetic - 0.5 * _dot(momentum, momentum) / mass + own
        carried = [_dot(row, v) for row in _rotation(q)]
        for k in range(3):
            rest[k] = rest[k] + mass * q[k]
            rest[3 + k] = rest[3 + k] + mass * carried[k]
        return [kinetic, *rest]

    def put_right(
        self, before: Value, after: Value, q: Value, passed: Value, end: Value, work: Value
    ) -> tuple[Value, Value]:
        """The end velocity (nv,), and whether it differs little from `end`: else it means nothing.

        Args:
            before, after: totals at the step's start, and at its end by the midpoint rule.
            q, passed: configuration there (nq,), and velocity by the midpoint rule (nv,).
            end: velocity after what else stops or strikes: it is scaled and moved as `passed` has to be.
            work: of the joints' torques over the step [J].
        """
        g, h = ops.items(self.model.body.gravity), self.h
        wanted, moving = before[0] + work, after[0]
        least = before[0] + after[0] + ops.absolute(work)
        if not self.free:  # else gravity does its work on the centre of mass alone
            wanted = wanted + sum(g[k] * (after[1 + k] - before[1 + k]) for k in range(3))
            least = least + sum(ops.absolute(g[k] * after[1 + k]) for k in range(3))
        if self.floating:
            mass = after[16]
            is_linear, is_angular = [after[k] for k in (4, 5, 6)], [after[k] for k in (7, 8, 9)]
            was_linear = [before[k] for k in (4, 5, 6)]
            linear, angular = is_linear, is_angular
            if self.free:
                linear = [was_linear[k] + h * mass * g[k] for k in range(3)]
                angular = [before[7 + k] for k in range(3)]
            else:
                gained = _dot(is_linear, is_linear) - _dot(was_linear, was_linear)
                wanted = wanted - 0.5 * gained / mass
            inertia = [after[k] for k in range(10, 16)]
            is_spin, spin = _solved(inertia, is_angular), _solved(inertia, angular)
            moving = moving - 0.5 * _dot(is_angular, is_spin)
            wanted = wanted - 0.5 * _dot(angular, spin)
        least = ROUNDING * least
        missed = ops.both(moving > least, ops.absolute(wanted - moving) > least)
        ratio = ops.where(missed, ops.maximum(wanted, 0.0) / ops.maximum(moving, TINY), 1.0)
        share = ops.sqrt(ratio)
        out = share * end
        if self.floating:
            lever = [q[k] - after[1 + k] / mass for k in range(3)]
            old, new = _twist(q, lever, is_linear, is_spin, mass), _twist(q, lever, linear, spin, mass)
            for k in range(6):
                out[k] = new[k] + share * (end[k] - old[k])
        return out, ops.both(ratio > LITTLE, ratio < 1.0 / LITTLE)


def _twist(
    q: Value, lever: Sequence[Value], momentum: Sequence[Value], spin: Sequence[Value], mass: Value
) -> list[Value]:
    """Velocity (6) of the base, in its own axes, of a body of that mass, momentum and angular velocity;
    lever: from the centre of mass to the base's origin."""
    turned = _cross(spin, lever)
    linear = [momentum[k] / mass + turned[k] for k in range(3)]
    columns = zip(*_rotation(q), strict=True)
    return [_dot(column, vector) for vector, column in product((linear, spin), columns)]


def _rotation(q: Value) -> tuple[tuple[Value, Value, Value], ...]:
    """Rows of the rotation from the axes of a floating base to the world's."""
    x, y, z, w = (q[k] for k in range(3, 7))
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


def _solved(symmetric: Sequence[Value], right: Sequence[Value]) -> list[Value]:
    """x of A x = right for a symmetric A of the entries xx, xy, yy, xz, yz, zz."""
    a, b, d, c, e, f = symmetric
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    yy, yz, zz = a * f - c * c, b * c - a * e, a * d - b * b
    size = a * xx + b * xy + c * xz
    return [_dot(row, right) / size for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]


def _dot(a: Sequence[Value], b: Sequence[Value]) -> Value:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Sequence[Value], b: Sequence[Value]) -> list[Value]:
    return [a[(j + 1) % 3] * b[(j + 2) % 3] - a[(j + 2) % 3] * b[(j + 1) % 3] for j in range(3)]
