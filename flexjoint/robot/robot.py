"""Robot = one YAML beside its URDF: the nominal model, with how far its numbers are trusted."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import yaml

from flexjoint.core.errors import FlexJointError, RobotError, RobotWarning, unknown
from flexjoint.core.files import write_text
from flexjoint.core.messages import shown
from flexjoint.effects import Drive, Planned
from flexjoint.robot import couplings as robot_couplings
from flexjoint.robot import description as robot_description
from flexjoint.robot import ready_made, schema
from flexjoint.robot import sections as robot_sections
from flexjoint.robot.contacts import GroundContact, joint_axis
from flexjoint.robot.couplings import Coupling
from flexjoint.robot.numbers import Numbers, as_file, floats, single_axis
from flexjoint.robot.reading import yaml_file

NEGLIGIBLE = 1e-9  # of the largest inertia: what rounding leaves


@dataclass(frozen=True, kw_only=True)
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
        """Whether the transmission has no compliance: theta = q, the motor's inertia is armature. A stiffness
        that is an expression is a finite one."""
        return isinstance(self.drive.K, (int, float)) and math.isinf(self.drive.K)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A nominal model: rigid body (pin.Model), actuated joints, effects it claims, and tolerances.

    `model` has the locked joints reduced (mass kept), continuous joints as unwrapped revolute ones, and
    gravity set. It is shared: never write on it. `urdf` is the file of the description (URDF, MJCF or SDF),
    `sections` those that are there, `disabled` those that were asked for and hang on one that is not.
    """

    name: str
    path: Path | None  # of the robot file; None of a robot made of a pin.Model
    model: pin.Model
    joints: tuple[Joint, ...]
    rates: schema.Rates
    tolerance: schema.Tolerance
    effects: tuple[Planned, ...]
    file: schema.RobotFile
    urdf: Path | None
    description: robot_description.Description | None = None
    sections: tuple[str, ...] = ()
    disabled: tuple[str, ...] = ()
    preset: str | None = None
    contacts: tuple[GroundContact, ...] = ()  # with the ground, of a floating base
    own_inertial: np.ndarray | None = None  # (bodies, 10) without a known payload, which has no tolerance
    ground: str = "compliant"  # or rigid: what their contact is
    couplings: tuple[Coupling, ...] = ()  # of motors with several joints

    @classmethod
    def from_model(
        cls,
        model: pin.Model,
        joints: Sequence[str] | None = None,
        *,
        name: str | None = None,
        stiffness: Numbers | None = None,
        damping: Numbers | None = None,
        motor_inertia: Numbers | None = None,
        motor_damping: Numbers | None = None,
        torque_limit: Numbers | None = None,
        kp: Numbers | None = None,
        kd: Numbers | None = None,
        gear_ratio: Numbers | None = None,
        torque_constant: Numbers | None = None,
        rates: Mapping[str, float] | None = None,
        tolerance: Mapping[str, float] | None = None,
        effects: Iterable[Planned] = (),
    ) -> Robot:
        """A robot of a pin.Model, which is copied; its gravity and its armatures are kept.

        Numbers of joints are link-referred and in SI units (docs/reference/formats.md): one for all, a
        mapping by joint, or one for each in the order of `joints`. A joint without a number has the default.

        Args:
            joints: the actuated joints; default: all, which must have a single axis then.
            name: default: the model's.
            stiffness: default: rigid.
            damping, motor_damping, kp, kd: default 0.
            motor_inertia: default 0, which only a rigid joint may have.
            torque_limit: default: none.
            gear_ratio, torque_constant [N m/A at the motor]: default: none; of recordings of currents.
            rates: `physics` and `control` [Hz].
            tolerance: `inertial`, `com`, `stiffness`, `damping` and `torque`, see docs/reference/formats.md.
            effects: that the model claims.

        Raises RobotError or UnknownNameError with what was expected, what came and what to do.
        """
        if not isinstance(model, pin.Model):
            advice = (
                "give its .model"
                if isinstance(getattr(model, "model", None), pin.Model)
                else "read a file with load_robot(path)"
            )
            raise RobotError(f"Robot.from_model: expected a pin.Model, got {_kind(model)}; {advice}")
        drives = {
            "stiffness": stiffness,
            "damping": damping,
            "motor_inertia": motor_inertia,
            "motor_damping": motor_damping,
            "torque_limit": torque_limit,
            "kp": kp,
            "kd": kd,
            "gear_ratio": gear_ratio,
            "torque_constant": torque_constant,
        }
        title = name or str(model.name) or "robot"
        raw = as_file(title, model, joints, drives, rates, tolerance)
        file = schema.parse({**raw, "base": "floating" if floats(model) else "fixed"}, title, described=False)
        own = model.copy()
        made = sorted((_joint(own, *item, title) for item in file.joints.items()), key=lambda j: j.idx_v)
        robot = cls(
            name=title,
            path=None,
            model=own,
            joints=tuple(made),
            rates=file.rates,
            tolerance=file.tolerance,
            effects=(),
            file=file,
            urdf=None,
        )
        return robot.extended(effects)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the robot as YAML from which its description resolves, whole or not at all.

        docs/reference/formats.md has the keys. The onset (`since`) of an effect belongs to a recording and is
        not written, nor is an effect that comes and goes (`switches`). Raises RobotError of a robot that was
        made of a pin.Model, which no file could name.
        """
        write(self, path)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Of the actuated joints, in the order of every (n,) array."""
        return tuple(joint.name for joint in self.joints)

    @property
    def prismatic(self) -> frozenset[str]:
        """Names of the actuated joints that slide: their numbers are in m, N and kg (see `units`)."""
        sliding = (joint for joint in self.joints if joint_axis(self.model, joint.name) is None)
        return frozenset(joint.name for joint in sliding)

    @property
    def gravity(self) -> np.ndarray:
        """(3,) gravity in the base frame [m/s^2]."""
        return np.array(self.model.gravity.linear)

    @property
    def floating(self) -> bool:
        """Whether its base moves freely."""
        return self.file.base == "floating"

    def joint(self, name: str) -> Joint:
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise unknown("joint", name, self.joint_names)

    @property
    def mass(self) -> float:
        """Of all bodies, what is fixed to the base included [kg] (pin.computeTotalMass leaves that out)."""
        return float(sum(inertia.mass for inertia in self.model.inertias))

    @property
    def poses(self) -> tuple[str, ...]:
        """Names that `configuration` takes."""
        return tuple(dict.fromkeys(["initial", *self.file.poses]))

    def configuration(self, pose: str = "initial") -> np.ndarray:
        """(nq,) a named pose of the robot file, in Pinocchio's order; a floating base is at the origin.

        A joint that the pose does not name is where `initial` puts it, or at 0. Raises UnknownNameError.
        """
        if pose not in self.poses:
            raise unknown("pose", pose, self.poses)
        q = pin.neutral(self.model)
        for name, value in {**self.file.initial, **self.file.poses.get(pose, {})}.items():
            if self.model.existJointName(name):
                q[self.model.joints[self.model.getJointId(name)].idx_q] = value
        return q

    def extended(self, effects: Iterable[Planned]) -> Robot:
        """The robot with these effects; one that it already lists (same effect, same joint) is replaced."""
        merged = {planned.key: planned for planned in self.effects}
        merged.update({planned.key: planned for planned in effects})
        return replace(self, effects=tuple(merged.values()))


