"""Limits of joints over a motion: positions, speeds, torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexjoint.core.errors import unknown
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.sensors import true_signals
from flexjoint.simulation.testing.golden import UNITS
from flexjoint.simulation.trajectory import Trajectory

KINDS: Mapping[str, str] = {"position": "q", "speed": "dq", "torque": "tau_m", "spring torque": "tau_t"}


def assert_limits(
    model: FlexibleJointModel,
    trajectory: Trajectory,
    kinds: Sequence[str] = ("position", "speed", "torque"),
    joints: Sequence[str] | None = None,
) -> None:
    """Fail where a joint leaves its limits.

    Args:
        kinds: position and speed of the links, within the description's limits; torque: commanded, below the
            robot file's torque_limit (reaching it counts as beyond, for control laws saturate there); spring
            torque: the same limit on tau_t. A limit that is infinite, or a speed limit of 0, is none.
        joints: default: all actuated ones.

    Raises:
        AssertionError: which joints, which limits, when first, and by how much at worst.
        UnknownNameError: a kind or joint that does not exist.
    """
    __tracebackhide__ = True
    names = model.robot.joint_names if joints is None else tuple(joints)
    for kind in kinds:
        if kind not in KINDS:
            raise unknown("kind of limit", kind, KINDS)
    rows = slice(trajectory.first, None)
    time, true = trajectory.time[rows], true_signals(model, trajectory)
    broken = []
    for name in names:
        joint = model.robot.joint(name)
        limits = model.robot.model
        speed = float(limits.velocityLimit[joint.idx_v]) or np.inf
        ranges = {
            "position": (limits.lowerPositionLimit[joint.idx_q], limits.upperPositionLimit[joint.idx_q]),
            "speed": (-speed, speed),
            "torque": (-joint.torque_limit, joint.torque_limit),
            "spring torque": (-joint.torque_limit, joint.torque_limit),
        }
        for kind in kinds:
            channel, (low, high) = KINDS[kind], ranges[kind]
            place = model.robot.joint_names.index(name)
            values = trajectory.tau_m[rows, place] if kind == "torque" else true[channel, name][rows]
            outside = (values < low) | (values > high)
            if kind == "torque":
                outside |= np.isfinite(high) & (np.abs(values) >= high)
            if np.any(outside):
                k = int(np.argmax(np.maximum(values - high, low - values)))
                worst = f"{channel} reaches {values[k]:.6g} {UNITS[channel]} at {time[k]:g} s"
                first = f"limits {low:.6g} to {high:.6g}; first at {time[np.argmax(outside)]:g} s"
                broken.append(f"  {kind} of {name}: {worst}, {first}")
    if broken:
        raise AssertionError("\n".join([f"limits are broken in {len(broken)} places:", *broken]))
