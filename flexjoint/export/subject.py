"""What is exported: a robot's bodies as Pinocchio has them, with the effects that the target carries."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError
from flexjoint.effects import Drive, Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Joint, Robot

Kind = Literal["hinge", "slide", "ball", "free"]
WORLD = "world"
UNLIMITED = 1e6  # of a position, velocity or torque, beyond which a limit of a description is none
TURNS = 0.5  # length of the angular part of an axis, above which it turns


@dataclass(frozen=True)
class Body:
    """A link with the joint that carries it.

    index and parent as Pinocchio counts joints (0: the base); placement of the joint in its parent's frame;
    axis (3,) of a hinge or slide, in the joint's frame; position limits (lower, upper), None where there is
    none; frames are those fixed to the link, by name.
    """

    index: int
    joint: str
    link: str
    parent: int
    kind: Kind
    axis: np.ndarray
    placement: pin.SE3
    inertia: pin.Inertia
    limits: tuple[float, float] | None
    velocity_limit: float | None
    armature: float
    frames: tuple[tuple[str, pin.SE3], ...]


@dataclass(frozen=True)
class Subject:
    """A robot with the effects that a target carries."""

    robot: Robot
    effects: tuple[Planned, ...]

    @cached_property
    def model(self) -> FlexibleJointModel:
        """With the carried effects: drives, inertial parameters and gravity are as they change them."""
        return FlexibleJointModel(self.robot, self.effects)

    @cached_property
    def base(self) -> str:
        """Name of the link that is fixed to the world; never world, which simulators keep for themselves."""
        known = {str(frame.name) for frame in self.robot.model.frames}
        name = _links(self.robot.model, 0)[0]
        if name != WORLD:
            return name
        return next(other for other in ("base", "base_link", "base.of.world") if other not in known)

    @property
    def base_inertia(self) -> pin.Inertia:
        """Of what is fixed to the world."""
        return self.robot.model.inertias[0]

    @cached_property
    def base_frames(self) -> tuple[tuple[str, pin.SE3], ...]:
        return _frames(self.robot.model, 0, _links(self.robot.model, 0)[0])

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """In Pinocchio's order: parents first."""
        return self.bodies_with(self.model)

    def bodies_with(self, model: FlexibleJointModel) -> tuple[Body, ...]:
        """The bodies of a model of the same robot, with other effects."""
        rows = np.asarray(model.body.inertial)
        return tuple(_body(self.robot, k, rows[k - 1]) for k in range(1, self.robot.model.njoints))

    @property
    def gravity(self) -> np.ndarray:
        """(3,) in the base frame [m/s^2], tilted as the effects have it."""
        return np.asarray(self.model.body.gravity)

    def joint(self, name: str) -> Joint | None:
        """The actuated joint of that name; None of a passive one."""
        return next((joint for joint in self.robot.joints if joint.name == name), None)

    def drive(self, joint: str) -> Drive:
        """The numbers of an actuated joint as the effects change them."""
        return self.model.flows[self.robot.joint_names.index(joint)].drive

    def viscous(self, joint: str) -> float:
        """Viscous friction of a joint whose motor and link are one [N m s/rad]."""
        motor = self.drive(joint).D_m if self.joint(joint) is not None else 0.0
        return float(motor) + self.number("link_viscous_friction", joint, "coefficient")

    def dry(self, joint: str) -> float:
        """Dry friction of a joint whose motor and link are one [N m]: what of it is always there."""
        mean = 0.5 * (
            self.number("asymmetric_friction", joint, "level_positive")
            + self.number("asymmetric_friction", joint, "level_negative")
        )
        return mean + sum(
            self.number(name, joint, "level")
            for name in (
                "motor_coulomb_friction",
                "link_coulomb_friction",
                "stribeck_friction",
            )
        )

    def most_torque(self, joint: str) -> float:
        """The torque that the motor of a joint gives at most [N m], inf where nothing limits it."""
        actuated = self.joint(joint)
        return min(
            actuated.torque_limit if actuated is not None else math.inf,
            self.number("torque_saturation", joint, "limit", math.inf),
            self.number("torque_speed_limit", joint, "stall", math.inf),
        )

    @property
    def mounting(self) -> np.ndarray:
        """(3, 3) the base's attitude in a world whose gravity points down its z axis."""
        gravity = self.gravity
        size = float(np.linalg.norm(gravity))
        if size == 0.0:
            return np.eye(3)
        return np.asarray(pin.Quaternion.FromTwoVectors(gravity / size, np.array([0.0, 0.0, -1.0])).matrix())

    def find(self, effect: str, joint: str | None) -> Any:
        """The parameters of an effect on a joint; None where it is not at work."""
        return next((e.p for e in self.effects if e.key == (effect, joint)), None)

    def number(self, effect: str, joint: str, name: str, default: float = 0.0) -> float:
        """One parameter of an effect on a joint, or what stands for its absence."""
        record = self.find(effect, joint)
        return default if record is None else float(getattr(record, name))


