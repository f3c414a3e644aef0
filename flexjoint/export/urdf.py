"""URDF: rigid joints, with what it has words for: inertials, limits, viscous and dry friction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError
from flexjoint.export.base import Row, Way, absent, exact, lines, near
from flexjoint.export.rigid import NOTHING, STALL, Mounted
from flexjoint.export.subject import WORLD, Body, Subject
from flexjoint.export.xml import child, whole
from flexjoint.robot.robot import Robot

ENDLESS = 1e9  # a limit that is none, as URDF wants one
READ = "MuJoCo reads it so; others were not tried"
DAMPING = near(f"dynamics damping, of motor and link together; {READ}")
FRICTION = near(f"dynamics friction, of motor and link together; {READ}")


class Urdf(Mounted):
    name = "urdf"
    title = "URDF"
    suffixes = (".urdf",)
    numbers: ClassVar[Mapping[str, Way]] = {
        "motor_inertia": absent("a URDF has no armature; give the simulator motor_inertia of the robot file"),
        "motor_damping": DAMPING,
        "torque_limit": near(f"limit effort; {READ}"),
        "controller": absent("a URDF has no controller"),
        "sensing_delay": absent("a URDF has no controller"),
        "gravity": exact("the base is mounted on a link world so that gravity points down z"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **NOTHING,
        "asymmetric_friction": near(f"dynamics friction of the mean level; {READ}"),
        "base_tilt": exact("the base is mounted on a link world, turned"),
        "link_coulomb_friction": FRICTION,
        "link_viscous_friction": DAMPING,
        "motor_coulomb_friction": FRICTION,
        "motor_inertia": absent("a URDF has no armature"),
        "motor_viscous_friction": DAMPING,
        "payload": exact("in the link's inertial"),
        "rotor_inertia": absent("a URDF has no armature"),
        "stribeck_friction": near(f"dynamics friction, without what it has more near rest; {READ}"),
        "torque_saturation": near(f"limit effort; {READ}"),
        "torque_speed_limit": near(f"limit effort {STALL}; {READ}"),
    }

    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        root = Element("robot", name=subject.robot.name)
        self.fill(root, subject)
        return whole(root, heading(subject.robot, self.title, account))

    def fill(self, root: Element, subject: Subject) -> None:
        """Links and joints."""
        robot = subject.robot
        bodies = subject.bodies
        floating = bool(bodies) and bodies[0].kind == "free"
        links = {0: subject.base}
        if not floating:
            child(root, "link", name=WORLD)
            _fixed(root, WORLD, subject.base, pin.SE3(subject.mounting, np.zeros(3)))
            _link(root, subject.base, subject.base_inertia)
            _frames(root, subject.base, subject.base_frames)
        for body in bodies:
            links[body.index] = body.link
            _link(root, body.link, body.inertia)
            if body.kind == "free":
                _frames(root, body.link, body.frames)
                continue
            if body.kind == "ball":
                raise RobotError(
                    f"{robot.name}: joint {body.joint} is a ball, which a URDF does not have; lock it in the"
                    " robot file, or export to mjcf"
                )
            self._joint(root, subject, body, links[body.parent])
            _frames(root, body.link, body.frames)

    @staticmethod
    def _joint(root: Element, subject: Subject, body: Body, parent: str) -> None:
        slides = body.kind == "slide"
        free = "prismatic" if slides else "continuous"
        kind = free if body.limits is None else "prismatic" if slides else "revolute"
        joint = child(root, "joint", name=body.joint, type=kind)
        _origin(joint, body.placement)
        child(joint, "parent", link=parent)
        child(joint, "child", link=body.link)
        child(joint, "axis", xyz=body.axis)
        lower, upper = body.limits or ((-ENDLESS, ENDLESS) if slides else (None, None))
        child(
            joint,
            "limit",
            lower=lower,
            upper=upper,
            effort=min(subject.most_torque(body.joint), ENDLESS),
            velocity=body.velocity_limit or ENDLESS,
        )
        damping, friction = subject.viscous(body.joint), subject.dry(body.joint)
        if damping > 0.0 or friction > 0.0:
            child(joint, "dynamics", damping=max(damping, 0.0), friction=friction)


def heading(robot: Robot, title: str, account: tuple[Row, ...]) -> list[str]:
    """The lines of a file's comment."""
    return [
        f"{robot.name}, extended model, written by flexjoint export for {title}.",
        "All numbers are seen from the link, through the gear.",
        "How well numbers and effects are carried, and by what, or why not:",
        *lines(account),
    ]


def _link(root: Element, name: str, inertia: pin.Inertia) -> None:
    link = child(root, "link", name=name)
    if inertia.mass == 0.0 and not np.any(inertia.inertia):
        return
    inertial = child(link, "inertial")
    child(inertial, "origin", xyz=inertia.lever, rpy="0 0 0")
    child(inertial, "mass", value=inertia.mass)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia.tolist()
    child(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)


def _origin(joint: Element, place: pin.SE3) -> None:
    child(joint, "origin", xyz=place.translation, rpy=pin.rpy.matrixToRpy(place.rotation))


def _fixed(root: Element, parent: str, link: str, place: pin.SE3) -> None:
    joint = child(root, "joint", name=f"fixed.{link}", type="fixed")
    _origin(joint, place)
    child(joint, "parent", link=parent)
    child(joint, "child", link=link)


def _frames(root: Element, parent: str, frames: tuple[tuple[str, pin.SE3], ...]) -> None:
    for name, place in frames:
        child(root, "link", name=name)
        _fixed(root, parent, name, place)
