"""Names: the columns of two joints stand for each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from flexjoint.diagnosis.data.change import Change, Source, View
from flexjoint.diagnosis.data.torques.follows import Balance

JOINTS, TORQUES, POSITIONS = "swapped_joints", "swapped_torques", "swapped_positions"


def pairs(balance: Balance, view: View) -> Iterator[Change]:
    """All columns of two joints, their torques, or their positions. Joints that slide are not joints that
    turn."""
    robot = balance.data.robot
    for one, other in combinations(robot.joint_names, 2):
        if (one in robot.prismatic) != (other in robot.prismatic):
            continue
        moved = {one: Source(other), other: Source(one)}
        channels = {channel for channel, joint in balance.rows if joint in (one, other)}
        both = {
            (channel, joint): Source(source.joint) for channel in channels for joint, source in moved.items()
        }
        yield Change(JOINTS, (one, other), moved, both)
        yield Change(POSITIONS, (one, other), moved)
        for channel in sorted(channels):
            own = {key: source for key, source in both.items() if key[0] == channel}
            yield Change(TORQUES, (one, other), torques=own)
