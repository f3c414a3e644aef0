"""Signs: a torque, the positions of a joint, or both count the other way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flexjoint.diagnosis.data.change import Change, Source, View
from flexjoint.diagnosis.data.torques.follows import Balance

TORQUE, POSITION, JOINT = "turned_torque", "turned_position", "turned_joint"


def torques(balance: Balance, view: View) -> Iterator[Change]:
    """Each torque by itself."""
    for channel, joint in balance.rows:
        yield Change(TORQUE, (joint,), torques={(channel, joint): Source(joint, -1.0)})


def positions(balance: Balance, view: View) -> Iterator[Change]:
    """The positions of each joint, without its torques and with them: an axis that points the other way."""
    for joint in balance.data.robot.joint_names:
        turned = {joint: Source(joint, -1.0)}
        own = {key: Source(joint, -1.0) for key in balance.rows if key[1] == joint}
        yield Change(POSITION, (joint,), turned)
        if own:
            yield Change(JOINT, (joint,), turned, own)


def together(balance: Balance, changes: Sequence[Change]) -> list[Change]:
    """The changes, with all torques of a channel turned as one."""
    out = list(changes)
    for channel in dict.fromkeys(channel for channel, _ in balance.rows):
        rows = {key for key in balance.rows if key[0] == channel}
        own = [c for c in changes if c.error == TORQUE and set(c.torques) <= rows]
        torques = {key: source for change in own for key, source in change.torques.items()}
        if len(own) > 1 and set(torques) == rows:
            out = [c for c in out if not any(c is other for other in own)]
            out.append(Change(TORQUE, tuple(joint for _, joint in torques), torques=torques))
    return out
