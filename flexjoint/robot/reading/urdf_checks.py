"""What a URDF must hold so that the parser drops nothing in silence: numbers, names, one tree of links."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from flexjoint.core.errors import RobotError
from flexjoint.core.limits import DESCRIPTION
from flexjoint.core.messages import shown
from flexjoint.robot.reading import bodies, xml_file

MOVING = ("revolute", "continuous", "prismatic", "planar")  # joints with an axis
TYPES = (*MOVING, "fixed", "floating")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
NUMBERS: Mapping[str, Mapping[str, tuple[int, ...]]] = {  # attributes that hold numbers, and how many of them
    "mass": {"value": (1,)},
    "inertia": dict.fromkeys(MOMENTS, (1,)),
    "origin": {"xyz": (3,), "rpy": (3,)},
    "axis": {"xyz": (3,)},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), (1,)),
    "dynamics": dict.fromkeys(("damping", "friction"), (1,)),
    "box": {"size": (3,)},
    "cylinder": dict.fromkeys(("radius", "length"), (1,)),
    "sphere": {"radius": (1,)},
    "mesh": {"scale": (1, 3)},
}
ENDLESS = ("limit",)  # elements whose numbers may be infinite
LEAST_AXIS = 1e-6  # length of an axis below which it has no direction


def check(root: Element, where: str) -> tuple[dict[str, str], list[str]]:
    """The joints that follow another (`mimic`) with the one that each follows, and warnings.

    Raises RobotError where a number is none, a name is missing or stands twice, or the links are no tree.
    """
    foreign = next((e.tag for e in root.iter() if "xacro" in e.tag), None)
    if foreign is not None:
        raise RobotError(
            f"{where}: holds <{shown(foreign.rpartition('}')[2])}> of xacro; run xacro on it first"
        )
    links = [xml_file.name_of(link, "link", where) for link in root.findall("link")]
    joints = root.findall("joint")
    names = [xml_file.name_of(joint, "joint", where) for joint in joints]
    xml_file.check_count({"links": len(links), "joints": len(joints)}, where)
    for kind, given in (("link", links), ("joint", names)):
        twice = [name for name, count in Counter(given).items() if count > 1]
        if twice:
            raise RobotError(f"{where}: {kind} '{shown(twice[0])}' stands twice; rename one")
    odd = []
    for link, name in zip(root.findall("link"), links, strict=True):
        inside = f"{where}: link {shown(name)}"
        _check_numbers(link, inside)
        inertial = link.find("inertial")
        if inertial is not None and bodies.unlike_a_body(*_inertial(inertial, inside), inside):
            odd.append(shown(name))
    follows = {}
    for joint, name in zip(joints, names, strict=True):
        inside = f"{where}: joint {shown(name)}"
        _check_numbers(joint, inside)
        kind = joint.get("type", "")
        if kind not in TYPES:
            raise RobotError(f"{inside}: type '{shown(kind)}', expected one of {', '.join(TYPES)}")
        axis = joint.find("axis")
        if kind in MOVING and axis is not None:
            along = xml_file.numbers(axis.get("xyz", ""), (3,), f"{inside}: axis")
            if float(np.linalg.norm(along)) < LEAST_AXIS:
                raise RobotError(f"{inside}: its axis is zero; give a direction, such as 0 0 1")
        mimic = joint.find("mimic")
        if mimic is not None and kind in MOVING:
            follows[name] = mimic.get("joint", "")
    _check_tree(links, joints, names, where)
    return follows, [bodies.warning_of(odd, where)] if odd else []


def _check_numbers(element: Element, where: str) -> None:
    for inner in element.iter():
        for attribute, counts in NUMBERS.get(inner.tag, {}).items():
            text = inner.get(attribute)
            if text is not None:
                place = f"{where}: {inner.tag} {attribute}"
                xml_file.numbers(text, counts, place, endless=inner.tag in ENDLESS)


def _inertial(inertial: Element, where: str) -> tuple[float, np.ndarray]:
    """Mass [kg] and inertia (3, 3) [kg m^2]; both must be there, or the parser takes the link as massless."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or mass.get("value") is None:
        raise RobotError(f'{where}: its inertial has no mass; write <mass value="..."/>, or leave it out')
    lacking = [m for m in MOMENTS if inertia is None or inertia.get(m) is None]
    if inertia is None or lacking:
        raise RobotError(
            f"{where}: its inertia lacks {', '.join(lacking)}; give all six, or leave inertial out"
        )
    xx, xy, xz, yy, yz, zz = (float(inertia.attrib[m]) for m in MOMENTS)
    return float(mass.attrib["value"]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _check_tree(links: Sequence[str], joints: Sequence[Element], names: Sequence[str], where: str) -> None:
    """Every link hangs on one joint but the root, to which all joints lead."""
    known, carried = set(links), dict[str, str]()
    children: dict[str, list[str]] = {name: [] for name in links}
    for joint, name in zip(joints, names, strict=True):
        ends = []
        for end in ("parent", "child"):
            found = joint.find(end)
            link = None if found is None else found.get("link")
            if link is None or link not in known:
                said = "no link" if link is None else f"link '{shown(link)}', which there is not"
                raise RobotError(f"{where}: joint {shown(name)} has {said} as its {end}")
            ends.append(link)
        parent, child = ends
        if child in carried:
            raise RobotError(
                f"{where}: link {shown(child)} hangs on joints {shown(carried[child])} and {shown(name)}:"
                " loops are not modelled; keep one of the joints"
            )
        carried[child] = name
        children[parent].append(child)
    roots = [link for link in links if link not in carried]
    if not roots and links:
        raise RobotError(f"{where}: every link hangs on another: the joints form a loop; open it")
    if len(roots) > 1:
        raise RobotError(
            f"{where}: links {shown(roots[0])} and {shown(roots[1])} hang on no joint; a robot has one root"
        )
    reached, level, depth = set(roots), roots, 0
    while level:
        level = [child for link in level for child in children[link]]
        reached.update(level)
        depth += bool(level)
        if depth > DESCRIPTION.chain:
            raise RobotError(
                f"{where}: more than {DESCRIPTION.chain} joints in a row (docs/reference/limits.md)"
            )
    if len(reached) < len(links):
        lost = next(link for link in links if link not in reached)
        raise RobotError(
            f"{where}: link {shown(lost)} does not hang on the root: the joints form a loop; open it"
        )
