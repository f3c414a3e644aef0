"""Torque limits of an MJCF's joints: of actuators, which Pinocchio passes over, and of the joints themselves.

MuJoCo, XML reference, actuator/general (forcerange, ctrlrange, gear), joint (actuatorfrcrange) and default:
what an element does not say, its class does. A limit is on unless it is said to be off.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

from flexjoint.core.messages import shown
from flexjoint.robot.reading import xml_file

ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle")
ACTUATOR = "actuator"  # the one default that all kinds of actuators share
Said = Mapping[str, str]  # attributes of an element


def torque_limits(root: Element, where: str) -> dict[str, float]:
    """Largest torque or force of each joint that the file limits [N m, N], either way.

    Raises RobotError where a number is none."""
    classes = dict(_classes(root))
    out: dict[str, float] = {}

    def limit(joint: str, most: float) -> None:
        if most > 0.0:
            out[joint] = min(most, out.get(joint, math.inf))

    for world in root.findall("worldbody"):
        for element, inherited in _joints(world, "main"):
            said = _with_class(element, "joint", inherited, classes)
            limit(element.get("name", ""), _most(said, "actuatorfrc", f"{where}: joint"))
    for element in root.findall("actuator/*"):
        joint = element.get("joint")
        if joint is None or element.tag not in ACTUATORS:
            continue
        said = _with_class(element, ACTUATOR, "main", classes)
        place = f"{where}: {element.tag} {shown(element.get('name', ''))}"
        gear = abs(xml_file.numbers(said.get("gear", "1"), range(1, 7), f"{place}: gear")[0])
        limit(joint, gear * _most(said, "force", place))
        if element.tag == "motor":  # whose control is its force
            limit(joint, gear * _most(said, "ctrl", place))
    return out


def _most(said: Said, what: str, place: str) -> float:
    """The larger end of a range; 0 where there is none, or it is off."""
    text = said.get(f"{what}range")
    if text is None or said.get(f"{what}limited") == "false":
        return 0.0
    return max(map(abs, xml_file.numbers(text, (2,), f"{place}: {what}range")))


def _joints(body: Element, inherited: str) -> Iterator[tuple[Element, str]]:
    """The joints below a body, each with the class that it has where it names none."""
    inherited = body.get("childclass", inherited)
    for child in body:
        if child.tag == "joint":
            yield child, inherited
        elif child.tag == "body":
            yield from _joints(child, inherited)


def _with_class(
    element: Element, kind: str, inherited: str, classes: Mapping[str, Mapping[str, Said]]
) -> Said:
    chosen = classes.get(element.get("class", inherited), {})
    return {**chosen.get(kind, {}), **element.attrib}


def _classes(root: Element) -> Iterator[tuple[str, dict[str, Said]]]:
    """What each class says of joints and of actuators, what it inherits included."""
    waiting: list[tuple[Element, dict[str, Said]]] = [(top, {}) for top in root.findall("default")]
    while waiting:
        default, above = waiting.pop()
        said = dict(above)
        for child in default:
            kind = ACTUATOR if child.tag in ACTUATORS else child.tag
            if kind in (ACTUATOR, "joint"):
                said[kind] = {**said.get(kind, {}), **child.attrib}
        yield default.get("class", "main"), said
        waiting += [(below, said) for below in default.findall("default")]
