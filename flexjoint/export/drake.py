"""Drake: a URDF with the rotor's inertia and the gear ratio of each actuator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar
from xml.etree.ElementTree import Element

from flexjoint.export.base import Way, absent, near
from flexjoint.export.rigid import UNVERIFIED
from flexjoint.export.subject import Subject
from flexjoint.export.urdf import Urdf
from flexjoint.export.xml import child

TAGS = "http://drake.mit.edu"  # the namespace of Drake's own elements
NO_FRICTION = absent("Drake's joints have no dry friction")


class Drake(Urdf):
    name = "drake"
    title = "Drake"
    numbers: ClassVar[Mapping[str, Way]] = {
        **Urdf.numbers,
        "motor_inertia": near(f"drake:rotor_inertia and drake:gear_ratio of the actuator; {UNVERIFIED}"),
        "gravity": near(f"the base is mounted on the world so that gravity points down z; {UNVERIFIED}"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **Urdf.effects,
        "asymmetric_friction": NO_FRICTION,
        "base_tilt": near(f"the base is mounted on the world, turned; {UNVERIFIED}"),
        "friction_drift": NO_FRICTION,
        "link_coulomb_friction": NO_FRICTION,
        "motor_coulomb_friction": NO_FRICTION,
        "motor_inertia": near(f"drake:rotor_inertia; {UNVERIFIED}"),
        "payload": near(f"in the link's inertial; {UNVERIFIED}"),
        "stribeck_friction": NO_FRICTION,
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
