"""Numbers of joints as they are handed in, to the keys of a robot file (docs/reference/formats.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError, unknown

Numbers = float | Mapping[str, float] | Sequence[float] | np.ndarray  # of all joints, by name, or in order


def floats(model: pin.Model) -> bool:
    """Whether its first joint is a free one."""
    return model.njoints > 1 and str(model.joints[1].shortname()) == "JointModelFreeFlyer"


def as_file(
    name: str,
    model: pin.Model,
    joints: Sequence[str] | None,
    drives: Mapping[str, Numbers | None],
    rates: Mapping[str, float] | None,
    tolerance: Mapping[str, float] | None,
) -> dict[str, Any]:
    """A robot file's keys, from numbers that were handed in."""
    own = [str(joint) for joint in model.names][2 if floats(model) else 1 :]
    if joints is None:
        for joint in own:
            single_axis(model, joint, name, "; name the actuated ones with joints=[...]")
        joints = own
    for joint in joints:
        if joint not in own:
            raise RobotError(f"{name}: joints: {unknown('joint', joint, own)}")
    if not joints:
        raise RobotError(f"{name}: expected at least one joint to actuate, got none")
    entries: dict[str, dict[str, float]] = {
        joint: {"stiffness": math.inf, "motor_inertia": 0.0} for joint in joints
    }
    for key, given in drives.items():
        for joint, value in _by_joint(key, given, list(joints), name).items():
            entries[joint][key] = value
    raw: dict[str, Any] = {"name": name, "joints": entries}
    if rates is not None:
        raw["rates"] = dict(rates)
    if tolerance is not None:
        raw["tolerance"] = dict(tolerance)
    return raw


def _by_joint(key: str, given: Numbers | None, joints: Sequence[str], where: str) -> dict[str, float]:
    """A number for each joint that has one."""
    if given is None:
        return {}
    if isinstance(given, Mapping):
        for joint in given:
            if joint not in joints:
                raise RobotError(f"{where}: {key}: {unknown('joint', joint, joints)}")
        return {joint: float(value) for joint, value in given.items()}
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise RobotError(f"{where}: {key}: expected numbers, got {given!r}") from None
    if values.ndim == 0:
        return dict.fromkeys(joints, float(values))
    if values.shape != (len(joints),):
        raise RobotError(f"{where}: {key}: expected {len(joints)} numbers, one a joint, got {values.shape}")
    return dict(zip(joints, values.tolist(), strict=True))


def single_axis(model: pin.Model, name: str, where: str, advice: str = "") -> Any:
    """The joint of that name, which can be actuated."""
    joint = model.joints[model.getJointId(name)]
    if joint.nv == 1 and joint.nq == 2:
        raise RobotError(
            f"{where}: joint {name!r} is continuous, and a recording holds unwrapped angles; load the URDF"
            " with load_robot, which unwraps it, or model it as revolute"
        )
    if joint.nq != 1 or joint.nv != 1:
        raise RobotError(
            f"{where}: joint {name!r} has {joint.nv} degrees of freedom; only single-axis joints can"
            f" be actuated{advice}"
        )
    return joint
