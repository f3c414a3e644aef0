"""The Coriolis matrix on CasADi SX.

Echeandia and Wensing, Numerical methods to compute the Coriolis matrix and Christoffel symbols for
rigid-body systems (2021), in each body's own frame: of all matrices C with C v the Coriolis and centrifugal
forces it gives the one of the Christoffel symbols, with dM/dt - 2 C skew. Pinocchio computes the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from flexjoint.rigidbody.joints import Joint
from flexjoint.rigidbody.spatial import Placement, RigidInertia, skew, symmetric


@dataclass(frozen=True)
class _BodyCoriolis:
    """The 6 x 6 matrix B = (v x* I - I v x + (I v) xbar*) / 2 of a body, where f xbar* v = v x* f.

    Written out, its left half is 0 and its right half is [-skew(p); Q] with the momentum p (3,) and Q (3, 3).
    That form stays when bodies are added up along the tree.
    """

    momentum: ca.SX
    turning: ca.SX

    @staticmethod
    def of(inertia: RigidInertia, linear: ca.SX, spin: ca.SX) -> _BodyCoriolis:
        momentum = inertia.mass * linear + ca.cross(spin, inertia.moment)
        turned = skew(spin) @ inertia.rotational
        turning = (symmetric(turned + turned.T) - skew(inertia.rotational @ spin)) / 2
        return _BodyCoriolis(momentum, turning - skew(inertia.moment) @ skew(linear))

    def __add__(self, other: _BodyCoriolis) -> _BodyCoriolis:
        return _BodyCoriolis(self.momentum + other.momentum, self.turning + other.turning)

    def to_parent(self, placement: Placement) -> _BodyCoriolis:
        momentum = placement.to_parent(self.momentum)
        turning = placement.tensor_to_parent(self.turning)
        return _BodyCoriolis(momentum, turning - skew(placement.origin) @ skew(momentum))

    def wrench(self, axes: ca.SX) -> ca.SX:
        """(6, n) B times n six-vectors."""
        return ca.vertcat(-skew(self.momentum) @ axes[3:, :], self.turning @ axes[3:, :])

    def transposed_moment(self, axes: ca.SX) -> ca.SX:
        """(3, n) the moments of B' times n six-vectors; their forces are 0."""
        return skew(self.momentum) @ axes[:3, :] + self.turning.T @ axes[3:, :]


def coriolis_matrix(joints: Sequence[Joint], inertias: Sequence[RigidInertia], q: ca.SX, v: ca.SX) -> ca.SX:
    """(nv, nv) of a tree of bodies at q (nq,) and v (nv,)."""
    placements: list[Placement] = []
    spins: list[ca.SX] = []
    velocities: list[ca.SX] = []
    axes: list[ca.SX] = []
    rates: list[ca.SX] = []
    for joint in joints:
        placement, relative = joint.placement(q), joint.velocity(v)
        linear, spin = relative[:3], relative[3:]
        if joint.parent:
            base, turn = velocities[joint.parent - 1], spins[joint.parent - 1]
            linear = linear + placement.to_child(base + ca.cross(turn, placement.origin))
            spin = spin + placement.to_child(turn)
        own = ca.SX(joint.axes)
        rate = skew(spin) @ own[:3, :] + skew(linear) @ own[3:, :]
        placements.append(placement)
        spins.append(spin)
        velocities.append(linear)
        axes.append(own)
        rates.append(ca.vertcat(rate, skew(spin) @ own[3:, :]))

    composites = list(inertias)
    turnings = [_BodyCoriolis.of(*body) for body in zip(inertias, velocities, spins, strict=True)]
    result = ca.SX.zeros(v.numel(), v.numel())
    for k in reversed(range(len(joints))):
        joint, placement = joints[k], placements[k]
        if joint.parent:
            parent = joint.parent - 1
            composites[parent] = composites[parent] + composites[k].to_parent(placement)
            turnings[parent] = turnings[parent] + turnings[k].to_parent(placement)
        # the wrenches of the column of this joint, and those that make its row
        column = composites[k].wrench(rates[k]) + turnings[k].wrench(axes[k])
        by_rate = composites[k].wrench(axes[k])
        moment = turnings[k].transposed_moment(axes[k])
        by_axes = ca.vertcat(ca.SX(3, moment.size2()), moment)
        result[joint.v, joint.v] += axes[k].T @ column
        while joint.parent:
            placement = placements[joint.index - 1]
            column, by_rate, by_axes = (placement.wrench_to_parent(x) for x in (column, by_rate, by_axes))
            joint = joints[joint.parent - 1]
            up = joint.index - 1
            result[joint.v, joints[k].v] += axes[up].T @ column
            result[joints[k].v, joint.v] += by_rate.T @ rates[up] + by_axes.T @ axes[up]
    return result
