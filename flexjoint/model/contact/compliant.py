"""Compliant contact of points, spheres and wheels with flat ground at height 0.

Along the normal, with depth d and the speed of sinking d' (Hunt and Crossley 1975, exponent 1):

    N = k d (1 + c d') where that pushes, else 0

Along the ground a spring k_t and a damper c_t between the contact point and an anchor that stays where it is.
The spring carries at most mu N: beyond it the anchor slips after the point. So a foot that stands stays where
it is, where friction smoothed over a velocity would creep. Under a sphere or a wheel the anchor rolls on with
the angular velocity omega: by r omega x n for a sphere, and for a wheel of axis a by r sigma a x u, with r u
from its lowest point to its centre and sigma the spin about a relative to u.

The anchors are two internal states per contact, along world x and y, behind those of effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.robot.contacts import GroundContact, joint_axis

TINY = 1e-30  # keeps divisions and square roots of 0 finite


@dataclass(frozen=True)
class Touch:
    """What the ground does at one instant, c contacts.

    tau (nv,): generalised forces on the robot. points and forces: c times 3 scalars along world axes, of the
    contact points [m] and of the forces on the robot there [N]. anchors and rates: 2 c scalars, where the
    anchors are once they have slipped [m], and how fast they roll on [m/s].
    """

    tau: Value
    points: list[list[Value]]
    forces: list[list[Value]]
    anchors: list[Value]
    rates: list[Value]


class Ground:
    """The contacts of a robot. `slot` is the place in z of the first anchor. `body` is everywhere the robot's
    PinBody or SymbolicBody: numbers or expressions, as it is."""

    springy = True  # a step may be too long for its springs

    def __init__(self, contacts: Sequence[GroundContact], model: pin.Model, slot: int) -> None:
        self.contacts = tuple(contacts)
        self.slots = slice(slot, slot + 2 * len(self.contacts))
        self.names = tuple(f"anchor_{axis}.{item.frame}" for item in self.contacts for axis in "xy")
        self._frames = [item.rolls or item.frame for item in self.contacts]
        self._axes = [None if item.rolls is None else joint_axis(model, item.rolls) for item in self.contacts]
        # for all at once: a sphere as a wheel without an axis
        self._turning = np.array([np.zeros(3) if axis is None else axis for axis in self._axes])[:, :, None]
        self._radii = np.array([item.radius for item in self.contacts])

    def touch(self, body: Any, q: Value, v: Value, z: Value, ahead: float = 0.0) -> Touch:
        """The ground's forces at q (nq,) and v (nv,), with the anchors of z (nz,) rolled on for `ahead`
        seconds."""
        anchors = ops.items(z[self.slots])
        tau: Value = ops.zeros(body.nv, body.symbolic)
        points: list[list[Value]] = []
        forces: list[list[Value]] = []
        after: list[Value] = []
        rates: list[Value] = []
        motions = body.frame_motions(q, self._frames)
        for k, (item, (placement, jacobian)) in enumerate(zip(self.contacts, motions, strict=True)):
            twist = ops.items(jacobian @ v)
            origin, up = _entries(placement[:3, 3]), [0.0, 0.0, 1.0]
            spin = twist[3:]
            rolling: list[Value] = [0.0, 0.0]
            axis = self._axes[k]
            if axis is not None:
                up, rolling = _wheel(_entries(placement[:3, :3] @ axis), spin, item.radius)
            elif item.radius > 0.0:
                rolling = [item.radius * spin[1], -item.radius * spin[0]]
            arm = [-item.radius * u for u in up]
            swing = _cross(spin, arm)
            point = [origin[j] + arm[j] for j in range(3)]
            velocity = [twist[j] + swing[j] for j in range(3)]
            anchor = [anchors[2 * k + j] + ahead * rolling[j] for j in range(2)]
            force, slipped = _law(item, point, velocity, anchor)
            wrench = ops.vector([*force, *_cross(arm, force)], body.symbolic)
            tau = tau + jacobian.T @ wrench
            points.append(point)
            forces.append(force)
            after += slipped
            rates += rolling
        return Touch(tau, points, forces, after, rates)

    def slipped(self, body: Any, q: Value, v: Value, z: Value) -> Value:
        """z (nz,) after the anchors have slipped as far as friction demands."""
        return self.with_anchors(body, z, self.touch(body, q, v, z).anchors)

    def with_anchors(self, body: Any, z: Value, anchors: Sequence[Value]) -> Value:
        """A copy of z (nz,) with these anchors (2 c)."""
        z = ops.copy(z)
        z[self.slots] = ops.vector(anchors, body.symbolic)
        return z

    def below(self, body: Any, q: Value) -> Value:
        """(2 c,) anchors right at the contact points of q (nq,): no force along the ground."""
        still = ops.zeros(body.nv, body.symbolic)
        z = ops.zeros(self.slots.stop, body.symbolic)
        points = self.touch(body, q, still, z).points
        return ops.vector([point[j] for point in points for j in range(2)], body.symbolic)

    def places(self, body: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of a PinBody at q (nq,): the contact points (c, 3) [m], and the Jacobians (c, 3, nv) of the
        bodies' velocities there, along world axes."""
        motions = body.frame_motions(q, self._frames)
        placements = np.array([placement for placement, _ in motions])
        jacobians = np.array([jacobian for _, jacobian in motions])
        turned = (placements[:, :3, :3] @ self._turning)[:, :, 0]
        up = -turned[:, 2:] * turned
        up[:, 2] += 1.0
        arm = (-self._radii / np.sqrt(up[:, 2] + TINY))[:, None] * up
        swing = np.zeros((len(motions), 3, 3))  # swing w = w x arm
        for row, column, entry in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            swing[:, row, column] = arm[:, entry]
            swing[:, column, row] = -arm[:, entry]
        return placements[:, :3, 3] + arm, jacobians[:, :3] + swing @ jacobians[:, 3:]

    def sinking(self, forces: np.ndarray) -> np.ndarray:
        """(c,) how deep the contacts sink under forces (c, 3) at rest [m]."""
        return forces[:, 2] / np.array([item.stiffness for item in self.contacts])

    def carrying(self, body: Any, z: Value, points: np.ndarray, forces: np.ndarray) -> Value:
        """A copy of z (nz,) with which contacts at rest at points (c, 3) [m] give forces (c, 3) [N]."""
        along = np.array([item.tangential_stiffness for item in self.contacts])
        anchors = points[:, :2] + forces[:, :2] / along[:, None]
        return self.with_anchors(body, z, anchors.ravel().tolist())


