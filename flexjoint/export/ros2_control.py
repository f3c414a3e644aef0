"""ros2_control: the interfaces and limits of the joints, to be put into the robot's URDF or xacro."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar
from xml.etree.ElementTree import Element

from flexjoint.export.base import Row, Target, Way, absent, near
from flexjoint.export.rigid import NOTHING, STALL, UNVERIFIED
from flexjoint.export.subject import Subject
from flexjoint.export.urdf import heading
from flexjoint.export.xml import child, note, whole

HARDWARE = "mock_components/GenericSystem"  # stands in until the robot's own plugin is named
BODIES = absent("bodies and joints are not in that file; export them to urdf")
DELAY = near("a comment: no tag of ros2_control delays")


class Ros2Control(Target):
    name = "ros2_control"
    title = "ros2_control"
    suffixes = (".xacro", ".urdf", ".xml")
    numbers: ClassVar[Mapping[str, Way]] = {
        "spring": BODIES,
        "motor_inertia": BODIES,
        "motor_damping": BODIES,
        "torque_limit": near(f"min and max of the effort's command interface; {UNVERIFIED}"),
        "controller": absent("gains belong to the controller's YAML"),
        "sensing_delay": DELAY,
        "gravity": BODIES,
        "contacts": BODIES,
        "couplings": absent("each motor turns one joint there"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **NOTHING,
        "sensor_delay": DELAY,
        "torque_delay": DELAY,
        "torque_saturation": near(f"min and max of the effort's command interface; {UNVERIFIED}"),
        "torque_speed_limit": near(f"min and max of the effort {STALL}; {UNVERIFIED}"),
    }

    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        robot = subject.robot
        root = Element("robot", name=robot.name)
        control = child(root, "ros2_control", name=robot.name, type="system")
        note(control, "put the plugin of the robot's hardware or simulator here")
        child(child(control, "hardware"), "plugin").text = HARDWARE
        note(control, f"update_rate of the controller_manager: {robot.rates.control:g} Hz")
        if robot.file.sensing_delay > 0.0:
            note(control, f"readings are {robot.file.sensing_delay:g} s old when the controller uses them")
        for body in subject.bodies:
            if subject.joint(body.joint) is None:
                continue
            joint = child(control, "joint", name=body.joint)
            for planned in subject.effects:
                if planned.joint == body.joint and planned.effect.overrides("delay"):
                    channels = planned.effect.channels(planned.p)
                    what = f"readings of {', '.join(channels)} arrive" if channels else "the effort acts"
                    note(joint, f"{what} {planned.effect.delay(planned.p):g} s late")
            command = child(joint, "command_interface", name="effort")
            most = subject.most_torque(body.joint)
            if most < math.inf:
                _limits(command, -most, most)
            position = child(joint, "state_interface", name="position")
            if body.limits is not None:
                note(position, f"from {body.limits[0]:g} to {body.limits[1]:g}, as the URDF's limit has it")
            child(joint, "state_interface", name="velocity")
            child(joint, "state_interface", name="effort")
        return whole(root, heading(robot, self.title, account))


def _limits(interface: Element, low: float, high: float) -> None:
    for name, value in (("min", low), ("max", high)):
        child(interface, "param", name=name).text = repr(value)
