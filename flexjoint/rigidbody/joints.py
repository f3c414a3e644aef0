"""The joints of a pin.Model as constant data and CasADi SX expressions.

Every supported joint has motion axes that are constant in its own (child) frame, so none has a velocity
product of its own (c_J = 0 in Featherstone, Rigid Body Dynamics Algorithms, 2008, table 4.1).

A mimic joint follows another joint: its position is scale x + offset, its velocity scale dx. It has no
entries of its own in q and v: its slices are those of the joint that it follows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.core.errors import ModelError
from flexjoint.rigidbody.spatial import (
    Placement,
    clean_rotation,
    quaternion_exponential,
    quaternion_product,
    rotation_about,
    rotation_of,
    towards_unit,
    translation_of_twist,
    without_dust,
)


@dataclass(frozen=True)
class JointKind:
    """How one kind of joint places its child and takes a configuration step.

    place(axes, q) -> Placement of the moved frame in the fixed one; step(q, dv) -> q after a unit time at
    the velocity dv in the child's frame. axes is the constant (6, nv) motion subspace.
    """

    place: Callable[[np.ndarray, ca.SX], Placement]
    step: Callable[[ca.SX, ca.SX], ca.SX]


@dataclass(frozen=True)
class Joint:
    """One joint and the place of its numbers in q and v. `parent` is the parent joint's index, 0 the base;
    `mimics` whether it follows another joint, whose numbers q and v then are."""

    name: str
    kind: JointKind
    index: int
    parent: int
    q: slice
    v: slice
    axes: np.ndarray
    fixed: Placement
    mimics: bool = False

    def placement(self, q: ca.SX) -> Placement:
        """Of the child's frame in the parent joint's, at the whole configuration q (nq,)."""
        moving = self.kind.place(self.axes, q[self.q])
        joined = self.fixed @ moving
        apart = (*self.fixed.turns, *moving.turns)
        if sum(map(_entries, apart)) <= _entries(joined.rotation):
            return Placement(apart, joined.origin)
        return joined

    def velocity(self, v: ca.SX) -> ca.SX:
        """(6,) of the child relative to the parent, in the child's frame; v (nv,) is the whole velocity."""
        return ca.SX(self.axes) @ v[self.v]


def joints_of(model: pin.Model) -> list[Joint]:
    """The joints in the model's order, the universe left out.

    Raises ModelError that names the joint and its type where the type is not supported.
    """
    mimics = set(model.mimicking_joints)
    # model.mimicked_joints is not in the order of model.mimicking_joints; the place in v is shared
    leaders = {j.idx_v: j for k, j in enumerate(model.joints) if k and k not in mimics}
    joints = []
    for index in range(1, model.njoints):
        joint, name = model.joints[index], str(model.names[index])
        axes = _motion_subspace(model, index)
        leader = leaders[joint.idx_v]
        kind = _following(name, joint, leader, axes) if index in mimics else KINDS.get(joint.shortname())
        if kind is None:
            raise ModelError(
                f"joint {name!r} has type {joint.shortname()}, which the symbolic model does not support; "
                f"supported: {', '.join(sorted((*KINDS, MIMIC)))}. Replace it by a chain of these, or lock it"
            )
        placement = model.jointPlacements[index]
        joints.append(
            Joint(
                name=name,
                kind=kind,
                index=index,
                parent=int(model.parents[index]),
                q=slice(leader.idx_q, leader.idx_q + leader.nq),
                v=slice(leader.idx_v, leader.idx_v + leader.nv),
                axes=axes,
                fixed=Placement(
                    (ca.SX(clean_rotation(placement.rotation)),), ca.SX(without_dust(placement.translation))
                ),
                mimics=index in mimics,
            )
        )
    return joints


def _following(name: str, joint: pin.JointModel, leader: pin.JointModel, axes: np.ndarray) -> JointKind:
    """The kind of a mimic joint; `axes` (6, 1) holds its scale already. Pinocchio does not tell in Python of
    which type it is apart from that: its motion axis does.

    Raises ModelError where that is no turn about or shift along one axis.
    """
    mimic = joint.extract()
    scale, offset = float(mimic.scaling), float(mimic.offset)
    turns, shifts = bool(np.any(axes[3:])), bool(np.any(axes[:3]))
    if leader.nv != 1 or axes.shape != (6, 1) or turns == shifts:
        raise ModelError(
            f"joint {name!r} mimics another with the factor {scale:g} in a way that the symbolic model does"
            " not support: it takes revolute and prismatic joints that follow one by a factor other than 0"
        )
    place = _place_revolute if turns else _place_prismatic

    def placed(axes: np.ndarray, q: ca.SX) -> Placement:
        angle = ca.atan2(q[1], q[0]) if leader.nq == 2 else q
        return place(axes / scale, scale * angle + offset)

    return JointKind(placed, lambda q, dv: ca.SX(0, 1))


