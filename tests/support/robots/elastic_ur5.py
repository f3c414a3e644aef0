"""The UR5 of example-robot-data with series elastic actuators, whose numbers are assumed."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build

LARGE = {"stiffness": 12000, "damping": 4.0, "motor_inertia": 1.2, "motor_damping": 15, "torque_limit": 150}
SMALL = {"stiffness": 2500, "damping": 0.8, "motor_inertia": 0.12, "motor_damping": 2, "torque_limit": 28}
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


@cache
def ur5() -> Robot:
    joints: dict[str, Any] = {f"{name}_joint": LARGE if k < 3 else SMALL for k, name in enumerate(NAMES)}
    urdf = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    file = {"name": "ur5", "urdf": urdf, "joints": joints}
    return build(robot_schema.parse(file, "ur5"), Path("ur5.yaml"))
