"""Planted recordings: what a robot with a known defect would have recorded.

The generator shares no code with the package it helps to test: catalogue.py lists the effects, laws.py writes
every one down from its definition, chain.py and machine.py have their own dynamics and their own way of
stepping through dry friction.
"""

from .catalogue import BEYOND, CATALOGUE, Planted
from .robots import ROBOTS, read_robot, robot_file
from .sensing import (
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