def _motion_subspace(model: pin.Model, index: int) -> np.ndarray:
    """(6, nv) in the child's frame, linear part first; of a mimic joint per velocity of its leader. Asked of
    Pinocchio's joint data, for not every joint model tells its axis in Python."""
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, pin.neutral(model))
    return clean_rotation(np.asarray(data.S, dtype=float).reshape(6, joint.nvExtended))


def _entries(rotation: ca.SX) -> int:
    """How many entries cost a multiplication: all but 0, 1 and -1."""
    entries = [rotation[k] for k in range(rotation.numel())]
    return sum(not (entry.is_zero() or entry.is_one() or entry.is_minus_one()) for entry in entries)


def _no_rotation() -> ca.SX:
    return ca.SX(np.eye(3))


def _no_translation() -> ca.SX:
    return ca.SX.zeros(3)


def _place_revolute(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((rotation_about(axes[3:, 0], ca.cos(q), ca.sin(q)),), _no_translation())


def _place_unbounded(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((rotation_about(axes[3:, 0], q[0], q[1]),), _no_translation())


def _place_prismatic(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((_no_rotation(),), ca.SX(axes[:3, 0]) * q)


def _place_translation(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((_no_rotation(),), q)


def _place_spherical(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((rotation_of(q),), _no_translation())


def _place_planar(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((rotation_about(axes[3:, 2], q[2], q[3]),), ca.vertcat(q[0], q[1], 0))


def _place_free_flyer(axes: np.ndarray, q: ca.SX) -> Placement:
    return Placement((rotation_of(q[3:]),), q[:3])


def _step_vector(q: ca.SX, dv: ca.SX) -> ca.SX:
    return q + dv


def _step_unbounded(q: ca.SX, dv: ca.SX) -> ca.SX:
    cosine, sine = ca.cos(dv), ca.sin(dv)
    return towards_unit(ca.vertcat(cosine * q[0] - sine * q[1], sine * q[0] + cosine * q[1]))


def _step_spherical(q: ca.SX, dv: ca.SX) -> ca.SX:
    return towards_unit(quaternion_product(q, quaternion_exponential(dv)))


def _step_planar(q: ca.SX, dv: ca.SX) -> ca.SX:
    cosine, sine = q[2], q[3]
    moved = translation_of_twist(ca.vertcat(dv[0], dv[1], 0), ca.vertcat(0, 0, dv[2]))
    return ca.vertcat(
        q[0] + cosine * moved[0] - sine * moved[1],
        q[1] + sine * moved[0] + cosine * moved[1],
        _step_unbounded(q[2:], dv[2]),
    )


def _step_free_flyer(q: ca.SX, dv: ca.SX) -> ca.SX:
    moved = rotation_of(q[3:]) @ translation_of_twist(dv[:3], dv[3:])
    return ca.vertcat(q[:3] + moved, _step_spherical(q[3:], dv[3:]))


_REVOLUTE = JointKind(_place_revolute, _step_vector)
_UNBOUNDED = JointKind(_place_unbounded, _step_unbounded)
_PRISMATIC = JointKind(_place_prismatic, _step_vector)

KINDS: dict[str, JointKind] = {
    **{f"JointModelR{axis}": _REVOLUTE for axis in "XYZ"},
    "JointModelRevoluteUnaligned": _REVOLUTE,
    **{f"JointModelRUB{axis}": _UNBOUNDED for axis in "XYZ"},
    "JointModelRevoluteUnboundedUnaligned": _UNBOUNDED,
    **{f"JointModelP{axis}": _PRISMATIC for axis in "XYZ"},
    "JointModelPrismaticUnaligned": _PRISMATIC,
    "JointModelTranslation": JointKind(_place_translation, _step_vector),
    "JointModelSpherical": JointKind(_place_spherical, _step_spherical),
    "JointModelPlanar": JointKind(_place_planar, _step_planar),
    "JointModelFreeFlyer": JointKind(_place_free_flyer, _step_free_flyer),
}
"""The supported joints beside mimic joints, by Pinocchio's type name."""

MIMIC = "JointModelMimic"
