"""A first robot file of a description: complete, rigid, and with a comment at every number that it does"
" not know."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import yaml

from flexjoint.core.errors import RobotError, unknown
from flexjoint.core.units import of_joint
from flexjoint.robot import description as robot_description
from flexjoint.robot import ready_made, schema
from flexjoint.robot.numbers import floats
from flexjoint.robot.reading import mjcf_drives, mjcf_limits, xml_file
from flexjoint.robot.reading.mjcf_drives import Drives
from flexjoint.robot.robot import Robot, build, shipped_robots

CHECK = "CHECK"  # what a comment begins with where the description does not know a number
SLOWEST = 1000.0  # Hz, of the physics and the controller, where nothing is known
TOLERANCE = (  # how far the numbers of a description may be trusted, and why
    ("inertial", 0.1, "masses and inertias: from CAD, without cables, covers, grease; 0.05 if identified"),
    ("stiffness", 0.2, "springs: data sheets state typical values; matters once a joint has one"),
    ("damping", 0.5, "motor_damping: viscous friction follows temperature; descriptions hold guesses"),
    ("torque", 0.03, "share of a joint's torque below which no cause matters: torque constants err so"),
)
UNLIMITED = 1e8  # N m, beyond which a limit of the description is none
LEAST_INERTIA = 1e-9  # kg m^2 about a joint's axis, below which nothing resists its torque
PLAIN = re.compile(r"^[A-Za-z_][A-Za-z0-9_\-./]*$")  # names that YAML takes without quotes


@dataclass(frozen=True)
class Seen:
    """What a recording shows of a robot: its rate [Hz], and channels by joint."""

    name: str
    rate: float
    channels: Mapping[str, Sequence[str]]

    def has(self, channel: str) -> bool:
        return any(channel in channels for channels in self.channels.values())


@dataclass(frozen=True)
class Draft:
    """The text of a robot file, the robot that it makes, and what a reader should know of it."""

    text: str
    robot: Robot
    notes: tuple[str, ...]


@dataclass
class _Joints:
    """The joints of a description: actuated, locked with the reason, and what it says of them."""

    model: pin.Model
    actuated: list[str] = field(default_factory=list)
    locked: dict[str, str] = field(default_factory=dict)
    efforts: Mapping[str, float] | None = None  # limits of an MJCF, by joint

    def effort(self, joint: str) -> float:
        """The limit of a joint's torque; 0 where none is stated."""
        if self.efforts is None:
            return self.number("effortLimit", joint)
        return self.efforts.get(joint, 0.0)

    def number(self, key: str, joint: str) -> float:
        """A number of a joint by Pinocchio: effortLimit, damping, friction, armature; 0 where not stated."""
        value = float(getattr(self.model, key)[self.model.joints[self.model.getJointId(joint)].idx_v])
        return value if math.isfinite(value) and value < UNLIMITED else 0.0

    def slides(self, joint: str) -> bool:
        return (
            "P" in self.model.joints[self.model.getJointId(joint)].shortname().replace("JointModel", "")[:1]
        )


