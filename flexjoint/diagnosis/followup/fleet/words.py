"""Causes in the words of a workshop: lost motion in arcmin, friction in per cent of rated torque; which sort
of thing it is, how heavy, and what to do next."""

from __future__ import annotations

import math
from typing import Literal

from flexjoint.diagnosis.result.wording import effect_name, number
from flexjoint.effects import Kind, Site, catalogue
from flexjoint.robot.robot import Joint, Robot

Sort = Literal["wear", "setting", "sensor"]
UNLIMITED = 1e9  # N m: a joint without a stated limit has no rated torque
NAMES = {
    "backlash": "lost motion",
    "motor_coulomb_friction": "friction",
    "link_coulomb_friction": "friction behind the gear",
    "motor_viscous_friction": "friction that grows with speed",
    "link_viscous_friction": "friction behind the gear that grows with speed",
    "spring_stiffness": "stiffness",
    "joint_compliance": "a joint that bends",
    "payload": "payload that is not stated",
    "base_tilt": "tilt of the base",
}
NEXT: dict[Sort, str] = {
    "wear": "plan maintenance; after it, enter the repair in the roster and record again",
    "setting": "compare payload, tool and mounting with what the controller is told",
    "sensor": "check zero, mounting and cable of the sensor, and its time stamps",
}


def sort_of(effect: str) -> Sort:
    """Settings act on the body; sensors on readings and their time; what else, a soft joint too, is wear."""
    law = catalogue()[effect]
    if law.site is Site.BODY and not law.for_rigid:
        return "setting"
    return "sensor" if law.kind in (Kind.SENSOR, Kind.TIMING) else "wear"


def name_of(effect: str) -> str:
    return NAMES.get(effect, effect_name(effect))


def main_parameter(effect: str) -> str:
    """The number that says how large an effect is."""
    law = catalogue()[effect]
    sizes = law.nulls or law.params
    return sizes[0].name if sizes[0].size == 1 else f"{sizes[0].name}[0]"


def amount(effect: str, parameter: str, value: float, robot: Robot, joint: str | None) -> str:
    """A number in the words of a workshop."""
    unit = unit_of(effect, parameter)
    own = robot.joint(joint) if joint is not None else None
    slides = joint in robot.prismatic
    if unit == "rad":
        return f"{number(1e3 * value)} mm" if slides else f"{number(math.degrees(value) * 60.0)} arcmin"
    if unit.startswith("N m") and own is not None and own.torque_limit < UNLIMITED:
        per = unit.removeprefix("N m").strip()
        share = f"{number(100.0 * value / own.torque_limit)} % of rated {'force' if slides else 'torque'}"
        return share + (f" per {_inverse(per)}" if per else "")
    if unit == "1":
        return f"{'+' if value >= 0 else ''}{number(100.0 * value)} %"
    factor, shown = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(unit, (1.0, unit))
    return f"{number(factor * value)} {shown}".rstrip()


def heaviness(effect: str, parameter: str, change: float, robot: Robot, joint: str | None) -> float:
    """How much of the joint's rated torque a change takes or hides, roughly: what comes first on the page."""
    unit = unit_of(effect, parameter)
    own = robot.joint(joint) if joint is not None else None
    rated = _rated(own)
    if unit == "rad" and own is not None and not own.rigid:
        return abs(change) * own.drive.K / rated
    if unit.startswith("N"):
        return abs(change) / rated
    return abs(change) if unit == "1" else 0.1


def _rated(joint: Joint | None) -> float:
    return joint.torque_limit if joint is not None and joint.torque_limit < UNLIMITED else 100.0


def unit_of(effect: str, parameter: str) -> str:
    """The unit of a number as the table has it."""
    name = parameter.partition("[")[0]
    return next((p.unit for p in catalogue()[effect].params if p.name == name), "")


def _inverse(unit: str) -> str:
    """s/rad -> rad/s."""
    top, _, bottom = unit.partition("/")
    return f"{bottom}/{top}" if bottom else unit
