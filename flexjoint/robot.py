"""Robot = one YAML beside its URDF: the nominal model, with how far its numbers are trusted."""

from __future__ import annotations

import math
import os
import sysconfig
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import yaml

from flexjoint import robot_schema as schema
from flexjoint.effect import Drive, Planned, plan
from flexjoint.errors import FlexJointError, RobotError, unknown
from flexjoint.files import write_text


@dataclass(frozen=True)
class Joint:
    """One actuated joint: its numbers, link-referred, and where it stands in the configuration."""

    name: str
    drive: Drive
    torque_limit: float
    kp: float
    kd: float
    idx_q: int
    idx_v: int
    pin_id: int
    gear_ratio: float | None = None
    torque_constant: float | None = None
    resolution: Mapping[str, float] | None = None

    @property
    def rigid(self) -> bool:
        """Whether the transmission has no compliance: theta = q, the motor's inertia is armature."""
        return math.isinf(self.drive.K)


@dataclass(frozen=True)
class Robot:
    """A nominal model: rigid body (pin.Model), actuated joints, effects it claims, and tolerances.

    `model` has the locked joints reduced (mass kept), continuous joints as unwrapped revolute ones, and
    gravity set. It is shared: never write on it.
    """

    name: str
    path: Path
    model: pin.Model
    joints: tuple[Joint, ...]
    rates: schema.Rates
    tolerance: schema.Tolerance
    effects: tuple[Planned, ...]
    file: schema.RobotFile
    urdf: Path

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    @property
    def gravity(self) -> np.ndarray:
        """(3,) gravity in the base frame [m/s^2]."""
        return np.array(self.model.gravity.linear)

    @property
    def floating(self) -> bool:
        return self.file.base == "floating"

    def joint(self, name: str) -> Joint:
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise unknown("joint", name, self.joint_names)

    def extended(self, effects: Iterable[Planned]) -> Robot:
        """The robot with these effects; one that it already lists (same effect, same joint) is replaced."""
        merged = {planned.key: planned for planned in self.effects}
        merged.update({planned.key: planned for planned in effects})
        return replace(self, effects=tuple(merged.values()))


def robots_folder() -> Path:
    """Where the shipped robots lie: package data of an installed wheel, else the checkout's root."""
    packaged = Path(__file__).parent / "robots"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent / "robots"


def shipped_robots() -> dict[str, Path]:
    """Shipped robots by name: every YAML under robots/ that is a robot file."""
    return {path.stem: path for path in sorted(robots_folder().glob("*/*.yaml"))}


def example_robot_data() -> Path:
    """The folder that package:// of example-robot-data resolves against."""
    return Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix" / "share"


def load(source: str | os.PathLike[str]) -> Robot:
    """A robot from a YAML file or the name of a shipped robot.

    Raises RobotError or UnknownNameError with what was expected, what came and what to do.
    """
    path = Path(source)
    if not path.suffix and not path.exists():
        shipped = shipped_robots()
        if path.name not in shipped:
            raise RobotError(f"no robot {str(source)!r}: give a YAML file or one of {', '.join(shipped)}")
        path = shipped[path.name]
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RobotError(f"robot file {path} does not exist; give the path of a robot YAML") from None
    except IsADirectoryError:
        raise RobotError(f"{path} is a folder; give the robot YAML inside it") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(f"{path} cannot be read as text: {error}") from None
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, RecursionError) as error:
        # PyYAML lets through what its constructors of numbers and dates stumble over
        line = " ".join(str(error).split())
        raise RobotError(f"{path} is not valid YAML: {line}") from None
    return build(schema.parse(raw, str(path)), path)


def build(file: schema.RobotFile, path: Path) -> Robot:
    """A robot from its checked file; `path` is what relative names resolve against."""
    where = str(path)
    urdf = _find_urdf(file, path)
    model = _load_model(file, urdf)
    joints = []
    for name, entry in file.joints.items():
        if name in file.lock:
            raise RobotError(f"{where}: joint {name!r} is both actuated and locked; keep it in one list")
        if not model.existJointName(name):
            valid = [n for n in model.names if n not in ("universe", "root_joint")]
            raise RobotError(f"{where}: {unknown('joint', name, valid)}")
        pin_joint = model.joints[model.getJointId(name)]
        if pin_joint.nq != 1 or pin_joint.nv != 1:
            raise RobotError(
                f"{where}: joint {name!r} has {pin_joint.nv} degrees of freedom; only single-axis joints can"
                " be actuated"
            )
        joints.append(
            Joint(
                name,
                Drive(entry.stiffness, entry.damping, entry.motor_inertia, entry.motor_damping),
                entry.torque_limit,
                entry.kp,
                entry.kd,
                pin_joint.idx_q,
                pin_joint.idx_v,
                int(model.getJointId(name)),
                entry.gear_ratio,
                entry.torque_constant,
                dict(entry.resolution),
            )
        )
    joints.sort(key=lambda joint: joint.idx_v)
    effects = _effects(file.effects, [joint.name for joint in joints], where)
    return Robot(file.name, path, model, tuple(joints), file.rates, file.tolerance, effects, file, urdf)