def _law(
    item: GroundContact, point: list[Value], velocity: list[Value], anchor: list[Value]
) -> tuple[list[Value], list[Value]]:
    """Force (3) on the robot, and the anchor (2) once it has slipped."""
    depth = ops.maximum(-point[2], 0.0)
    normal = item.stiffness * depth * ops.maximum(1.0 - item.dissipation * velocity[2], 0.0)
    cone = item.friction * normal
    stretch = [point[j] - anchor[j] for j in range(2)]
    kept = _within(cone, [item.tangential_stiffness * x for x in stretch])
    stretch = [kept * x for x in stretch]
    wanted = [
        -item.tangential_stiffness * x - item.tangential_damping * rate
        for x, rate in zip(stretch, velocity[:2], strict=True)
    ]
    share = _within(cone, wanted)
    return [share * wanted[0], share * wanted[1], normal], [point[j] - stretch[j] for j in range(2)]


def _within(limit: Value, force: list[Value]) -> Value:
    """The share of a force (2) that does not exceed the limit."""
    size = ops.sqrt(force[0] * force[0] + force[1] * force[1] + TINY)
    return ops.minimum(limit / size, 1.0)


def _wheel(axis: list[Value], spin: list[Value], radius: float) -> tuple[list[Value], list[Value]]:
    """Of a wheel: the unit vector (3) from its lowest point to its centre, and how its anchor rolls (2)."""
    tilt = axis[2]
    length = ops.sqrt(1.0 - tilt * tilt + TINY)
    up = [-tilt * axis[0] / length, -tilt * axis[1] / length, (1.0 - tilt * tilt) / length]
    turned = _dot(spin, axis) - tilt / length * _dot(spin, up)
    forward = _cross(axis, up)
    return up, [radius * turned * forward[0], radius * turned * forward[1]]


def _entries(column: Value) -> list[Value]:
    items = ops.items(column)
    return [items[j] for j in range(3)]


def _dot(a: list[Value], b: list[Value]) -> Value:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[Value], b: list[Value]) -> list[Value]:
    return [a[(j + 1) % 3] * b[(j + 2) % 3] - a[(j + 2) % 3] * b[(j + 1) % 3] for j in range(3)]