def draft(source: str, out: Path, seen: Seen | None = None, springs: bool = True) -> Draft:
    """The robot file of a description, to be written to `out`.

    Args:
        source: path of a URDF, MJCF or SDF, package://..., or a name of robot_descriptions.
        seen: what a recording shows; joints that it does not have are held.
        springs: whether comments tell how a joint becomes flexible.

    Raises RobotError where the description cannot be used.
    """
    if ready_made.is_name(source) and not Path(source).exists():
        source = f"{ready_made.SCHEME}{source}"
    if not robot_description.is_one(source):
        if (shipped := shipped_robots().get(source)) is not None:
            raise RobotError(
                f"{source} is a shipped robot, whose file is written: say --robot {source}, or copy {shipped}"
            )
        raise RobotError(
            f"{source}: expected a URDF, MJCF or SDF ({', '.join(robot_description.SUFFIXES)}),"
            f" package://..., or a"
            " name of robot_descriptions such as panda_description"
        )
    named = source.startswith(robot_description.NAMED)
    kind = robot_description.kind_of(source, out)
    given = source if named else Path(os.path.abspath(source)).as_posix()
    name = Path(source).stem or "robot"
    bare = schema.parse(
        {"name": name, kind: given, "joints": {"": {"stiffness": math.inf, "motor_inertia": 0.0}}}, source
    )
    description = robot_description.read(bare, out)
    floating = robot_description.has_free_joint(description)
    model = robot_description.model(description, floating)
    drives = _drives(model, description)
    joints = _joints(model, description.text, seen, source, drives)
    if description.kind == "mjcf":
        root = xml_file.read(description.path)
        joints.efforts = mjcf_limits.torque_limits(root, f"MJCF {description.path}")
    place = source if named else _relative(Path(source), out.parent)
    lines = _Lines(kind, name.removesuffix(ready_made.ENDING), place, floating, joints, seen, springs, drives)
    text = "\n".join(lines.all()) + "\n"
    file = schema.parse(yaml.safe_load(text), str(out))
    robot = build(file.model_copy(update={kind: given}), out)
    return Draft(text, robot, tuple(_notes(robot, joints)))