def robots_folder() -> Path:
    """Where the shipped robots lie: package data of an installed wheel, else the checkout's root."""
    package = Path(__file__).parents[1]
    shipped = package / "shipped"
    return shipped if shipped.is_dir() else package.parent / "robots"


def shipped_robots() -> dict[str, Path]:
    """Shipped robots by name: every YAML under robots/ that is a robot file."""
    return {path.stem: path for path in sorted(robots_folder().glob("*/*.yaml"))}


def load(
    source: str | os.PathLike[str],
    sections: Sequence[str] | None = None,
    preset: str | None = None,
    grounded: bool = False,
    *,
    joints: Sequence[str] | None = None,
    base: Literal["fixed", "floating"] | None = None,
    stiffness: Numbers | None = None,
    damping: Numbers | None = None,
    motor_inertia: Numbers | None = None,
    motor_damping: Numbers | None = None,
    torque_limit: Numbers | None = None,
    kp: Numbers | None = None,
    kd: Numbers | None = None,
    gear_ratio: Numbers | None = None,
    torque_constant: Numbers | None = None,
    rates: Mapping[str, float] | None = None,
    tolerance: Mapping[str, float] | None = None,
) -> Robot:
    """A robot from a robot file (YAML), the name of a shipped robot, or a URDF, MJCF or SDF.

    Args:
        source: path of a robot file, a name of `shipped_robots`, or a description: a path that ends in .urdf,
            .xml, .mjcf or .sdf, package://... of example-robot-data, or a name of the package
            robot_descriptions (panda_description), which downloads it.
        sections: what of the robot is there, by the names in its file; default: what the file spawns, or all.
            What hangs on a section that is left out is left out too (`Robot.disabled`).
        preset: a set of numbers of the file; default: those under `joints`.
        grounded: fix a floating base.
        joints: of a description, as in `Robot.from_model`, like stiffness and all that follow; a robot file
            states its own. Joints are rigid by default.
        base: of a description; default: fixed, of an MJCF what its first body has.

    Raises RobotError or UnknownNameError with what was expected, what came and what to do.
    """
    drives = {
        "stiffness": stiffness,
        "damping": damping,
        "motor_inertia": motor_inertia,
        "motor_damping": motor_damping,
        "torque_limit": torque_limit,
        "kp": kp,
        "kd": kd,
        "gear_ratio": gear_ratio,
        "torque_constant": torque_constant,
    }
    if not isinstance(source, str | os.PathLike):
        raise RobotError(f"load_robot: expected a path or a name, got {_kind(source)}; {_instead(source)}")
    if isinstance(source, str) and ready_made.is_name(source) and not Path(source).exists():
        source = f"{ready_made.SCHEME}{source}"
    if robot_description.is_one(source):
        if sections is not None or preset is not None or grounded:
            raise RobotError(
                f"{source} is a description; sections, presets and grounding belong to a robot file"
            )
        return _described(str(source), joints, base, drives, rates, tolerance)
    path = Path(source)
    given = {**drives, "joints": joints, "base": base, "rates": rates, "tolerance": tolerance}
    stated = [key for key, value in given.items() if value is not None]
    if stated:
        raise RobotError(
            f"{path}: a robot file states its own {', '.join(stated)}; change them there, or load its URDF"
        )
    if not path.suffix and not path.exists():
        shipped = shipped_robots()
        if path.name not in shipped:
            raise RobotError(f"no robot {str(source)!r}: give a YAML file or one of {', '.join(shipped)}")
        path = shipped[path.name]
    raw = yaml_file.read(path)
    file = schema.parse(raw, str(path))
    if preset is not None:
        file = schema.parse(robot_sections.with_preset(raw, preset, str(path)), str(path))
    chosen: dict[str, Any] = {}
    if grounded:
        chosen["base"] = "fixed"
    if sections is not None:
        chosen["spawn"] = tuple(sections)
    return replace(build(file.model_copy(update=chosen), path), preset=preset)


