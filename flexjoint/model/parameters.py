"""The numbers of a model by name: effect.joint.name, drive.joint.stiffness, body.joint.mx.

The symbolic model, compiled runs and batches name their parameters in this order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexjoint.core.parameter import SMALLEST, Parameter
from flexjoint.effects import Planned
from flexjoint.rigidbody.numeric import inertial_of
from flexjoint.robot.robot import Joint, Robot

FREE = ("drives", "inertial")
DRIVE_KEYS = {"K": "stiffness", "D": "damping", "B": "motor_inertia", "D_m": "motor_damping"}
DRIVE_UNITS = {"K": "N m/rad", "D": "N m s/rad", "B": "kg m^2", "D_m": "N m s/rad"}
# field of the robot file's `tolerance` that says how far a drive's number is trusted
DRIVE_TOLERANCES = {"K": "stiffness", "D": "damping", "B": "inertial", "D_m": "damping"}
INERTIAL_KEYS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIAL_UNITS = ("kg", *(["kg m"] * 3), *(["kg m^2"] * 6))


def model_parameters(
    robot: Robot, effects: Iterable[Planned], free: Collection[str] = ()
) -> dict[str, Parameter]:
    """The parameters of a robot with effects by name, in the order of `SymbolicModel.parameters`: those of
    the effects, then with "drives" those of the drives, then with "inertial" those of the bodies.

    `std` is the standard error of a fitted effect, and of a drive the robot file's tolerance. Of a body it is
    None: the tolerance of its ten numbers is not one of each alone.
    """
    found: list[Parameter] = []
    for planned in effects:
        for param in planned.effect.params:
            value, std = getattr(planned.p, param.name), planned.std.get(param.name)
            values = [value] if param.size == 1 else value
            errors = [std] * param.size if param.size == 1 or std is None else std
            names = labels(planned, param.name, param.size)
            found += [
                replace(param, name=name, value=float(number), std=error, size=1)
                for name, number, error in zip(names, values, errors, strict=True)
            ]
    if "drives" in free:
        for joint in robot.joints:
            found += _of_drive(robot, joint)
    if "inertial" in free:
        for k, row in enumerate(inertial_of(robot.model)):
            body = robot.model.names[k + 1]
            found += [
                Parameter(f"body.{body}.{key}", unit, value=number, null=None)
                for key, unit, number in zip(INERTIAL_KEYS, INERTIAL_UNITS, row.tolist(), strict=True)
            ]
    return {parameter.name: parameter for parameter in found}


def _of_drive(robot: Robot, joint: Joint) -> list[Parameter]:
    found = []
    for symbol, key in DRIVE_KEYS.items():
        if joint.rigid and symbol in ("K", "D"):
            continue
        value = float(getattr(joint.drive, symbol))
        low = 0.0 if symbol in ("D", "D_m") else SMALLEST
        std = getattr(robot.tolerance, DRIVE_TOLERANCES[symbol]) * value
        unit = DRIVE_UNITS[symbol]
        found.append(
            Parameter(
                f"drive.{joint.name}.{key}",
                unit,
                symbol,
                value=value,
                low=low,
                null=None,
                std=std,
            )
        )
    return found


def numbers(parameters: Mapping[str, Parameter]) -> np.ndarray:
    """(np,) their values."""
    return np.array([parameter.value for parameter in parameters.values()])


def labels(planned: Planned, name: str, size: int) -> list[str]:
    """The names of one parameter of an effect: one, or one for each entry of a vector."""
    label = f"{planned.effect.name}.{planned.joint or 'robot'}.{name}"
    return [label] if size == 1 else [f"{label}[{k}]" for k in range(size)]


def renumbered(
    robot: Robot, effects: Sequence[Planned], changes: Mapping[str, float]
) -> tuple[Robot, tuple[Planned, ...]]:
    """The robot and effects with other numbers, by the names of `model_parameters`.

    Raises ModelError for a number out of its bounds.
    """
    joints, planned = [], []
    for joint in robot.joints:
        if not any(f"drive.{joint.name}.{key}" in changes for key in DRIVE_KEYS.values()):
            joints.append(joint)
            continue
        own = {parameter.symbol: parameter for parameter in _of_drive(robot, joint)}
        new = {
            symbol: parameter.checked(float(changes[parameter.name]))
            for symbol, parameter in own.items()
            if parameter.name in changes
        }
        joints.append(replace(joint, drive=replace(joint.drive, **new)))
    for item in effects:
        values: dict[str, Any] = {}
        for param in item.effect.params:
            old = getattr(item.p, param.name)
            names = labels(item, param.name, param.size)
            if param.size == 1:
                values[param.name] = float(changes.get(names[0], old))
            else:
                values[param.name] = tuple(float(changes.get(n, x)) for n, x in zip(names, old, strict=True))
        Planned.of(item.effect.name, item.joint, {**item.values, **values})  # checks the bounds
        planned.append(item.with_values(values))
    return replace(robot, joints=tuple(joints)), tuple(planned)
