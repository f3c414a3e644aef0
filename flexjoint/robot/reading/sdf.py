"""The plain model of an SDF as the URDF of the same robot.

SDF places links, joints and frames by poses that may be relative to any other frame (SDFormat's
specification, "Pose Frame Semantics"); a URDF has each link at its joint. So every place is computed in the
model's frame, and the URDF is written from these. Read: links with pose and inertial, joints that turn, slide
or are fixed, with axis, limits, damping and friction, and frames. What is no plain model is refused; shapes,
sensors and plugins are left aside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError, unknown
from flexjoint.core.messages import shown
from flexjoint.robot.reading import xml_file
from flexjoint.robot.reading.urdf_checks import MOMENTS

TYPES = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
NO_PLAIN_MODEL = {  # elements of a model whose bodies or joints would be lost
    "include": "an <include>; put what it includes into the file (gz sdf -p prints it)",
    "model": "a nested <model>; write its links into the outer one",
    "gripper": "a <gripper>, which ties joints; leave it out",
}
MODEL, WORLD = "__model__", "world"
ENDLESS = 1e9  # rad, N m, rad/s: a limit beyond it is none; SDF's own is 1e16, or inf
HERE = 1e-12  # m and rad, by which a joint's frame may miss its link's to be the same
UNIT = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0}  # SDF's defaults: a body of 1 kg and 1 kg m^2
OLD = (1, 6)  # the last version of SDF with use_parent_model_frame, whose frames have no names
OLDEST = (1, 4)  # the last version of which every axis is in the model's frame


def as_urdf(root: Element, where: str, floating: bool) -> tuple[Element, list[str]]:
    """A URDF <robot> of the model of an SDF, and what a user should know of it.

    The base frame is the world of the file; where the base floats, that of its root link. Raises RobotError
    for what is no plain model, and where a number, name or place is wrong.
    """
    return _Reader(_model(root, where), _version(root), where).urdf(floating)


def _version(root: Element) -> tuple[int, ...]:
    words = root.get("version", "1.7").split(".")
    return tuple(int(word) if word.isdigit() else 0 for word in words[:2])


def _model(root: Element, where: str) -> Element:
    places = [root, *root.findall("world")]
    models = [model for place in places for model in place.findall("model")]
    for place in places:
        if place.find("include") is not None:
            raise RobotError(f"{where}: holds {NO_PLAIN_MODEL['include']}")
    if len(models) != 1:
        names = ", ".join(shown(model.get("name", "?")) for model in models[:8]) or "none"
        raise RobotError(f"{where}: expected one <model>, got {names}; leave the others out")
    return models[0]


@dataclass(frozen=True)
class _Frame:
    """A frame of the file: its pose relative to another one, and the link that it is fixed to."""

    pose: pin.SE3
    relative_to: str
    link: str | None


class _Reader:
    def __init__(self, model: Element, version: tuple[int, ...], where: str) -> None:
        self.model, self.version, self.where = model, version, where
        self.said: list[str] = []
        for tag, what in NO_PLAIN_MODEL.items():
            if model.find(tag) is not None:
                raise RobotError(f"{where}: holds {what}")
        if _yes(model.findtext("static")):
            raise RobotError(f"{where}: the model is static: nothing moves; delete <static>")
        self.links = [(xml_file.name_of(e, "link", where), e) for e in model.findall("link")]
        self.joints = [(xml_file.name_of(e, "joint", where), e) for e in model.findall("joint")]
        if not self.links:
            raise RobotError(f"{where}: the model has no link")
        counts = {tag: len(model.findall(tag[:-1])) for tag in ("links", "joints", "frames")}
        xml_file.check_count(counts, where)
        self.frames = self._frames()
        self.canonical = model.get("canonical_link") or self.links[0][0]  # that the model's frame is fixed to
        if self.canonical not in dict(self.links):
            names = [name for name, _ in self.links]
            raise RobotError(f"{where}: canonical_link: {unknown('link', shown(self.canonical), names)}")
        self.placed: dict[str, pin.SE3] = {MODEL: pin.SE3.Identity()}

    # --- poses and frames -----------------------------------------------------------------------------------
    def _frames(self) -> dict[str, _Frame]:
        frames: dict[str, _Frame] = {}

        def add(name: str, frame: _Frame) -> None:
            if name in frames or name in (MODEL, WORLD):
                raise RobotError(f"{self.where}: the name {shown(name)} stands twice; rename one")
            frames[name] = frame

        for name, link in self.links:
            pose, to = self._pose(link, f"link {shown(name)}")
            add(name, _Frame(pose, to or MODEL, name))
        for name, joint in self.joints:
            pose, to = self._pose(joint, f"joint {shown(name)}")
            add(name, _Frame(pose, to or self._end(joint, name, "child"), None))
        for element in self.model.findall("frame"):
            name = xml_file.name_of(element, "frame", self.where)
            pose, to = self._pose(element, f"frame {shown(name)}")
            attached = element.get("attached_to") or None
            add(name, _Frame(pose, to or attached or MODEL, attached))
        return frames

    def _end(self, joint: Element, name: str, end: str) -> str:
        element = joint.find(end)
        named = "" if element is None else (element.text or element.get("link") or "").strip()
        if not named:
            raise RobotError(f"{self.where}: joint {shown(name)} has no <{end}>; name a link")
        if "::" in named:
            raise RobotError(
                f"{self.where}: joint {shown(name)}: {shown(named)} lies in a nested model; write its links"
                " into the outer one"
            )
        return named

    def _pose(self, element: Element, what: str) -> tuple[pin.SE3, str | None]:
        """The <pose> of an element, and what it is relative to, where that is said."""
        pose = element.find("pose")
        if pose is None or not (pose.text or "").strip():
            return pin.SE3.Identity(), None if pose is None else pose.get("relative_to") or None
        place = f"{self.where}: {what}: pose"
        if (pose.get("rotation_format") or "euler_rpy") == "quat_xyzw":
            x, y, z, *turned = xml_file.numbers(pose.text or "", (7,), place)
            size = math.sqrt(sum(a * a for a in turned))
            if not 0.999 < size < 1.001:
                raise RobotError(f"{place}: a quaternion has the length 1, got {size:.4g}")
            rotation = pin.Quaternion(np.array(turned) / size).toRotationMatrix()
        else:
            x, y, z, *angles = xml_file.numbers(pose.text or "", (6,), place)
            if _yes(pose.get("degrees")):
                angles = [math.radians(angle) for angle in angles]
            rotation = pin.rpy.rpyToMatrix(*angles)
        return pin.SE3(rotation, np.array([x, y, z])), pose.get("relative_to") or None

    def place(self, name: str) -> pin.SE3:
        """A frame in the model's."""
        chain: list[str] = []
        while name not in self.placed:
            if name in chain:
                circle = ", ".join(chain[chain.index(name) :][:8])
                raise RobotError(
                    f"{self.where}: the poses of {shown(circle)} are relative to each other; give one of them"
                    " in the model's frame"
                )
            chain.append(name)
            name = self._frame(name).relative_to
        for inner in reversed(chain):
            frame = self.frames[inner]
            self.placed[inner] = self.placed[frame.relative_to] * frame.pose
        return self.placed[chain[0]] if chain else self.placed[name]

    def _frame(self, name: str) -> _Frame:
        if name not in self.frames:
            raise RobotError(f"{self.where}: {unknown('frame', shown(name), list(self.frames))}")
        return self.frames[name]

    def _link_of(self, name: str) -> str:
        """The link that a frame is fixed to."""
        seen = [name]
        while True:
            if name == MODEL:
                return self.canonical
            frame = self._frame(name)
            if frame.link == name:
                return name
            if frame.link is None:  # a joint's frame, which is fixed to its child
                joint = dict(self.joints).get(name)
                attached = self.canonical if joint is None else self._end(joint, name, "child")
            else:
                attached = frame.link
            if attached in seen:
                raise RobotError(
                    f"{self.where}: frame {shown(name)} is attached to itself; name a link in attached_to"
                )
            seen.append(attached)
            name = attached

    # --- the URDF -------------------------------------------------------------------------------------------
    def urdf(self, floating: bool) -> tuple[Element, list[str]]:
        robot = Element("robot", name=self.model.get("name") or "robot")
        base, to = self._pose(self.model, "model")
        if to not in (None, WORLD):
            raise RobotError(
                f"{self.where}: the model's pose is relative to {shown(to)}; give it in the world"
            )
        if placed := self.model.get("placement_frame"):  # the frame that the model's pose places
            base = base * self.place(placed).inverse()
        moved = list(self._moved())
        carrying = {child: self.place(name) for name, _, _, child in moved}
        for name, link in self.links:
            at = carrying.get(name, self.place(name))
            own = at.actInv(self.place(name))
            inside = name
            if not _near(own):  # the joint lies elsewhere in its link: a bare link there carries it
                inside = f"{name}.at_joint"
                if inside in self.frames:
                    raise RobotError(f"{self.where}: the name {shown(inside)} is needed; rename it")
                SubElement(robot, "link", name=inside)
            body = SubElement(robot, "link", name=name)
            self._inertial(body, link, name)
            if inside != name:
                held = SubElement(robot, "joint", name=f"{name}.in_link", type="fixed")
                _ends(held, inside, name, own)
        self._roots(robot, base, {child for _, _, _, child in moved}, floating)
        heads = {name: f"{name}.at_joint" for name, _ in self.links}
        present = {element.get("name") for element in robot.findall("link")}
        for name, joint, parent, child in moved:
            element = SubElement(robot, "joint", name=name, type=self._type(joint, name))
            origin = self.place(parent).actInv(self.place(name))
            head = heads[child] if heads[child] in present else child
            _ends(element, parent, head, origin)
            if element.get("type") != "fixed":
                self._axis(element, joint, name)
        return robot, self.said

    def _moved(self) -> Iterator[tuple[str, Element, str, str]]:
        """Joints with the links that they connect, without those that fix the model to the world."""
        for name, joint in self.joints:
            parent, child = self._end(joint, name, "parent"), self._end(joint, name, "child")
            kind = self._type(joint, name)
            if child == WORLD:
                raise RobotError(f"{self.where}: joint {shown(name)} carries the world; exchange its ends")
            if parent == WORLD:
                if kind != "fixed":
                    raise RobotError(
                        f"{self.where}: joint {shown(name)} moves the model in the world; put a link that is"
                        " fixed to the world between"
                    )
                self._link_of(child)
                continue
            yield name, joint, self._link_of(parent), self._link_of(child)

    def _roots(self, robot: Element, base: pin.SE3, carried: set[str], floating: bool) -> None:
        """The root link at its place in the world, of a fixed base."""
        roots = [name for name, _ in self.links if name not in carried]
        if floating or len(roots) != 1:
            return  # more than one root, and none, are refused as of a URDF
        place = base * self.place(roots[0])
        if _near(place):
            return
        name = next(n for n in (WORLD, "world.of.sdf", "world.of.the.sdf") if n not in self.frames)
        SubElement(robot, "link", name=name)
        mount = SubElement(robot, "joint", name=f"{roots[0]}.in_world", type="fixed")
        _ends(mount, name, roots[0], place)

    def _inertial(self, body: Element, link: Element, name: str) -> None:
        inside = f"{self.where}: link {shown(name)}"
        inertial = link.find("inertial")
        given: Mapping[str, float] = {}
        pose, mass = pin.SE3.Identity(), 1.0
        if inertial is not None:
            if _yes(inertial.get("auto")):
                raise RobotError(
                    f"{inside}: its inertial is computed of its shapes (auto); write mass and inertia"
                )
            if inertial.find("fluid_added_mass") is not None:
                raise RobotError(f"{inside}: fluid_added_mass is not modelled; leave it out")
            pose, to = self._pose(inertial, f"link {shown(name)}: inertial")
            if to not in (None, name):
                raise RobotError(
                    f"{inside}: its inertial's pose is relative to {shown(to)}; give it in the link"
                )
            mass = self._number(inertial, "mass", 1.0, inside)
            inertia = inertial.find("inertia")
            if inertia is not None:
                given = {
                    m: self._number(inertia, m, UNIT.get(m, 0.0), inside)
                    for m in MOMENTS
                    if inertia.find(m) is not None
                }
        if (link.findtext("gravity") or "true").strip().lower() in ("false", "0"):
            self.said.append(f"{inside} has <gravity> switched off in SDF; it weighs here, as on the machine")
        if inertial is None or inertial.find("mass") is None or not given:
            self.said.append(
                f"{inside} states no mass or no inertia: SDF takes 1 kg and 1 kg m^2 where one is missing"
            )
        moments = {m: given.get(m, UNIT.get(m, 0.0)) for m in MOMENTS}
        element = SubElement(body, "inertial")
        _origin(element, pose)
        SubElement(element, "mass", value=repr(mass))
        SubElement(element, "inertia", {m: repr(value) for m, value in moments.items()})

    def _number(self, element: Element, tag: str, default: float, where: str, endless: bool = False) -> float:
        text = element.findtext(tag)
        if text is None or not text.strip():
            return default
        (value,) = xml_file.numbers(text, (1,), f"{where}: {tag}", endless=endless)
        return value

    # --- joints ---------------------------------------------------------------------------------------------
    def _type(self, joint: Element, name: str) -> str:
        kind = joint.get("type", "")
        if kind not in TYPES:
            raise RobotError(
                f"{self.where}: joint {shown(name)}: type '{shown(kind)}' is not read, expected one of"
                f" {', '.join(TYPES)}; fix it, or convert the robot to MJCF"
            )
        return TYPES[kind]

    def _axis(self, element: Element, joint: Element, name: str) -> None:
        inside = f"{self.where}: joint {shown(name)}"
        axis = joint.find("axis")
        if axis is None:
            raise RobotError(f"{inside}: has no <axis>; give one")
        xyz = axis.find("xyz")
        text = "0 0 1" if xyz is None or not (xyz.text or "").strip() else str(xyz.text)
        along = np.array(xml_file.numbers(text, (3,), f"{inside}: axis"))
        frame = None if xyz is None else xyz.get("expressed_in") or None
        stated = axis.findtext("use_parent_model_frame")
        if self.version <= OLD and (_yes(stated) or (stated is None and self.version <= OLDEST)):
            frame = MODEL
        if frame is not None:
            along = self.place(name).rotation.T @ self.place(frame).rotation @ along
        SubElement(element, "axis", xyz=" ".join(map(repr, along.tolist())))
        limit = axis.find("limit")
        limit = Element("limit") if limit is None else limit
        number = lambda tag: self._number(limit, tag, -1.0, inside, endless=True)  # noqa: E731
        bounds = {
            end: self._number(limit, end, sign * math.inf, inside, endless=True)
            for end, sign in (("lower", -1.0), ("upper", 1.0))
        }
        if joint.get("type") == "continuous":
            bounds = {"lower": -ENDLESS, "upper": ENDLESS}
        effort, velocity = (ENDLESS if number(tag) < 0.0 else number(tag) for tag in ("effort", "velocity"))
        given = {**bounds, "effort": effort, "velocity": velocity}
        SubElement(element, "limit", {key: repr(min(max(x, -ENDLESS), ENDLESS)) for key, x in given.items()})
        dynamics = axis.find("dynamics")
        if dynamics is not None:
            numbers = {tag: self._number(dynamics, tag, 0.0, inside) for tag in ("damping", "friction")}
            SubElement(element, "dynamics", {tag: repr(value) for tag, value in numbers.items()})
            if self._number(dynamics, "spring_stiffness", 0.0, inside) != 0.0:
                self.said.append(
                    f"{inside}: its spring is not read; list a cable_spring under `effects` of the robot file"
                )
        mimic = axis.find("mimic")
        if mimic is not None:
            SubElement(element, "mimic", joint=mimic.get("joint", ""))


def _yes(text: str | None) -> bool:
    """Whether a word of SDF says so."""
    return (text or "").strip().lower() in ("true", "1")


def _near(place: pin.SE3) -> bool:
    return bool(np.abs(place.homogeneous - np.eye(4)).max() <= HERE)


def _origin(element: Element, place: pin.SE3) -> None:
    angles = np.asarray(pin.rpy.matrixToRpy(place.rotation))
    SubElement(
        element,
        "origin",
        xyz=" ".join(map(repr, place.translation.tolist())),
        rpy=" ".join(map(repr, angles.tolist())),
    )


def _ends(joint: Element, parent: str, child: str, place: pin.SE3) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _origin(joint, place)