def _relative(target: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return target.resolve().as_posix()


# --- joints -------------------------------------------------------------------------------------------------
def _drives(model: pin.Model, description: robot_description.Description) -> Drives | None:
    """The drives of an MJCF that was exported, None of any other description."""
    if description.kind != "mjcf":
        return None
    where = f"MJCF {description.path}"
    inverse = np.diag(pin.computeMinverse(model, model.createData(), pin.neutral(model)))

    def inverse_inertia(joint: str) -> float:
        if not model.existJointName(joint):
            raise RobotError(f"{where}: {unknown('joint', joint, list(model.names)[1:])}; export it anew")
        return float(inverse[model.joints[model.getJointId(joint)].idx_v])

    return mjcf_drives.read(xml_file.read(description.path), where, inverse_inertia)


def _joints(model: pin.Model, urdf: str, seen: Seen | None, source: str, drives: Drives | None) -> _Joints:
    out = _Joints(model)
    mimics = _mimics(urdf)
    names = [str(name) for name in model.names][2 if floats(model) else 1 :]
    for name in names:
        joint = model.joints[model.getJointId(name)]
        if joint.nq != 1 or joint.nv != 1:
            out.locked[name] = f"{joint.nv} degrees of freedom: only single-axis joints can be actuated"
        elif name in mimics:
            out.locked[name] = f"mimics {_quoted(mimics[name])}"
        elif drives is not None and name not in drives.joints:
            continue  # a passive joint, which swings
        elif seen is not None and name not in seen.channels:
            out.locked[name] = "not in the recording; give its position [rad] under `initial`"
        else:
            out.actuated.append(name)
    for name in seen.channels if seen is not None else ():
        if name not in names:
            raise RobotError(
                f"{source}: the recording {seen.name if seen else ''}: {unknown('joint', name, names)}"
            )
    if not out.actuated:
        raise RobotError(f"{source}: expected at least one joint with a single axis to actuate, got none")
    return out


def _mimics(urdf: str) -> dict[str, str]:
    """Joints of a URDF that follow another one, which Pinocchio reads as free."""
    if not urdf:
        return {}
    found = ((joint, joint.find("mimic")) for joint in ElementTree.fromstring(urdf).iter("joint"))
    return {str(joint.get("name")): str(mimic.get("joint")) for joint, mimic in found if mimic is not None}


# --- text ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Lines:
    """The lines of a robot file."""

    kind: str
    name: str
    place: str
    floating: bool
    joints: _Joints
    seen: Seen | None
    springs: bool
    drives: Drives | None

    def all(self) -> Iterator[str]:
        yield "# Robot file of flexjoint, drafted by `flexjoint init`; every key: docs/reference/formats.md."
        yield f"# A line marked {CHECK} holds what the {self.kind.upper()} does not know: where to find it."
        yield f"name: {_quoted(self.name)}"
        yield f"{self.kind}: {_quoted(self.place)}  # relative to this file, or package://"
        yield "base: floating" if self.floating else "base: fixed  # or floating: it walks, drives or flies"
        gravity = [0, 0, -9.81] if self.drives is None else list(self.drives.gravity)
        yield f"gravity: {gravity}  # m/s^2 in the base frame; {CHECK} on a wall, a ceiling or a slope"
        yield from self._rates()
        yield from self._locked()
        yield "tolerance:  # relative standard deviations: what they can explain is no finding"
        for key, value, why in TOLERANCE:
            yield f"  {key}: {value:g}  # {why}"
        yield from self._offsets()
        yield from self._actuated()
        yield from self._couplings()
        yield from self._effects()
        yield f"sources: {{numbers: {json.dumps(f'{self.place}, as flexjoint init read it')}}}"

    def _rates(self) -> Iterator[str]:
        rate = max(SLOWEST, self.seen.rate) if self.seen is not None else SLOWEST
        physics = max(rate, self.drives.rate) if self.drives is not None else rate
        recorded = f"; the recording has {self.seen.rate:.4g} Hz" if self.seen is not None else ""
        yield "rates:"
        yield f"  physics: {physics:.10g}  # Hz, steps of a simulation"
        yield f"  control: {rate:.10g}  # Hz, {CHECK}: cycle of the joint controller, by its manual{recorded}"

    def _locked(self) -> Iterator[str]:
        if not self.joints.locked:
            yield "lock: []  # joints that are held; their mass stays"
            return
        yield "lock:  # joints that are held at `initial` (0 without it); their mass stays"
        for name, why in self.joints.locked.items():
            yield f"  - {_quoted(name)}  # {why}"

    def _offsets(self) -> Iterator[str]:
        if self.seen is not None and self.seen.has("q") and self.seen.has("theta"):
            yield "offsets: per_recording  # of the two encoders of a joint: estimated anew on each recording"
        else:
            yield "# offsets: per_recording  # if encoders lose their zero when the robot is switched off"

    def _actuated(self) -> Iterator[str]:
        yield "joints:  # all numbers as seen from the link, through the gear"
        if self.springs and self.drives is None:
            yield "  # A joint with a harmonic drive or a series spring is flexible: for .inf put the"
            yield "  # torsional stiffness [N m/rad] of its gear (data sheet, at the output), and add"
            yield "  # `damping: ...` [N m s/rad]; it needs a motor_inertia then."
        for joint in self.joints.actuated:
            yield f"  {_quoted(joint)}:"
            yield from (f"    {line}" for line in self._numbers(joint))

    def _numbers(self, joint: str) -> Iterator[str]:
        unit = lambda text: of_joint(text, self.joints.slides(joint))  # noqa: E731
        if self.drives is not None:
            yield from (f"{key}: {_exactly(value)}" for key, value in self.drives.joints[joint].items())
            return
        effort, damping = self.joints.effort(joint), self.joints.number("damping", joint)
        channels = self.seen.channels.get(joint, ()) if self.seen is not None else ()
        if self.springs and "q" in channels and "theta" in channels:
            yield f"stiffness: .inf  # rigid; {CHECK}: both encoders are recorded, the gear's stiffness?"
        else:
            yield "stiffness: .inf  # rigid"
        armature = self.joints.number("armature", joint)
        if armature > 0.0:
            yield f"motor_inertia: {_number(armature)}  # {unit('kg m^2')}, the armature of the MJCF"
        else:
            yield (
                f"motor_inertia: 0  # {unit('kg m^2')}, {CHECK}: gear_ratio^2 x rotor inertia (data sheet"
                f" of the motor); 0: to be found"
            )
        if damping > 0.0:
            size = _number(damping)
            yield f"motor_damping: {size}  # {unit('N m s/rad')}, of the description; often a guess"
        else:
            yield f"motor_damping: 0  # {unit('N m s/rad')}, {CHECK}: viscous friction; 0: to be found"
        if effort > 0.0:
            yield f"torque_limit: {_number(effort)}  # {unit('N m')}, the limit of the description"
        else:
            yield f"# torque_limit: 100  # {unit('N m')}, {CHECK}: peak torque of the drive (data sheet)"
        need = "needed for the recorded currents" if "current" in channels else "needed for currents"
        yield f"# gear_ratio: 100  # {CHECK}: rotor turns per turn of the joint (data sheet); {need}"
        yield f"# torque_constant: 0.1  # N m/A at the rotor, {CHECK}: data sheet of the motor; {need}"

    def _couplings(self) -> Iterator[str]:
        if self.drives is None or not self.drives.couplings:
            return
        yield "couplings:  # motors that several joints share: a row a motor, a column a joint"
        for entry in self.drives.couplings:
            joints = ", ".join(_quoted(joint) for joint in entry["joints"])
            rows = ", ".join(f"[{', '.join(_exactly(x) for x in row)}]" for row in entry["matrix"])
            yield f"  - {{joints: [{joints}], matrix: [{rows}]}}"

    def _effects(self) -> Iterator[str]:
        if self.drives is not None and self.drives.effects:
            yield "effects:  # what the description claims; a diagnosis says how far it is off"
            for entry in self.drives.effects:
                values = ", ".join(f"{key}: {_exactly(value)}" for key, value in entry.items())
                yield f"  - {{{values}, nominal: true}}"
            return
        levels = {joint: self.joints.number("friction", joint) for joint in self.joints.actuated}
        stated = {joint: level for joint, level in levels.items() if level > 0.0}
        if not stated:
            yield "effects: []  # the description states no dry friction; what there is, a diagnosis finds"
            return
        yield "effects:  # what the description claims; a diagnosis says how far it is off"
        for joint, level in stated.items():
            name, size = _quoted(joint), _number(level)
            yield f"  - {{effect: motor_coulomb_friction, joint: {name}, level: {size}, nominal: true}}"


def _exactly(value: float | str) -> str:
    """A word, or a number with all its digits, as YAML takes it."""
    if isinstance(value, str):
        return _quoted(value)
    return ".inf" if math.isinf(value) else _with_point(repr(float(value)))


def _number(value: float) -> str:
    """A number of a description as YAML takes it, without the last digits that rounding leaves."""
    return _with_point(f"{value:.10g}")


def _with_point(text: str) -> str:
    """6e-05 is a word to YAML, 6.0e-05 a number."""
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _quoted(text: str) -> str:
    """A word as YAML takes it."""
    try:
        plain = bool(PLAIN.match(text)) and yaml.safe_load(text) == text
    except (yaml.YAMLError, ValueError):
        plain = False
    return text if plain else json.dumps(text)


# --- notes --------------------------------------------------------------------------------------------------
def _notes(robot: Robot, joints: _Joints) -> Iterator[str]:
    yield f"{len(robot.joints)} joints, {robot.mass:.4g} kg: {', '.join(robot.joint_names)}"
    for name, why in joints.locked.items():
        yield f"held: {name} ({why})"
    mass = pin.crba(robot.model, robot.model.createData(), pin.neutral(robot.model))
    light = [
        joint.name
        for joint in robot.joints
        if float(np.asarray(mass)[joint.idx_v, joint.idx_v]) + float(joint.drive.B) < LEAST_INERTIA
    ]
    if light:
        names = ", ".join(light)
        yield f"nothing resists the torque of {names}: no inertia in the description; give motor_inertia"
    lost = [joint.name for joint in robot.joints if math.isinf(joint.torque_limit)]
    if lost:
        yield f"no torque limit of {', '.join(lost)}"
