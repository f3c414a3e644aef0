"""The two encoders of a joint against each other: a sign, a gear, a unit, a zero."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from flexjoint.diagnosis.data.columns import of_side
from flexjoint.diagnosis.data.travel import extent, slope
from flexjoint.diagnosis.result.values import DataFinding
from flexjoint.diagnosis.settings import DataSettings
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint, Robot

UNITS = {"degrees": 180.0 / math.pi, "turns": 0.5 / math.pi, "mrad": 1000.0}
TORQUES = ("tau_t", "tau_motor", "tau_m")  # that tell what a joint carries, the best one first
RARE = (0.5, 99.5)  # percentiles beyond which samples are left out


def differences(robot: Robot, recording: Recording, settings: DataSettings) -> Iterator[DataFinding]:
    """Where theta and q of a joint cannot both be right."""
    for joint in robot.joints:
        if not (recording.has("q", joint.name) and recording.has("theta", joint.name)):
            continue
        found = _scale(joint, recording, settings) or _sign(joint, recording, settings)
        if found is None and robot.file.offsets != "per_recording" and joint.name not in robot.prismatic:
            found = _zero(joint, recording, settings)
        if found is not None:
            yield found


def _sign(joint: Joint, recording: Recording, settings: DataSettings) -> DataFinding | None:
    found = slope(recording, joint.name, "theta", "q")
    if found is None or found.alike > -settings.sides_alike:
        return None
    if not 1.0 / settings.slope_one < -found.slope < settings.slope_one:
        return None
    columns = of_side(recording, joint.name, "theta", -1.0)
    text = (
        f"theta.{joint.name} runs against q.{joint.name} (slope {found.slope:.3g}): the motor encoder of"
        f" {joint.name} has the wrong sign"
    )
    return DataFinding("turned_motor_encoder", joint.name, text, columns)


def _scale(joint: Joint, recording: Recording, settings: DataSettings) -> DataFinding | None:
    """An encoder of another unit: what differs is more than any deflection."""
    name = joint.name
    found = slope(recording, name, "theta", "q")
    if found is None or abs(found.alike) < settings.sides_alike:
        return None
    size = abs(found.slope)
    travel = extent(recording, name, "theta"), extent(recording, name, "q")
    apart = abs(travel[0] - travel[1])
    bent = float(np.ptp(np.nanpercentile(_bent(joint, recording), RARE)))
    if 1.0 / settings.slope_one < size < settings.slope_one or apart < settings.deflected + bent:
        return None
    sign = math.copysign(1.0, found.slope)
    turned = " and the other way" if sign < 0.0 else ""
    told = f"theta.{name} moves {size:.5g} times as far as q.{name}{turned}"
    gear = joint.gear_ratio
    if gear is not None and 1.0 / settings.slope_gear < size / gear < settings.slope_gear:
        text = f"{told}: the motor's angle is not divided by the gear ratio of {gear:.6g}"
        return DataFinding("gear", name, text, of_side(recording, name, "theta", sign / gear))
    for unit, factor in UNITS.items():
        for side, ratio in (("theta", factor), ("q", 1.0 / factor)):
            if abs(math.log(size / ratio)) < math.log(settings.slope_unit):
                text = f"{told}: {side}.{name} looks like {unit}"
                scale = (sign if side == "theta" else 1.0) / factor
                return DataFinding("unit", name, text, of_side(recording, name, side, scale))
    if size > 1.0:
        text = f"{told}: the motor's angle is not divided by a gear ratio of about {size:.4g}"
        return DataFinding("gear", name, text, of_side(recording, name, "theta", sign / size))
    text = f"{told}: q.{name} or theta.{name} is in another unit"
    return DataFinding("unit", name, text, of_side(recording, name, "theta", sign / size))


def _zero(joint: Joint, recording: Recording, settings: DataSettings) -> DataFinding | None:
    name = joint.name
    apart = recording.get("theta", name) - recording.get("q", name)
    offset = float(np.nanmedian(apart))
    spring = 0.0 if joint.rigid else 3.0 * float(np.nanmedian(np.abs(apart - offset)))
    sag = abs(float(np.nanmedian(_bent(joint, recording))))
    if abs(offset) < settings.least_zero + spring + sag:
        return None
    text = (
        f"theta.{name} lies {offset:.4g} rad ({math.degrees(offset):.4g} degrees) beside q.{name}: the zero"
        f" of the motor encoder of {name} is off"
    )
    return DataFinding("zero", name, text, of_side(recording, name, "theta", 1.0, -offset))


def _bent(joint: Joint, recording: Recording) -> np.ndarray:
    """(N,) rad by which the recorded torque bends a joint's spring; 0 of a rigid one, and without torque."""
    torques = (recording.get(c, joint.name) for c in TORQUES if recording.has(c, joint.name))
    known = (torque for torque in torques if np.any(np.isfinite(torque)))
    return next(known, np.zeros_like(recording.time)) / float(joint.drive.K)
