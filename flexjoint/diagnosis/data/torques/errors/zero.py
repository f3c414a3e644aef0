"""Zeros: the positions of a joint count from another angle than the description's. Gravity tells."""

from __future__ import annotations

import math
from collections.abc import Iterator

from scipy.optimize import minimize_scalar

from flexjoint.diagnosis.data.change import Change, Source, View
from flexjoint.diagnosis.data.torques.follows import Balance, cost

ZERO = "zero"
EIGHTH = math.pi / 4.0
BEST = 2  # joints whose angle is looked for between the eighths of a turn
TRIALS = 12  # of an angle


def angles(balance: Balance, view: View) -> Iterator[Change]:
    """The best angle of the joints for which one helps most."""
    robot = balance.data.robot
    turning = [name for name in robot.joint_names if name not in robot.prismatic]
    found = []
    for joint in turning:
        tried = [(_cost(balance, view, joint, k * EIGHTH), k * EIGHTH) for k in (-3, -2, -1, 1, 2, 3, 4)]
        found.append((*min(tried), joint))
    for _, angle, joint in sorted(found)[:BEST]:
        change = _refined(balance, view, joint, angle)
        if abs(change.positions[joint].shift) >= balance.settings.least_zero:
            yield change


def _refined(balance: Balance, view: View, joint: str, angle: float) -> Change:
    """The best angle near one, or the whole eighth of a turn where that is as good."""
    best = minimize_scalar(
        lambda x: _cost(balance, view, joint, float(x)),
        bounds=(angle - 0.5 * EIGHTH, angle + 0.5 * EIGHTH),
        method="bounded",
        options={"maxiter": TRIALS, "xatol": 0.002},
    )
    found, least = float(best.x), float(best.fun)
    round_one = round(found / EIGHTH) * EIGHTH
    if abs(found - round_one) < balance.settings.round_zero:
        at_round = _cost(balance, view, joint, round_one)
        if at_round <= balance.settings.round_cost * least:
            found = round_one
    return _change(joint, math.remainder(found, 2.0 * math.pi))


def _cost(balance: Balance, view: View, joint: str, angle: float) -> float:
    return cost(balance.misfits(view.after(_change(joint, angle))))


def _change(joint: str, angle: float) -> Change:
    return Change(ZERO, (joint,), {joint: Source(joint, 1.0, angle)})
