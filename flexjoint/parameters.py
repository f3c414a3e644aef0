"""The numbers of a model by name: effect.joint.name, drive.joint.stiffness, body.joint.mx.

The symbolic model, compiled runs and batches name their parameters in this order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from flexjoint.body import inertial_of
from flexjoint.effect import Planned, plan
from flexjoint.errors import ModelError
from flexjoint.robot import Joint, Robot

FREE = ("drives", "inertial")
DRIVE_KEYS = {"K": "stiffness", "D": "damping", "B": "motor_inertia", "D_m": "motor_damping"}
INERTIAL_KEYS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def parameter_table(
    joints: Iterable[Joint], effects: Iterable[Planned], model: pin.Model, free: Collection[str] = ()
) -> dict[str, float]:
    """Names and numbers of the free parameters, in the order of `SymbolicModel.parameters`: those of the
    effects, then with "drives" those of the drives, then with "inertial" those of the bodies."""
    table: dict[str, float] = {}
    for planned in effects:
        for param in planned.effect.params:
            value = getattr(planned.p, param.name)
            names = labels(planned, param.name, param.size)
            table.update(zip(names, [value] if param.size == 1 else value, strict=True))
    if "drives" in free:
        for joint in joints:
            for symbol, key in DRIVE_KEYS.items():
                if not (joint.rigid and symbol in ("K", "D")):
                    table[f"drive.{joint.name}.{key}"] = getattr(joint.drive, symbol)
    if "inertial" in free:
        for k, row in enumerate(inertial_of(model)):
            names = [f"body.{model.names[k + 1]}.{key}" for key in INERTIAL_KEYS]
            table.update(zip(names, row.tolist(), strict=True))
    return {name: float(value) for name, value in table.items()}


def labels(planned: Planned, name: str, size: int) -> list[str]:
    """The names of one parameter of an effect: one, or one for each entry of a vector."""
    label = f"{planned.effect.name}.{planned.joint or 'robot'}.{name}"
    return [label] if size == 1 else [f"{label}[{k}]" for k in range(size)]


def renumbered(
    robot: Robot, effects: Sequence[Planned], changes: Mapping[str, float]
) -> tuple[Robot, tuple[Planned, ...]]:
    """The robot and effects with other numbers, by the names of `parameter_names`.

    Raises ModelError for a number out of its bounds.
    """
    joints, planned = [], []
    for joint in robot.joints:
        new = {
            symbol: float(changes[name])
            for symbol, key in DRIVE_KEYS.items()
            if (name := f"drive.{joint.name}.{key}") in changes
        }
        for symbol, value in new.items():
            lowest = 0.0 if symbol in ("D", "D_m") else np.finfo(float).tiny
            if not lowest <= value < np.inf:
                raise ModelError(f"drive.{joint.name}.{DRIVE_KEYS[symbol]}: expected > 0, got {value!r}")
        joints.append(replace(joint, drive=replace(joint.drive, **new)) if new else joint)
    for item in effects:
        values: dict[str, Any] = {}
        for param in item.effect.params:
            old = getattr(item.p, param.name)
            names = labels(item, param.name, param.size)
            if param.size == 1:
                values[param.name] = float(changes.get(names[0], old))
            else:
                values[param.name] = tuple(float(changes.get(n, x)) for n, x in zip(names, old, strict=True))
        plan(item.effect.name, item.joint, {**item.values, **values})  # checks the bounds
        planned.append(item.with_values(values))
    return replace(robot, joints=tuple(joints)), tuple(planned)
