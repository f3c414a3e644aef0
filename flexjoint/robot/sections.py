"""Sections of a robot that can be left out, with their mass, and presets of its numbers.

A section is one or more sub-trees of the URDF, each cut at its first joint. A section that hangs on another
one is left out together with it (Kameduła et al. 2016, section 4.1.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from flexjoint.core.errors import RobotError, unknown
from flexjoint.robot.schema import RobotFile


@dataclass(frozen=True)
class Choice:
    """What is left of a robot: the URDF's text, the sections (or parts of them) that are there, those asked
    for that are not because what they hang on is not, and whether the base floats."""

    urdf: str
    spawned: tuple[str, ...]
    disabled: tuple[str, ...]
    floating: bool


def choose(file: RobotFile, urdf: str, asked: Sequence[str] | None, where: str) -> Choice:
    """Cut what is not asked for (None: nothing is cut) from a URDF.

    Raises RobotError where the file's sections do not fit the URDF, UnknownNameError for a section that the
    file does not have.
    """
    floating = file.base == "floating"
    if asked is not None and not file.sections:
        raise RobotError(f"{where}: sections {', '.join(asked)} were asked for, but the robot defines none")
    if not file.sections:
        return Choice(urdf, (), (), floating)
    if not urdf:
        raise RobotError(f"{where}: sections need a URDF or SDF, the robot has a {file.description[0]}")
    tree = _Tree(ElementTree.fromstring(urdf))
    units = _units(file)
    for unit, roots in units.items():
        for root in roots:
            if root not in tree.child:
                raise RobotError(f"{where}: section {unit}: {unknown('joint', root, tree.child)}")
    wanted = _wanted(file, asked, where)
    owner = {root: unit for unit, roots in units.items() for root in roots}
    kept = [r for r, unit in owner.items() if unit in wanted and _carried(tree, r, owner, wanted)]
    tree.cut([root for root in owner if root not in kept])
    spawned = [unit for unit, roots in units.items() if not roots or any(root in kept for root in roots)]
    disabled = [unit for unit in units if unit in wanted and unit not in spawned]
    legs = [root for section in file.sections.values() if section.supports for root in section.all_roots]
    floating = floating and (not legs or any(root in kept for root in legs))
    text = ElementTree.tostring(tree.robot, encoding="unicode")
    return Choice(text, _whole(file, spawned), _whole(file, disabled), floating)


def with_preset(raw: Mapping[str, Any], name: str, where: str) -> dict[str, Any]:
    """A copy of a robot file's mapping with the joint numbers and rates of a preset put in."""
    presets = raw.get("presets") or {}
    if name not in presets:
        raise RobotError(f"{where}: {unknown('preset', name, presets)}")
    chosen, out = presets[name] or {}, dict(raw)
    joints = {joint: dict(entry) for joint, entry in raw["joints"].items()}
    for joint, values in (chosen.get("joints") or {}).items():
        if joint not in joints:
            raise RobotError(f"{where}: preset {name}: {unknown('joint', joint, joints)}")
        joints[joint].update(values)
    out["joints"] = joints
    if chosen.get("rates"):
        out["rates"] = {**(raw.get("rates") or {}), **chosen["rates"]}
    return out


# --- names ------------------------------------------------------------------------------------------------
def _units(file: RobotFile) -> dict[str, tuple[str, ...]]:
    """Roots by the smallest thing that can be asked for: a part of a section, or a section without parts."""
    units: dict[str, tuple[str, ...]] = {}
    for name, section in file.sections.items():
        if section.parts:
            units.update({part: tuple(roots) for part, roots in section.parts.items()})
        else:
            units[name] = tuple(section.roots)
    return units


def _wanted(file: RobotFile, asked: Sequence[str] | None, where: str) -> set[str]:
    units = _units(file)
    if asked is None:
        return set(units)
    wanted = {name for name, roots in units.items() if not roots}  # the anchor is always there
    for name in asked:
        if name in file.sections:
            wanted.update(file.sections[name].parts or [name])
        elif name in units:
            wanted.add(name)
        else:
            raise RobotError(f"{where}: {unknown('section', name, {*file.sections, *units})}")
    return wanted


def _whole(file: RobotFile, units: Sequence[str]) -> tuple[str, ...]:
    """Names of sections where all of their parts are there, else of the parts."""
    out: list[str] = []
    for name, section in file.sections.items():
        parts = [part for part in section.parts or [name] if part in units]
        out += [name] if len(parts) == len(section.parts or [name]) else parts
    return tuple(out)


# --- the tree ---------------------------------------------------------------------------------------------
class _Tree:
    """A URDF's joints as a tree; cutting takes links and joints out of it."""

    def __init__(self, robot: ElementTree.Element) -> None:
        self.robot = robot
        self.child: dict[str, str] = {}
        self.parent: dict[str, str] = {}
        self.above: dict[str, str] = {}  # link: the joint that carries it
        for joint in robot.findall("joint"):
            parent, child = joint.find("parent"), joint.find("child")
            if parent is None or child is None:
                continue
            name = str(joint.get("name"))
            self.parent[name], self.child[name] = str(parent.get("link")), str(child.get("link"))
            self.above[self.child[name]] = name

    def ancestors(self, joint: str) -> list[str]:
        found: list[str] = []
        above = self.above.get(self.parent[joint])
        while above is not None and above not in found:
            found.append(above)
            above = self.above.get(self.parent[above])
        return found

    def cut(self, roots: Sequence[str]) -> None:
        gone = {joint for joint in self.child if joint in roots or set(self.ancestors(joint)) & set(roots)}
        links = {self.child[joint] for joint in gone}
        for element in list(self.robot):
            name = element.get("name")
            if (element.tag == "joint" and name in gone) or (element.tag == "link" and name in links):
                self.robot.remove(element)


def _carried(tree: _Tree, root: str, owner: Mapping[str, str], wanted: set[str]) -> bool:
    """Whether everything that a section hangs on is wanted."""
    return all(owner[joint] in wanted for joint in tree.ancestors(root) if joint in owner)
