"""Arms whose last two joints share motors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as make_recording
from flexjoint.robot.couplings import Coupling
from flexjoint.robot.robot import Robot
from support.robots.arms import SPATIAL, make

Matrix = tuple[tuple[float, ...], ...]
UNITY: Matrix = ((1.0, 0.0), (0.0, 1.0))
THROUGH: Matrix = ((1.0, 0.0), (1.0, 1.0))  # the last motor turns with both joints, as the TX40's
DIFFERENTIAL: Matrix = ((0.5, 0.5), (0.5, -0.5))
SHARED = (1, 2)  # roll and pitch
DAMPING = 0.3  # N m s/rad of the motors, so that they swing


def coupled(matrix: Matrix | None, *, rigid: bool) -> Robot:
    """The spatial arm, its roll and pitch by shared motors; None: uncoupled."""
    drive: dict[str, float] = {"motor_damping": DAMPING}
    if rigid:
        drive["stiffness"] = math.inf
    robot = make(SPATIAL, {name: drive for name, *_ in SPATIAL})
    return replace(robot, couplings=() if matrix is None else (Coupling(SHARED, matrix),))


def swinging(robot: Robot, seconds: float, rate: float = 1000.0) -> Recording:
    """A reference that turns all joints, each with its own rhythm, and stands at times."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    columns = {}
    for k, name in enumerate(robot.joint_names):
        wave = 0.5 * np.sin((1.3 + 0.55 * k) * time + k) + 0.12 * np.sin((4.1 + k) * time)
        columns["q_ref", name] = wave - wave[0]
    return make_recording(time, columns)