def expect(given: object, verb: str) -> Robot:
    """The robot that was handed to a function; RobotError says what to call where it is something else."""
    if isinstance(given, Robot):
        return given
    raise RobotError(f"{verb}: expected a robot first, got {_kind(given)}; {_instead(given)}")


def _kind(given: object) -> str:
    """What was handed in, as a message names it."""
    if isinstance(given, str | os.PathLike):
        return f"the text {str(given)!r}"
    if isinstance(given, pin.Model):
        return "a pin.Model"
    return f"a {type(given).__name__}"


def _instead(given: object) -> str:
    """What to call with what was handed in where a robot was expected."""
    if isinstance(given, str | os.PathLike):
        return f"load it with load_robot({str(given)!r})"
    if isinstance(given, pin.Model):
        return "make a robot of it with Robot.from_model(model)"
    if isinstance(given, Robot):
        return "it is loaded already"
    return "make one with load_robot(path or name)"


def _described(
    source: str,
    joints: Sequence[str] | None,
    base: Literal["fixed", "floating"] | None,
    drives: Mapping[str, Numbers | None],
    rates: Mapping[str, float] | None,
    tolerance: Mapping[str, float] | None,
) -> Robot:
    """A robot of a description alone. Its robot file, which does not exist, would lie beside it."""
    package = source.startswith(robot_description.NAMED)
    path = Path(Path(source).stem + ".yaml") if package else Path(source).with_suffix(".yaml")
    kind = robot_description.kind_of(source, path)
    raw: dict[str, Any] = {"name": path.stem, kind: source if package else Path(source).name}
    bare = schema.parse({**raw, "joints": {"": {"stiffness": math.inf, "motor_inertia": 0.0}}}, source)
    description = robot_description.read(bare, path)
    if base is None:
        base = "floating" if robot_description.has_free_joint(description) else "fixed"
    model = robot_description.model(description, base == "floating")
    tied = _tied(model, description.follows, joints, source)
    if tied:
        model = pin.buildReducedModel(model, [model.getJointId(name) for name in tied], pin.neutral(model))
        raw["lock"] = tied
    raw.update(as_file(path.stem, model, joints, drives, rates, tolerance), base=base)
    return build(schema.parse(raw, source), path)


