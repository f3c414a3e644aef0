"""Mounting: the robot hangs from a wall or a ceiling, and its file says that it stands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexjoint.diagnosis.data.change import Change, View
from flexjoint.diagnosis.data.torques.follows import Balance

MOUNTING = "gravity"


def directions(balance: Balance, view: View) -> Iterator[Change]:
    """Gravity along each axis of the base, other than the robot file's."""
    nominal = balance.data.robot.gravity
    size = float(np.linalg.norm(nominal))
    if size == 0.0 or view.gravity is not None:
        return
    for axis in range(3):
        for sign in (-1.0, 1.0):
            turned = np.zeros(3)
            turned[axis] = sign * size
            if np.linalg.norm(turned - nominal) > 0.5 * size:
                yield Change(MOUNTING, (), gravity=(float(turned[0]), float(turned[1]), float(turned[2])))
