"""Planted recordings: what a robot with a known defect would have recorded.

The generator shares no code with the package it helps to test: catalogue.py lists the effects, and machine/
writes every one down from its definition (laws.py), with its own dynamics (chain.py) and its own way to step
through dry friction (machine.py).
"""

from .catalogue import BEYOND, CATALOGUE, Planted
from .machine.sensing import (
    ENCODERS,
    FROM_CURRENT,
    FULL,
    LINK_SIDE,
    MOTOR_ONLY,
    NO_COMMAND,
    PERFECT,
    RAGGED,
    Ragged,
    SensorSet,
)
from .robots import ROBOTS, read_robot, robot_file
from .simulate import Recorded, plant

__all__ = [
    "BEYOND",
    "CATALOGUE",
    "ENCODERS",
    "FROM_CURRENT",
    "FULL",
    "LINK_SIDE",
    "MOTOR_ONLY",
    "NO_COMMAND",
    "PERFECT",
    "RAGGED",
    "ROBOTS",
    "Planted",
    "Ragged",
    "Recorded",
    "SensorSet",
    "plant",
    "read_robot",
    "robot_file",
]
