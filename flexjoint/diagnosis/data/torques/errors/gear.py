"""Gears: the positions of joints are those of their motors before the gear."""

from __future__ import annotations

from collections.abc import Iterator

from flexjoint.diagnosis.data.change import Change, Source, View
from flexjoint.diagnosis.data.torques.follows import Balance

GEAR = "gear"


def ratios(balance: Balance, view: View) -> Iterator[Change]:
    """All joints of which the motor alone was recorded, and each of them, by the robot file's gear ratios."""
    joints = [joint for joint in balance.data.robot.joints if joint.name in balance.data.by_motor]
    reduced = {j.name: Source(j.name, 1.0 / j.gear_ratio) for j in joints if j.gear_ratio not in (None, 1.0)}
    if len(reduced) > 1:
        yield Change(GEAR, tuple(reduced), reduced)
    for name, source in reduced.items():
        yield Change(GEAR, (name,), {name: source})