def build(file: schema.RobotFile, path: Path) -> Robot:
    """A robot from its checked file; `path` is what relative names resolve against."""
    where = str(path)
    description = robot_description.read(file, path)
    whole = robot_description.model(description, file.base == "floating")
    known = [name for name in whole.names if name not in ("universe", "root_joint")]
    whole_frames = [frame.name for frame in whole.frames]
    choice = robot_sections.choose(file, description.text, file.spawn, where)
    if file.sections:
        description = replace(description, text=choice.urdf)
        file = file.model_copy(update={"base": "floating" if choice.floating else "fixed"})
        whole = robot_description.model(description, choice.floating)
    file = _followers_held(file, whole, description.follows, where)
    model = _lock(whole, file, known, path)
    for line in description.odd:
        warnings.warn(line, RobotWarning, stacklevel=2)
    _check_inertia(model, where)
    joints = []
    for name, entry in file.joints.items():
        if name in file.lock:
            raise RobotError(f"{where}: joint {name!r} is both actuated and locked; keep it in one list")
        if name not in known:
            raise RobotError(f"{where}: {unknown('joint', name, known)}")
        if model.existJointName(name):  # else its section is left out
            joints.append(_joint(model, name, entry, where))
    joints.sort(key=lambda joint: joint.idx_v)
    for joint in joints:
        if joint.drive.B > 0.0:  # the armature of an MJCF is the same rotor: it counts once
            model.armature[joint.idx_v] = 0.0
    names = [joint.name for joint in joints]
    absent = [name for name in file.joints if name not in names]
    effects = _effects([e for e in file.effects if e.get("joint") not in absent], names, where)
    couplings = robot_couplings.read(file.couplings, names, [joint.rigid for joint in joints], absent, where)
    return Robot(
        name=file.name,
        path=path,
        model=model,
        joints=tuple(joints),
        rates=file.rates,
        tolerance=file.tolerance,
        effects=effects,
        file=file,
        urdf=description.path,
        description=description,
        sections=choice.spawned,
        disabled=choice.disabled,
        contacts=_contacts(model, file, (whole_frames, known), where),
        ground=file.ground,
        couplings=couplings,
    )


def _tied(
    model: pin.Model, follows: Mapping[str, str], joints: Sequence[str] | None, where: str
) -> list[str]:
    """The joints of a description alone that follow others: they are held, with a warning."""
    tied = [name for name in follows if model.existJointName(name)]
    actuated = [name for name in tied if joints is not None and name in joints]
    if actuated:
        raise RobotError(
            f"{where}: joint {_tie(actuated, follows)}, which is not modelled; do not actuate it"
        )
    if tied:
        warnings.warn(
            f"{where}: joint {_tie(tied, follows)}, which is not modelled: it is held at 0, mass kept",
            RobotWarning,
            stacklevel=3,
        )
    return tied


def _tie(tied: Sequence[str], follows: Mapping[str, str]) -> str:
    more = f" (and {len(tied) - 1} more follow others)" if len(tied) > 1 else ""
    return f"{shown(tied[0])} follows {shown(follows[tied[0]])}{more} by a mimic or equality"


def _followers_held(
    file: schema.RobotFile, whole: pin.Model, follows: Mapping[str, str], where: str
) -> schema.RobotFile:
    """The file with the joints locked that the description ties to others and that nothing drives: they would
    swing freely. One that the file drives is a joint of its own. A warning says either."""
    tied = [name for name in follows if whole.existJointName(name) and name not in file.lock]
    for names, done in (
        ([name for name in tied if name in file.joints], "it moves on its own, as the robot file drives it"),
        (
            [name for name in tied if name not in file.joints],
            "it is held at 0, mass kept, as under `lock`",
        ),
    ):
        if names:
            said = f"{where}: joint {_tie(names, follows)}, which is not modelled: {done}"
            warnings.warn(said, RobotWarning, stacklevel=3)
    held = [name for name in tied if name not in file.joints]
    return file.model_copy(update={"lock": (*file.lock, *held)})