def _effects(entries: Sequence[Mapping[str, Any]], joints: Sequence[str], where: str) -> tuple[Planned, ...]:
    planned: list[Planned] = []
    for entry in entries:
        values = dict(entry)
        name = values.pop("effect", None)
        if name is None:
            raise RobotError(f"{where}: an entry of effects has no `effect` name: {dict(entry)!r}")
        joint, nominal = values.pop("joint", None), bool(values.pop("nominal", False))
        if joint is not None and joint not in joints:
            raise RobotError(f"{where}: effect {name}: {unknown('joint', joint, joints)}")
        try:
            item = plan(str(name), joint, values, nominal=nominal)
        except FlexJointError as error:
            raise RobotError(f"{where}: {error}") from None
        if any(item.key == other.key for other in planned):
            raise RobotError(f"{where}: {item} is listed twice; keep one entry")
        planned.append(item)
    return tuple(planned)


def _find_urdf(file: schema.RobotFile, path: Path) -> Path:
    name = file.urdf
    if name.startswith("package://"):
        rest = name.removeprefix("package://")
        folders = _package_dirs(file, path)
        for folder in folders:
            if (folder / rest).is_file():
                return folder / rest
        raise RobotError(
            f"{path}: URDF {name!r} not found under {', '.join(map(str, folders))}; add its folder to"
            " package_dirs"
        )
    found = path.parent / name
    if not found.is_file():
        raise RobotError(f"{path}: URDF {found} does not exist; `urdf` is relative to the YAML or package://")
    return found


def _package_dirs(file: schema.RobotFile, path: Path) -> list[Path]:
    own = [path.parent / folder for folder in file.package_dirs]
    return [*own, path.parent, example_robot_data(), example_robot_data() / "example-robot-data"]


def _load_model(file: schema.RobotFile, urdf: Path) -> pin.Model:
    try:
        text = _unwrap_continuous(urdf.read_text(encoding="utf-8"))
        root = pin.JointModelFreeFlyer() if file.base == "floating" else None
        model = pin.buildModelFromXML(text, root) if root else pin.buildModelFromXML(text)
    except (ElementTree.ParseError, ValueError, RuntimeError, UnicodeDecodeError) as error:
        raise RobotError(f"URDF {urdf} cannot be loaded: {' '.join(str(error).split())}") from None
    for name in file.lock:
        if not model.existJointName(name):
            raise RobotError(f"{urdf}: cannot lock {unknown('joint', name, list(model.names)[1:])}")
    if file.lock:
        held = pin.neutral(model)
        for name in file.lock:
            if name in file.initial:
                held[model.joints[model.getJointId(name)].idx_q] = file.initial[name]
        model = pin.buildReducedModel(model, [model.getJointId(name) for name in file.lock], held)
    model.gravity.linear = np.array(file.gravity)
    return model


def _unwrap_continuous(urdf: str) -> str:
    """Continuous joints as revolute ones without limits: a recording holds unwrapped angles."""
    tree = ElementTree.fromstring(urdf)
    for joint in tree.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = limit if limit is not None else ElementTree.SubElement(joint, "limit")
            limit.attrib.setdefault("effort", "1e9")
            limit.attrib.setdefault("velocity", "1e9")
            limit.attrib.update(lower="-1e9", upper="1e9")
    return ElementTree.tostring(tree, encoding="unicode")


def write(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Write the robot as YAML such that its URDF resolves from there; the file appears whole or not at all.

    The onset (`since`) of an effect belongs to a recording and is not written.
    """
    out = Path(path)
    raw = robot.file.model_dump(mode="python", exclude_unset=True)
    if not robot.file.urdf.startswith("package://"):
        raw["urdf"] = _relative(robot.urdf, out.parent)
    if robot.file.package_dirs:
        raw["package_dirs"] = [_relative(robot.path.parent / d, out.parent) for d in robot.file.package_dirs]
    entries = []
    for planned in robot.effects:
        values = {k: _plain(v) for k, v in planned.p._asdict().items() if v is not None}
        entry: dict[str, Any] = {"effect": planned.effect.name}
        if planned.joint is not None:
            entry["joint"] = planned.joint
        entry.update(values)
        if planned.nominal:
            entry["nominal"] = True
        entries.append(entry)
    if entries:
        raw["effects"] = entries
    write_text(out, yaml.safe_dump(_plain(raw), sort_keys=False, width=110))


def _relative(target: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return target.resolve().as_posix()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return float(value) if isinstance(value, np.floating) else value
