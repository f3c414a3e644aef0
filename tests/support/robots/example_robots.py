"""Robots of example-robot-data as the tests and the benchmark drive them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pinocchio as pin

from flexjoint.robot import schema as robot_schema
from flexjoint.robot.description import example_robot_data
from flexjoint.robot.robot import Robot, build

# (URDF below robots/, its joints' drive): springs as stiff as such robots have them, motors as the kind
UR5 = ("ur_description/urdf/ur5_robot.urdf", {"stiffness": 8000, "damping": 6, "motor_inertia": 0.6,
       "motor_damping": 15, "torque_limit": 150, "kp": 3000, "kd": 60})  # fmt: skip
CENTAURO = ("centauro_description/urdf/centauro.urdf", {"stiffness": 2000, "damping": 1, "motor_inertia": 0.6,
            "motor_damping": 25, "torque_limit": 300, "kp": 1000, "kd": 20})  # fmt: skip


@cache
def example(which: tuple[str, tuple[tuple[str, float], ...]], **rates: float) -> Robot:
    """A robot with the same drive on every joint; see `ur5` and `centauro`."""
    name, drive = which
    urdf = example_robot_data() / "example-robot-data" / "robots" / name
    joints = [str(joint) for joint in pin.buildModelFromUrdf(str(urdf)).names][1:]
    file: dict[str, Any] = {"name": Path(name).stem, "urdf": str(urdf), "joints": {}}
    file["joints"] = {joint: dict(drive) for joint in joints}
    if rates:
        file["rates"] = dict(rates)
    return build(robot_schema.parse(file, name), Path("example.yaml"))


def ur5(**rates: float) -> Robot:
    """UR5 with springs, 6 joints."""
    return example((UR5[0], tuple(UR5[1].items())), **rates)


def centauro(**rates: float) -> Robot:
    """CENTAURO on a fixed base, 39 springs of 2000 N m/rad: the stiff case for its light distal joints."""
    return example((CENTAURO[0], tuple(CENTAURO[1].items())), **rates)
