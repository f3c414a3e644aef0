"""Velocities against the positions that they belong to: a sign, a gear, a unit."""

from __future__ import annotations

import math
from collections.abc import Iterator

from flexjoint.diagnosis.data.travel import slope
from flexjoint.diagnosis.result.values import Column, DataFinding
from flexjoint.diagnosis.settings import DataSettings
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

OF = {"dq": "q", "dtheta": "theta"}


def disagreeing(robot: Robot, recording: Recording, settings: DataSettings) -> Iterator[DataFinding]:
    """Velocities that run against their position, or as many times as fast as a unit or a gear makes it."""
    for joint in robot.joints:
        for velocity, position in OF.items():
            found = slope(recording, joint.name, velocity, position)
            if found is None or abs(found.alike) < settings.rates_alike:
                continue
            size, sign = abs(found.slope), math.copysign(1.0, found.slope)
            column, of = f"{velocity}.{joint.name}", f"the derivative of {position}.{joint.name}"
            if 1.0 / settings.slope_one < size < settings.slope_one:
                if sign < 0.0:
                    text = f"{column} runs against {of} (slope {found.slope:.3g}): it has the wrong sign"
                    yield DataFinding("turned_velocity", joint.name, text, (Column(column, column, -1.0),))
                continue
            if 1.0 / settings.least_scale < size < settings.least_scale:
                continue  # a filter, or noise: no unit
            gear = joint.gear_ratio
            known = gear is not None and 1.0 / settings.slope_gear < size / gear < settings.slope_gear
            reason = (
                f"it is not divided by the gear ratio of {gear:.6g}" if known else "it is in another unit"
            )
            scale = sign / (gear if known and gear is not None else size)
            text = f"{column} is {found.slope:.5g} times {of}: {reason}"
            yield DataFinding("gear" if known else "unit", joint.name, text, (Column(column, column, scale),))
