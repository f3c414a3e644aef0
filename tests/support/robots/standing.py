"""CENTAURO of example-robot-data with its published drives, on its base or on its four wheels."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.forces import Contact
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build

# stiffness, damping, motor inertia, torque limit, link-referred; ADVRHumanoids/centauro-simulator (2017)
_DRIVES = {
    "hip_yaw": (80000, 2, 0.645, 304),
    "hip_pitch": (80000, 2, 0.778, 304),
    "knee_pitch": (80000, 2, 0.778, 304),
    "ankle_pitch": (80000, 2, 1.181, 147),
    "ankle_yaw": (40000, 1, 0.126, 35),
    "j_wheel": (40000, 1, 0.126, 35),
}
_ARM = [(6000, 0.05, 1.181, 147)] * 2 + [(6000, 0.05, 0.846, 147)] * 2 + [(9400, 0.1, 0.163, 55)] * 2
# vertical shanks: ankle = knee - hip_pitch, ankle_yaw = -hip_yaw; legs alternate in sign
_SPIDER = {"hip_yaw": -0.7611, "hip_pitch": -1.4483, "knee_pitch": -1.0842, "ankle_pitch": 0.3641,
           "ankle_yaw": 0.7611}  # fmt: skip
_ARMS = {"j_arm1": (0.3, 0.3, 0.3, -0.5, 0.3, 0.3), "j_arm2": (0.3, -0.3, 0.3, -0.5, 0.3, 0.3)}
_SIGNS = (1.0, -1.0, -1.0, 1.0)
FEET = tuple(Contact(f"contact_{k}", pushes=True) for k in (1, 2, 3, 4))


@cache
def centauro(base: str = "floating") -> Robot:
    drives = {f"{name}_{k}": values for name, values in _DRIVES.items() for k in (1, 2, 3, 4)}
    drives["torso_yaw"] = _ARM[0]
    drives |= {f"j_arm{arm}_{k + 1}": values for arm in (1, 2) for k, values in enumerate(_ARM)}
    keys = ("stiffness", "damping", "motor_inertia", "torque_limit")
    joints: dict[str, Any] = {name: dict(zip(keys, values, strict=True)) for name, values in drives.items()}
    file = {
        "name": "centauro",
        "urdf": "package://example-robot-data/robots/centauro_description/urdf/centauro.urdf",
        "base": base,
        "lock": ["velodyne_joint", "d435_head_joint"],
        "joints": joints,
    }
    return build(robot_schema.parse(file, "centauro"), Path("centauro.yaml"))


def model(base: str = "floating", effects: tuple[Planned, ...] = ()) -> FlexibleJointModel:
    return FlexibleJointModel(centauro(base), effects)


def spider(of: FlexibleJointModel) -> np.ndarray:
    """(nq,) legs wide apart, arms a little bent."""
    q = of.body.neutral.copy()
    for joint in of.joints:
        name, _, number = joint.name.rpartition("_")
        if name in _SPIDER:
            q[joint.idx_q] = _SIGNS[int(number) - 1] * _SPIDER[name]
        elif name.startswith("j_arm"):
            q[joint.idx_q] = _ARMS[name][int(number) - 1]
    return q
