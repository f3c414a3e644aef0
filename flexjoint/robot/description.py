"""What a robot file points at: a URDF, an MJCF, or an SDF that is read as a URDF -> pin.Model."""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TypeVar
from xml.etree import ElementTree

import pinocchio as pin

from flexjoint.core.errors import MissingExtraError, RobotError, unknown
from flexjoint.core.messages import one_line
from flexjoint.core.running import native_output
from flexjoint.robot import ready_made
from flexjoint.robot.numbers import floats
from flexjoint.robot.reading import mjcf_checks, sdf, urdf_checks, xml_file
from flexjoint.robot.schema import RobotFile

KINDS = {"robot": "urdf", "mujoco": "mjcf", "sdf": "sdf"}  # root element: key of the robot file
NAMED = ("package://", ready_made.SCHEME)  # before what is no path
EXAMPLES = "example-robot-data"  # a package of descriptions, and their folder in it
SUFFIXES = (".urdf", ".xml", ".mjcf", ".sdf")
PARSE_ERRORS = (ElementTree.ParseError, ValueError, RuntimeError, LookupError, OSError)
SAID = 200  # characters of what a parser says

Made = TypeVar("Made")


@dataclass(frozen=True)
class Description:
    """A description as it is used: `kind` urdf, mjcf or sdf, where it lies, and of a URDF or SDF the URDF,
    whose continuous joints are unwrapped and whose sections that are left out are cut. `follows` are joints
    that are tied to another one (mimic, equality), which is not modelled, and `odd` what else it holds that a
    user should know."""

    kind: str
    path: Path
    text: str
    package_dirs: tuple[Path, ...]
    follows: Mapping[str, str] = field(default_factory=dict)
    odd: tuple[str, ...] = ()


