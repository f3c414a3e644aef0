"""An error of the data as a sentence, without its end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from flexjoint.diagnosis.data.change import Change
from flexjoint.diagnosis.data.torques.errors import gear, mounting, swapped, turned, unit, zero
from flexjoint.robot.robot import Robot


def said(robot: Robot, change: Change) -> str:
    """What is wrong."""
    return _SAID[change.error](robot, change)


def evidence(joint: str, factor: float, instead: Sequence[str]) -> str:
    """Why it is believed, and what would do as well."""
    times = f"{factor:.0f}" if factor < 1000.0 else "more than 1000"
    others = f" (or {'; or '.join(instead)})" if instead else ""
    return f": the torque balance of {joint} is {times} times smaller with that repaired{others}"


def _columns(change: Change) -> str:
    names = [f"{channel}.{joint}" for channel, joint in change.torques]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _turned_torque(_robot: Robot, change: Change) -> str:
    if len(change.torques) > 1:
        return f"{next(iter(change.torques))[0]} of all {len(change.torques)} joints has the wrong sign"
    return f"{_columns(change)} has the wrong sign"


def _turned_position(_robot: Robot, change: Change) -> str:
    return f"the positions of {change.joints[0]} have the wrong sign"


def _turned_joint(_robot: Robot, change: Change) -> str:
    return (
        f"positions and torques of {change.joints[0]} have the wrong sign: its axis points the other way than"
        " the description's"
    )


def _swapped(what: str) -> Callable[[Robot, Change], str]:
    def sentence(_robot: Robot, change: Change) -> str:
        one, other = change.joints
        return f"{one} and {other} are swapped: each has {what} of the other"

    return sentence


def _zero(_robot: Robot, change: Change) -> str:
    shift = change.positions[change.joints[0]].shift
    return (
        f"the zero of the positions of {change.joints[0]} is off by {math.degrees(-shift):.4g} degrees"
        f" ({-shift:.4g} rad)"
    )


def _unit(robot: Robot, change: Change) -> str:
    (channel, joint), source = next(iter(change.torques.items()))
    turned = " with the wrong sign" if source.scale < 0.0 else ""
    looks = f"looks like {unit.meaning(change.said, robot.joint(joint))}{turned}"
    if len(change.torques) > 1:
        return f"{channel} of {len(change.torques)} joints {looks} at {joint}"
    size = abs(source.scale)
    ratio = f"{size:.4g} times too small" if size > 1.0 else f"{1.0 / size:.4g} times too large"
    return f"{channel}.{joint} is {ratio}: it {looks}"


def _gravity(robot: Robot, change: Change) -> str:
    assert change.gravity is not None
    was, now = (", ".join(f"{x:.4g}" for x in g) for g in (robot.gravity.tolist(), change.gravity))
    return f"the robot is mounted otherwise, with gravity along ({now}) in its base, and not along ({was})"


def _gear(_robot: Robot, change: Change) -> str:
    names = ", ".join(change.joints)
    ratios = ", ".join(f"{1.0 / source.scale:.6g}" for source in change.positions.values())
    return f"the motor's angle of {names} is not divided by the gear ratio of {ratios}"


_SAID: dict[str, Callable[[Robot, Change], str]] = {
    gear.GEAR: _gear,
    turned.TORQUE: _turned_torque,
    turned.POSITION: _turned_position,
    turned.JOINT: _turned_joint,
    swapped.JOINTS: _swapped("the columns"),
    swapped.TORQUES: _swapped("the torques"),
    swapped.POSITIONS: _swapped("the positions"),
    zero.ZERO: _zero,
    unit.UNIT: _unit,
    mounting.MOUNTING: _gravity,
}
