"""Drake: a URDF with the rotor's inertia and the gear ratio of each actuator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar
from xml.etree.ElementTree import Element

from flexjoint.export.base import Way, absent, exact, near
from flexjoint.export.rigid import STALL
from flexjoint.export.subject import Subject
from flexjoint.export.urdf import Urdf
from flexjoint.export.xml import child

TAGS = "http://drake.mit.edu"  # the namespace of Drake's own elements
NO_FRICTION = absent("Drake's joints have no dry friction")
DAMPING = exact("dynamics damping, of motor and link together")
EFFORT = near("limit effort, which Drake keeps as the actuator's; commands beyond it are for you to clip")


class Drake(Urdf):
    name = "drake"
    title = "Drake"
    numbers: ClassVar[Mapping[str, Way]] = {
        **Urdf.numbers,
        "motor_inertia": exact("drake:rotor_inertia and drake:gear_ratio of the actuator"),
        "motor_damping": DAMPING,
        "torque_limit": EFFORT,
        "gravity": exact("the base is mounted on the world so that gravity points down z"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **Urdf.effects,
        "asymmetric_friction": NO_FRICTION,
        "base_tilt": exact("the base is mounted on the world, turned"),
        "link_coulomb_friction": NO_FRICTION,
        "link_viscous_friction": DAMPING,
        "motor_coulomb_friction": NO_FRICTION,
        "motor_inertia": exact("drake:rotor_inertia of the actuator"),
        "motor_viscous_friction": DAMPING,
        "payload": exact("in the link's inertial"),
        "rotor_inertia": exact("drake:rotor_inertia of the actuator"),
        "stribeck_friction": NO_FRICTION,
        "torque_saturation": EFFORT,
        "torque_speed_limit": near(f"limit effort {STALL}"),
    }

    def fill(self, root: Element, subject: Subject) -> None:
        super().fill(root, subject)
        root.set("xmlns:drake", TAGS)
        for joint in subject.robot.joints:
            gear = joint.gear_ratio or 1.0
            transmission = child(root, "transmission", name=f"transmission.{joint.name}")
            child(transmission, "type").text = "transmission_interface/SimpleTransmission"
            driven = child(transmission, "joint", name=joint.name)
            child(driven, "hardwareInterface").text = "EffortJointInterface"
            actuator = child(transmission, "actuator", name=joint.name)
            # Drake reflects the rotor's inertia by the gear: B = u^2 J
            child(actuator, "drake:rotor_inertia", value=subject.drive(joint.name).B / gear**2)
            child(actuator, "drake:gear_ratio", value=gear)