def is_one(source: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a description, by its suffix."""
    return Path(source).suffix.lower() in SUFFIXES or str(source).startswith(ready_made.SCHEME)


def kind_of(source: str, path: Path) -> str:
    """urdf, mjcf or sdf, by the root element of a description: a path, or package:// as of the robot file at
    `path`. Raises RobotError where it is none."""
    named = RobotFile.model_construct(urdf=source, package_dirs=())
    found = find(named, path) if source.startswith(NAMED) else Path(source)
    if not found.is_file():
        raise RobotError(f"{found} does not exist; give the path of a URDF, MJCF or SDF")
    try:
        tag = xml_file.read(found).tag
    except RobotError:
        raise
    except PARSE_ERRORS as error:
        raise RobotError(f"{found} cannot be loaded: {one_line(error, SAID)}") from None
    if tag not in KINDS:
        expected = ", ".join(f"<{known}>" for known in KINDS)
        raise RobotError(f"{found}: expected a URDF, MJCF or SDF, whose root is {expected}; got <{tag}>")
    return KINDS[tag]


def has_free_joint(description: Description) -> bool:
    """Whether an MJCF's first body moves freely; other descriptions do not say."""
    if description.kind != "mjcf":
        return False
    return floats(_parsed(description, lambda: pin.buildModelFromMJCF(str(description.path))))


def example_robot_data() -> Path:
    """The folder that package:// of the installed example-robot-data resolves against; MissingExtraError
    where it is not installed."""
    try:
        wheel = importlib.metadata.distribution(EXAMPLES)
    except importlib.metadata.PackageNotFoundError:
        raise MissingExtraError(EXAMPLES, "example-robots") from None
    return Path(str(wheel.locate_file("cmeel.prefix/share")))


def find(file: RobotFile, path: Path) -> Path:
    """The description that the robot file at `path` names; raises RobotError where there is none."""
    kind, name = file.description
    if name.startswith(ready_made.SCHEME):
        return ready_made.find(name.removeprefix(ready_made.SCHEME))
    if name.startswith("package://"):
        rest = name.removeprefix("package://")
        folders = package_dirs(file, path)
        if leaves_package(name):
            raise RobotError(f"{path}: {kind.upper()} {name!r} leaves its package; name a place below it")
        for folder in folders:
            if (folder / rest).is_file():
                return folder / rest
        if rest.startswith(f"{EXAMPLES}/"):
            example_robot_data()  # says what to install
        raise RobotError(
            f"{path}: {kind.upper()} {name!r} not found under {', '.join(map(str, folders))}; add its folder"
            " to package_dirs"
        )
    found = path.parent / name
    if not found.is_file():
        raise RobotError(
            f"{path}: {kind.upper()} {found} does not exist; `{kind}` is relative to the YAML or package://"
        )
    return found


def package_dirs(file: RobotFile, path: Path) -> tuple[Path, ...]:
    """Where package:// is looked up: the file's own folders, its own place, example-robot-data where it is
    installed."""
    own = [path.parent / folder for folder in file.package_dirs]
    name = file.description[1]
    if name.startswith(ready_made.SCHEME):
        own += ready_made.package_dirs(name.removeprefix(ready_made.SCHEME))
    try:
        share = example_robot_data()
    except MissingExtraError:
        return (*own, path.parent)
    return (*own, path.parent, share, share / EXAMPLES)


def read(file: RobotFile, path: Path) -> Description:
    """The description of the robot file at `path`; raises RobotError where it cannot be read."""
    found = find(file, path)
    kind = file.description[0]
    try:
        root = xml_file.read(found)
    except RobotError:
        raise
    except PARSE_ERRORS as error:
        raise _unreadable(kind, found, error) from None
    given = KINDS.get(root.tag, root.tag)
    if given != kind:
        raise RobotError(
            f"{path}: `{kind}` names {found}, whose root element is <{root.tag}>"
            + (f"; call the key `{given}`" if given in KINDS.values() else f"; expected <{_tag(kind)}>")
        )
    text, said, where = "", list[str](), f"{kind.upper()} {found}"
    if kind == "mjcf":
        follows, odd = mjcf_checks.check(root, where)
    else:
        if kind == "sdf":
            root, said = sdf.as_urdf(root, where, file.base == "floating")
        follows, odd = urdf_checks.check(root, where)
        text = _unwrap_continuous(root, file.continuous, path)
    if kind == "mjcf" and file.continuous:
        raise RobotError(f"{path}: `continuous` needs a URDF; write the joints without limits in the {kind}")
    return Description(kind, found, text, package_dirs(file, path), follows, (*said, *odd))


def leaves_package(name: str) -> bool:
    """Whether a package:// name climbs out of the folder that it is looked up in."""
    depth = 0
    for part in PurePosixPath(name.removeprefix("package://").replace("\\", "/")).parts:
        depth += {"..": -1, "/": 0}.get(part, 1)
        if depth < 0:
            return True
    return False


def model(description: Description, floating: bool) -> pin.Model:
    """The description as Pinocchio reads it, on a free-flyer where it floats; raises RobotError."""
    path = description.path
    if description.kind == "mjcf":
        built = _parsed(description, lambda: pin.buildModelFromMJCF(str(path)))
        free = floats(built)
        if free is not floating:
            has, base = ("a", "floating") if free else ("no", "fixed, or give its first body a freejoint")
            raise RobotError(f"MJCF {path} has {has} free joint; write base: {base}")
        return built
    root = pin.JointModelFreeFlyer() if floating else None
    arguments = (description.text, root) if root else (description.text,)
    return _parsed(description, lambda: pin.buildModelFromXML(*arguments))


def _parsed(description: Description, parse: Callable[[], Made]) -> Made:
    """What a parser of Pinocchio makes; raises RobotError with what it said. Its own lines on standard error,
    which only repeat that, are not shown."""
    with native_output.held() as said:
        try:
            return parse()
        except PARSE_ERRORS as error:
            failure: Exception = error
    reason = " ".join([native_output.message(failure), *native_output.errors(said)[:1]])
    raise _unreadable(description.kind, description.path, reason)


def _unreadable(kind: str, path: Path, error: object) -> RobotError:
    return RobotError(f"{kind.upper()} {path} cannot be loaded: {one_line(error, SAID)}")


def _tag(kind: str) -> str:
    return next(tag for tag, name in KINDS.items() if name == kind)


def _unwrap_continuous(root: ElementTree.Element, also: Collection[str], path: Path) -> str:
    """Continuous joints (and those that the robot file calls so) as revolute ones without limits: a
    recording holds unwrapped angles."""
    names = [str(joint.get("name")) for joint in root.iter("joint")]
    for name in also:
        if name not in names:
            raise RobotError(f"{path}: continuous: {unknown('joint', name, names)}")
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous" or joint.get("name") in also:
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = limit if limit is not None else ElementTree.SubElement(joint, "limit")
            limit.attrib.setdefault("effort", "1e9")
            limit.attrib.setdefault("velocity", "1e9")
            limit.attrib.update(lower="-1e9", upper="1e9")
    return ElementTree.tostring(root, encoding="unicode")
