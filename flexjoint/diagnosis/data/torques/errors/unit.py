"""Units: a torque in amperes, in mN m, or of the motor side of the gear."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from flexjoint.diagnosis.data.change import Change, Key, Source, View
from flexjoint.diagnosis.data.torques.follows import Balance
from flexjoint.robot.robot import Joint

UNIT = "unit"
FREE = (0.0, 1e9)  # limits of a gain that may be anything
AMPERES, OF_CURRENT, OF_MOTOR, TWICE = "amperes", "motor amperes", "motor side", "twice geared"
MILLI, KILO, OTHER = "mN m", "kN m", "another unit"


def factors(balance: Balance, view: View) -> Iterator[Change]:
    """Of each torque the factor that makes it the one that the motion takes, where that is far from 1; with
    the other sign, too."""
    limits = balance.settings
    for key in balance.rows:
        row = balance.row(key, view)
        if row is None:
            continue
        for sign in (1.0, -1.0):
            left, gain = balance.fitted(replace(row, recorded=sign * row.recorded), FREE)
            if gain <= 0.0 or left > limits.right**2 or max(gain, 1.0 / gain) < limits.least_scale:
                continue
            unit, factor = _nearest(balance, key, 1.0 / gain)
            # a load or an inertia makes a torque larger, and nothing but a unit makes it so much smaller
            least = limits.least_scale if gain < 1.0 else limits.unknown_scale
            if unit != OTHER or max(gain, 1.0 / gain) >= least:
                yield Change(UNIT, (key[1],), torques={key: Source(key[1], sign * factor)}, said=unit)


def factor_of(unit: str, joint: Joint) -> float | None:
    """What makes a torque of a unit one in N m at the link; None where the robot file does not say."""
    gear, constant = joint.gear_ratio, joint.torque_constant
    known = {
        AMPERES: gear * constant if gear and constant else None,
        OF_CURRENT: constant,
        OF_MOTOR: gear,
        TWICE: 1.0 / gear if gear else None,
        MILLI: 1e-3,
        KILO: 1e3,
    }
    return known.get(unit)


def meaning(unit: str, joint: Joint) -> str:
    """What a torque of a unit looks like."""
    gear, constant = joint.gear_ratio or 0.0, joint.torque_constant or 0.0
    return {
        AMPERES: f"amperes (torque_constant times gear_ratio is {gear * constant:.4g} N m/A)",
        OF_CURRENT: f"amperes (torque_constant is {constant:.4g} N m/A)",
        OF_MOTOR: f"the torque of the motor, before the gear of {gear:.4g}",
        TWICE: f"a torque that was multiplied by the gear ratio of {gear:.4g} twice",
        MILLI: "mN m",
        KILO: "kN m",
        OTHER: "another unit, as amperes or the torque of the motor before the gear (gear_ratio and"
        " torque_constant in the robot file would tell)",
    }[unit]


def together(balance: Balance, changes: Sequence[Change]) -> list[Change]:
    """The changes, with torques of one channel in the same unit as one, which holds for those that cannot
    tell, too."""
    out: list[Change] = []
    units: dict[tuple[str, str], list[Change]] = {}
    for change in changes:
        if change.error == UNIT:
            units.setdefault((_channel(change), change.said), []).append(change)
        else:
            out.append(change)
    for (channel, unit), alike in units.items():
        rivals = [other for other in units if other[0] == channel and other[1] != unit]
        if len(alike) < balance.settings.unit_joints or unit == OTHER or rivals:
            out += alike
            continue
        torques = {key: source for change in alike for key, source in change.torques.items()}
        for key in balance.rows:
            factor = factor_of(unit, balance.data.robot.joint(key[1]))
            if key[0] == channel and key not in torques and factor is not None:
                torques[key] = Source(key[1], factor)
        out.append(Change(UNIT, tuple(joint for _, joint in torques), torques=torques, said=unit))
    return out


def _channel(change: Change) -> str:
    return next(iter(change.torques))[0]


def _nearest(balance: Balance, key: Key, scale: float) -> tuple[str, float]:
    """The unit whose factor is near one, and that factor; the factor itself, of two digits, where none is."""
    joint = balance.data.robot.joint(key[1])
    known = {unit: factor_of(unit, joint) for unit in (AMPERES, OF_CURRENT, OF_MOTOR, TWICE, MILLI, KILO)}
    there = {unit: factor for unit, factor in known.items() if factor is not None}
    unit = min(there, key=lambda name: abs(math.log(there[name] / scale)))
    if abs(math.log(there[unit] / scale)) <= math.log(balance.settings.known_scale):
        return unit, there[unit]
    return OTHER, float(f"{scale:.2g}")