def _check_inertia(model: pin.Model, where: str) -> None:
    """No joint may have a negative inertia: it would run away from every torque."""
    own = np.array([*(body.inertia for body in model.inertias)])
    if not (
        np.all(np.isfinite(own)) and all(np.isfinite(p.homogeneous).all() for p in model.jointPlacements)
    ):
        raise RobotError(
            f"{where}: the description gives places or inertias that are not finite; check its numbers"
        )
    inertia = pin.crba(model, model.createData(), pin.neutral(model))
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        least = float(np.min(np.diag(inertia)[joint.idx_v : joint.idx_v + joint.nv], initial=0.0))
        if least < -NEGLIGIBLE * float(np.max(np.abs(inertia))):
            raise RobotError(
                f"{where}: joint {shown(name)} moves an inertia of {least:g}, which is negative; check the"
                " masses and inertias of the links that it carries"
            )


def _contacts(
    model: pin.Model, file: schema.RobotFile, known: tuple[Collection[str], Collection[str]], where: str
) -> tuple[GroundContact, ...]:
    """The contacts that are there; a wheel whose section is left out leaves its frame as a point.

    `known` are the frames and joints of the whole description.
    """
    frames, joints = known
    found = []
    for entry in file.contacts:
        if entry.frame not in frames:
            raise RobotError(f"{where}: contacts: {unknown('frame', entry.frame, frames)}")
        numbers, wheel = entry.model_dump(), entry.rolls
        if wheel is not None:
            if wheel not in joints:
                raise RobotError(f"{where}: contacts: {entry.frame}: {unknown('joint', wheel, joints)}")
            if not model.existJointName(wheel):
                numbers.update(rolls=None, radius=0.0)
            elif joint_axis(model, wheel) is None:
                raise RobotError(
                    f"{where}: contacts: {entry.frame}: joint {wheel} does not turn about one axis; name the"
                    " wheel's"
                )
        if model.existFrame(entry.frame) and file.base == "floating":
            found.append(GroundContact(**numbers))
    return tuple(found)


def _joint(model: pin.Model, name: str, entry: schema.JointEntry, where: str) -> Joint:
    pin_joint = single_axis(model, name, where)
    return Joint(
        name=name,
        drive=Drive(entry.stiffness, entry.damping, entry.motor_inertia, entry.motor_damping),
        torque_limit=entry.torque_limit,
        kp=entry.kp,
        kd=entry.kd,
        idx_q=pin_joint.idx_q,
        idx_v=pin_joint.idx_v,
        pin_id=int(model.getJointId(name)),
        gear_ratio=entry.gear_ratio,
        torque_constant=entry.torque_constant,
        resolution=dict(entry.resolution),
    )


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
            item = Planned.of(str(name), joint, values, nominal=nominal)
        except FlexJointError as error:
            raise RobotError(f"{where}: {error}") from None
        if any(item.key == other.key for other in planned):
            raise RobotError(f"{where}: {item} is listed twice; keep one entry")
        planned.append(item)
    return tuple(planned)


def _lock(full: pin.Model, file: schema.RobotFile, known: Collection[str], path: Path) -> pin.Model:
    """The model with the locked joints reduced, mass kept, and gravity set."""
    for name in file.lock:
        if name not in known:
            raise RobotError(f"{path}: cannot lock {unknown('joint', name, known)}")
    model = full
    locked = [name for name in file.lock if full.existJointName(name)]
    if locked:
        place = pin.neutral(full)
        for name in locked:
            if name in file.initial:
                place[full.joints[full.getJointId(name)].idx_q] = file.initial[name]
        model = pin.buildReducedModel(full, [full.getJointId(name) for name in locked], place)
    model.gravity.linear = np.array(file.gravity)
    return model


def write(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Write the robot as YAML such that its URDF resolves from there; the file appears whole or not at all.

    The onset (`since`) of an effect belongs to a recording and is not written; nor is an effect that comes
    and goes (`switches`), as a load that is picked and placed: the file is of the robot without it.
    """
    out = Path(path)
    if robot.urdf is None or robot.path is None:
        raise RobotError(
            f"{robot.name} was made of a pin.Model and has no description that a robot file could name; load"
            " its URDF or MJCF with load_robot to write it"
        )
    raw = robot.file.model_dump(mode="python", exclude_unset=True)
    kind, name = robot.file.description
    if not name.startswith(robot_description.NAMED):
        raw[kind] = _relative(robot.urdf, out.parent)
    if robot.file.package_dirs:
        raw["package_dirs"] = [_relative(robot.path.parent / d, out.parent) for d in robot.file.package_dirs]
    entries = []
    for planned in robot.effects:
        if planned.switches:
            continue
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
