"""What an MJCF must hold so that Pinocchio's parser drops nothing in silence.

It reads bodies, joints, geoms and defaults, and passes over what it does not know: then bodies are missing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np

from flexjoint.core.errors import RobotError
from flexjoint.core.messages import shown
from flexjoint.robot.reading import bodies, xml_file
from flexjoint.robot.reading.urdf_checks import LEAST_AXIS

WHOLE = "save it whole with MuJoCo: mujoco.mj_saveLastXML(path, mujoco.MjModel.from_xml_path(path))"
IN_BODIES = ("body", "joint", "freejoint", "geom", "site", "inertial", "camera", "light", "plugin")
SIZES = {"capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}  # numbers that a geom's size has
LENGTH = 2  # of those whose second number is a length, which fromto gives, too
NUMBERS = {  # attributes that hold numbers, and how many of them; none: any
    "pos": (3,),
    "quat": (4,),
    "axisangle": (4,),
    "euler": (3,),
    "xyaxes": (6,),
    "zaxis": (3,),
    "axis": (3,),
    "mass": (1,),
    "density": (1,),
    "diaginertia": (3,),
    "fullinertia": (6,),
    "armature": (1,),
    "damping": (),
    "frictionloss": (1,),
    "stiffness": (),
    "range": (2,),
    "ref": (1,),
    "fromto": (6,),
    "size": (),
}


def check(root: Element, where: str) -> tuple[dict[str, str], list[str]]:
    """The joints that follow another (equality) with the one that each follows, and warnings.

    Raises RobotError where a number is none, a class is not defined, or the parser would drop bodies.
    """
    for element in root.iter():
        if element.tag in ("include", "replicate", "attach", "composite", "flexcomp", "frame"):
            raise RobotError(
                f"{where}: <{element.tag}> is not read, and its bodies would be missing; {WHOLE}"
            )
    _check_classes(root, where)
    found = [body for world in root.findall("worldbody") for body in world.iter("body")]
    xml_file.check_count({"bodies": len(found)}, where)
    for tree in (*root.findall("worldbody"), *root.findall("default")):
        for element in tree.iter():
            inside = f"{where}: {element.tag} {shown(element.get('name', ''))}".rstrip()
            _check_numbers(element, inside)
            if element.tag == "geom":
                _check_size(element, inside)
    for world in root.findall("worldbody"):
        for place in (world, *world.iter("body")):
            strange = next((inner.tag for inner in place if inner.tag not in IN_BODIES), None)
            if strange is not None:
                raise RobotError(
                    f"{where}: <{shown(strange)}> within a body is not read; delete it, or {WHOLE}"
                )
    _check_names(found, where)
    return _followers(root, where), _warnings(found, where)


def _warnings(found: Sequence[Element], where: str) -> list[str]:
    """What of the bodies a user should know."""
    names = [shown(body.get("name", "a body")) for body in found]
    odd = [name for name, body in zip(names, found, strict=True) if _unlike(body, where)]
    guessed = [name for name, body in zip(names, found, strict=True) if _of_a_mesh(body)]
    warnings = [bodies.warning_of(odd, where)] if odd else []
    if guessed:
        more = f" and {len(guessed) - 1} more" if len(guessed) > 1 else ""
        warnings.append(
            f"{where}: body {guessed[0]}{more} has its mass from a mesh, which is not read: it is 1 kg; write"
            " its <inertial>"
        )
    return warnings


def _check_names(found: Sequence[Element], where: str) -> None:
    joints = [joint for body in found for joint in body.findall("joint")]
    for kind, elements in (("body", found), ("joint", joints)):
        names = Counter(e.attrib["name"] for e in elements if "name" in e.attrib)
        for name, count in names.items():
            if count > 1:
                raise RobotError(f"{where}: {kind} '{shown(name)}' stands twice; rename one")
            if not name.isprintable():
                raise RobotError(
                    f"{where}: {kind} '{shown(name)}' has control characters in its name; rename it"
                )


def _check_classes(root: Element, where: str) -> None:
    defined = {default.get("class", "") for default in root.iter("default")}
    for element in root.iter():
        for key in ("class", "childclass"):
            name = element.get(key)
            if name is not None and name not in defined and element.tag != "default":
                how = "name the first one main" if name == "main" else "define it"
                raise RobotError(
                    f"{where}: <{shown(element.tag)}> has {key} '{shown(name)}', which no <default> defines;"
                    f" {how}, or leave it out"
                )


def _check_numbers(element: Element, where: str) -> None:
    for attribute, counts in NUMBERS.items():
        text = element.get(attribute)
        if text is not None:
            values = xml_file.numbers(text, counts, f"{where}: {attribute}")
            if attribute in ("mass", "density", "armature") and values[0] < 0.0:
                raise RobotError(f"{where}: {attribute} {values[0]:g} is negative; give what the body has")
            direction = attribute in ("axis", "quat", "zaxis")
            if direction and float(np.linalg.norm(values)) < LEAST_AXIS:
                raise RobotError(f"{where}: its {attribute} is zero; give a direction, such as 0 0 1")


def _check_size(geom: Element, where: str) -> None:
    """A geom's size, where it says itself what it is."""
    size = geom.get("size")
    if size is None:
        return
    given = xml_file.numbers(size, (), f"{where}: size")
    needed = SIZES.get(geom.get("type", ""), 1)
    if needed == LENGTH and "fromto" in geom.attrib:
        needed = 1
    if len(given) < needed or min(given) < 0.0:
        raise RobotError(f"{where}: size '{shown(size)}': expected {needed} numbers, none below 0")


def _of_a_mesh(body: Element) -> bool:
    """Whether a body's mass is to be that of a mesh."""
    if body.find("inertial") is not None:
        return False
    meshes = [geom for geom in body.findall("geom") if "mesh" in geom.attrib]
    return any("mass" not in geom.attrib and float(geom.get("density", "1")) > 0.0 for geom in meshes)


def _unlike(body: Element, where: str) -> bool:
    """Whether no body has the inertia that is written."""
    inertial = body.find("inertial")
    if inertial is None:
        return False
    inside = f"{where}: body {shown(body.get('name', ''))}"
    diagonal, full = inertial.get("diaginertia"), inertial.get("fullinertia")
    matrix = np.zeros((3, 3))
    if diagonal is not None:
        matrix = np.diag([float(word) for word in diagonal.split()])
    elif full is not None:
        xx, yy, zz, xy, xz, yz = (float(word) for word in full.split())
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if inertial.get("mass") is None:
        raise RobotError(f"{inside}: its inertial has no mass; give it [kg]")
    return bodies.unlike_a_body(float(inertial.attrib["mass"]), matrix, inside)


def _followers(root: Element, where: str) -> dict[str, str]:
    """Joints that an equality ties to another. Raises RobotError for one that closes a loop of bodies."""
    follows = {}
    for equality in root.findall("equality"):
        for tie in equality:
            if tie.get("active", "true") == "false":
                continue
            if tie.tag != "joint":
                raise RobotError(
                    f"{where}: equality <{shown(tie.tag)}> ties bodies, which is not modelled; delete it to"
                    " simulate the open tree"
                )
            follows[tie.get("joint1", "")] = tie.get("joint2", "a constant")
    return follows