def _body(robot: Robot, k: int, row: np.ndarray) -> Body:
    model = robot.model
    joint, name = model.joints[k], str(model.names[k])
    kind, axis = _kind(robot, k)
    single = kind in ("hinge", "slide")
    limits = None
    if single and joint.nq == 1:
        low, high = (
            float(model.lowerPositionLimit[joint.idx_q]),
            float(model.upperPositionLimit[joint.idx_q]),
        )
        limits = (low, high) if -UNLIMITED < low < high < UNLIMITED else None
    speed = float(model.velocityLimit[joint.idx_v]) if single else math.inf
    links = _links(model, k)
    return Body(
        index=k,
        joint=name,
        link=links[0],
        parent=int(model.parents[k]),
        kind=kind,
        axis=axis,
        placement=model.jointPlacements[k],
        inertia=_inertia(row, name),
        limits=limits,
        velocity_limit=speed if 0.0 < speed < UNLIMITED else None,
        armature=float(model.armature[joint.idx_v]) if single else 0.0,
        frames=_frames(model, k, links[0]),
    )


def _kind(robot: Robot, k: int) -> tuple[Kind, np.ndarray]:
    joint, name = robot.model.joints[k], str(robot.model.names[k])
    kind = str(joint.shortname())
    if kind == "JointModelFreeFlyer" and int(robot.model.parents[k]) == 0:
        return "free", np.zeros(3)
    if kind == "JointModelSpherical":
        return "ball", np.zeros(3)
    if joint.nv != 1 or "Helical" in kind or "Mimic" in kind:
        raise RobotError(
            f"{robot.name}: joint {name} is a {kind.removeprefix('JointModel')}, which is not exported; lock"
            " it in the robot file to export the rest"
        )
    data = joint.createData()
    joint.calc(data, pin.neutral(robot.model))
    motion = np.asarray(data.S).reshape(6)
    turns = float(np.linalg.norm(motion[3:])) > TURNS
    return ("hinge", motion[3:]) if turns else ("slide", motion[:3])


def _inertia(row: np.ndarray, joint: str) -> pin.Inertia:
    mass = float(row[0])
    if mass < 0.0:
        raise RobotError(
            f"the link of joint {joint} weighs {mass:.4g} kg with the payloads that it carries; no simulator"
            " takes a negative mass: check the payload's mass"
        )
    if mass == 0.0:
        xx, xy, yy, xz, yz, zz = row[4:]
        return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    return pin.Inertia.FromDynamicParameters(np.asarray(row))


def _links(model: pin.Model, k: int) -> list[str]:
    """Names of the links on a joint, the joint's own first."""
    names = [str(f.name) for f in model.frames if f.type == pin.BODY and f.parentJoint == k]
    names = [name for name in names if name != "universe"]
    return names or [f"link.{model.names[k]}" if k else "base"]


def _frames(model: pin.Model, k: int, own: str) -> tuple[tuple[str, pin.SE3], ...]:
    return tuple(
        (str(frame.name), frame.placement)
        for frame in model.frames
        if frame.type == pin.BODY and frame.parentJoint == k and str(frame.name) not in ("universe", own)
    )
