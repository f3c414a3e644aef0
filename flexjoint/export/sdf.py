"""SDF of Gazebo: rigid joints with friction, damping, limits and springs to the parent link."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError
from flexjoint.export.base import Row, Way, absent, near
from flexjoint.export.rigid import NOTHING, STALL, UNVERIFIED, Mounted
from flexjoint.export.subject import Body, Subject
from flexjoint.export.urdf import heading
from flexjoint.export.xml import child, text, whole

VERSION = "1.9"  # of the format
NOTHING_MUCH = 1e-9  # kg and kg m^2, of a link that has no mass: SDF wants some
READ = "Drake reads it so; not verified in Gazebo"


class Sdf(Mounted):
    name = "sdf"
    title = "Gazebo"
    suffixes = (".sdf",)
    numbers: ClassVar[Mapping[str, Way]] = {
        "motor_inertia": absent("SDF has no armature"),
        "motor_damping": near(f"dynamics damping, with that of the link; {READ}"),
        "torque_limit": near(f"limit effort; {READ}"),
        "controller": absent("no plugin is written"),
        "sensing_delay": absent("no plugin is written"),
        "gravity": near(f"the base is mounted in the world so that gravity points down z; {READ}"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **NOTHING,
        "asymmetric_friction": near(f"dynamics friction of the mean level; {UNVERIFIED}"),
        "base_tilt": near(f"the base is mounted in the world, turned; {READ}"),
        "cable_spring": near(f"dynamics spring_stiffness and spring_reference; {READ}"),
        "link_coulomb_friction": near(f"dynamics friction; {UNVERIFIED}"),
        "link_viscous_friction": near(f"dynamics damping; {READ}"),
        "motor_coulomb_friction": near(f"dynamics friction; {UNVERIFIED}"),
        "motor_inertia": absent("SDF has no armature"),
        "motor_viscous_friction": near(f"dynamics damping; {READ}"),
        "payload": near(f"in the link's inertial; {READ}"),
        "rotor_inertia": absent("SDF has no armature"),
        "stribeck_friction": near(f"dynamics friction, without what it has more near rest; {UNVERIFIED}"),
        "torque_saturation": near(f"limit effort; {READ}"),
        "torque_speed_limit": near(f"limit effort {STALL}; {READ}"),
    }

    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        root = Element("sdf", version=VERSION)
        model = child(root, "model", name=subject.robot.name)
        bodies = subject.bodies
        names = {0: subject.base}
        floating = bool(bodies) and bodies[0].kind == "free"
        if not floating:
            _link(model, subject.base, subject.base_inertia, None, pin.SE3(subject.mounting, np.zeros(3)))
            mount = child(model, "joint", name="mounting", type="fixed")
            child(mount, "parent").text = "world"
            child(mount, "child").text = subject.base
        for body in bodies:
            if body.kind == "ball":
                raise RobotError(
                    f"{subject.robot.name}: joint {body.joint} is a ball, which is not written to SDF; lock"
                    " it in the robot file, or export to mjcf"
                )
            names[body.index] = body.link
            parent = None if body.kind == "free" else names[body.parent]
            _link(model, body.link, body.inertia, parent, body.placement)
            if parent is not None:
                _joint(model, subject, body, parent)
        return whole(root, heading(subject.robot, self.title, account))


def _link(model: Element, name: str, inertia: pin.Inertia, parent: str | None, place: pin.SE3) -> None:
    link = child(model, "link", name=name)
    pose = child(link, "pose", relative_to=parent)
    pose.text = text([*place.translation, *pin.rpy.matrixToRpy(place.rotation)])
    if inertia.mass == 0.0:  # a link without an inertial weighs 1 kg to SDF
        inertia = pin.Inertia(NOTHING_MUCH, np.zeros(3), NOTHING_MUCH * np.eye(3))
    inertial = child(link, "inertial")
    child(inertial, "pose").text = text([*inertia.lever, 0.0, 0.0, 0.0])
    child(inertial, "mass").text = text(inertia.mass)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia.tolist()
    moments = child(inertial, "inertia")
    for key, value in {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}.items():
        child(moments, key).text = text(value)


def _joint(model: Element, subject: Subject, body: Body, parent: str) -> None:
    slides = body.kind == "slide"
    joint = child(model, "joint", name=body.joint, type="prismatic" if slides else "revolute")
    child(joint, "parent").text = parent
    child(joint, "child").text = body.link  # whose frame is the joint's
    axis = child(joint, "axis")
    child(axis, "xyz").text = text(body.axis)
    limit = child(axis, "limit")
    for key, value in zip(("lower", "upper"), body.limits or (), strict=False):
        child(limit, key).text = text(value)
    effort = subject.most_torque(body.joint)
    if effort < float("inf"):
        child(limit, "effort").text = text(effort)
    if body.velocity_limit is not None:
        child(limit, "velocity").text = text(body.velocity_limit)
    dynamics = child(axis, "dynamics")
    numbers = {
        "damping": max(subject.viscous(body.joint), 0.0),
        "friction": subject.dry(body.joint),
        "spring_reference": subject.number("cable_spring", body.joint, "rest"),
        "spring_stiffness": subject.number("cable_spring", body.joint, "stiffness"),
    }
    for key, value in numbers.items():
        child(dynamics, key).text = text(value)
