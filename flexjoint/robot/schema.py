"""The robot YAML as a schema (docs/reference/formats.md): what may stand in it, with units and defaults."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from flexjoint.core.errors import FlexJointError, RobotError, unknown
from flexjoint.core.limits import ROBOT_FILE
from flexjoint.core.messages import shown
from flexjoint.robot.reading.yaml_file import check_values

RIGID = "; .inf if the joint is rigid, else that of its spring [N m/rad]"


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)


class Rates(Strict):
    """Sampling rates [Hz]: f_s of the physics, f_c of the controller."""

    physics: float = Field(1000.0, ge=ROBOT_FILE.slowest_rate, le=ROBOT_FILE.fastest_rate)
    control: float = Field(1000.0, ge=ROBOT_FILE.slowest_rate, le=ROBOT_FILE.fastest_rate)


# [m] of centres of mass on the joint's origin: a description that puts one there states none. Those of a UR5
# in two simulators differ by 3 mm, and a flange at a link's end moves one by as much
COM_AT_ORIGIN = 0.005


class Tolerance(Strict):
    """How far the nominal numbers are trusted: relative standard deviations; centres of mass in metres an
    axis, by default `inertial` of their distance from the joint, at it COM_AT_ORIGIN; torque as a share of
    RMS."""

    inertial: float = Field(0.02, ge=0, le=1)
    com: float | None = Field(None, ge=0, le=1)
    stiffness: float = Field(0.02, ge=0, le=1)
    damping: float = Field(0.1, ge=0, le=10)
    torque: float = Field(0.01, ge=0, le=1)


class JointEntry(Strict):
    """One actuated joint, link-referred."""

    stiffness: float = Field(gt=0)  # N m/rad; .inf is rigid
    damping: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    motor_inertia: float = Field(ge=0, lt=float("inf"))  # kg m^2; 0 at a rigid joint: the links have it all
    motor_damping: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    torque_limit: float = Field(float("inf"), gt=0)  # N m
    kp: float = Field(0.0, ge=0, lt=float("inf"))  # N m/rad
    kd: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    gear_ratio: float | None = Field(None, gt=0)
    torque_constant: float | None = Field(None, gt=0)  # N m/A at the motor
    controller: dict[str, Any] | str | None = None
    resolution: dict[str, Annotated[float, Field(ge=0)]] = Field(default_factory=dict)


class Section(Strict):
    """A part of the robot that can be left out: sub-trees of the URDF, each named by its first joint.

    Without roots it is the anchor and always there. `parts` names single sub-trees, instead of `roots`.
    """

    roots: tuple[str, ...] = ()
    parts: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    supports: bool = False  # a floating base is fixed when all that support it are left out

    @property
    def all_roots(self) -> tuple[str, ...]:
        return (*self.roots, *(root for roots in self.parts.values() for root in roots))


class ContactEntry(Strict):
    """A place that touches the ground; numbers that are not given take their default
    (docs/howto/contact.md)."""

    frame: str
    radius: float = Field(0.0, ge=0, lt=float("inf"))  # m
    rolls: str | None = None  # the joint of a wheel
    stiffness: float = Field(2e5, gt=0, lt=float("inf"))  # N/m
    dissipation: float = Field(2.0, ge=0, lt=float("inf"))  # s/m
    friction: float = Field(0.8, ge=0, lt=float("inf"))
    tangential_stiffness: float = Field(2e5, gt=0, lt=float("inf"))  # N/m
    tangential_damping: float = Field(1e3, ge=0, lt=float("inf"))  # N s/m


class CouplingEntry(Strict):
    """Motors that several joints share: each motor's speed by the joints' speeds, seen at its joint."""

    joints: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]  # row: motor of the joint in that place; column: joint


class Preset(Strict):
    """Numbers that replace those of the file: of joints, and the rates."""

    joints: dict[str, dict[str, Any]] = Field(default_factory=dict)
    rates: dict[str, Any] = Field(default_factory=dict)
    note: str = ""


class RobotFile(Strict):
    """The whole file; effects are checked against the catalogue by `flexjoint.robot.robot`."""

    name: str
    urdf: str | None = None
    mjcf: str | None = None
    sdf: str | None = None
    base: Literal["fixed", "floating"] = "fixed"
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    rates: Rates = Rates()  # type: ignore[call-arg]
    lock: tuple[str, ...] = ()
    tolerance: Tolerance = Tolerance()  # type: ignore[call-arg]
    joints: dict[str, JointEntry] = Field(min_length=1)
    couplings: tuple[CouplingEntry, ...] = ()
    effects: tuple[dict[str, Any], ...] = ()
    sources: dict[str, Any] = Field(default_factory=dict)
    offsets: Literal["per_recording"] | None = None
    presets: dict[str, Preset] = Field(default_factory=dict)
    sections: dict[str, Section] = Field(default_factory=dict)
    spawn: tuple[str, ...] | None = None  # sections that are there; None: all
    contacts: tuple[ContactEntry, ...] = ()  # of a floating base with the ground at height 0
    ground: Literal["compliant", "rigid"] = "compliant"
    initial: dict[str, float] = Field(default_factory=dict)
    poses: dict[str, dict[str, float]] = Field(default_factory=dict)
    continuous: tuple[str, ...] = ()
    sensing_delay: float = Field(0.0, ge=0, le=0.1)
    package_dirs: tuple[str, ...] = ()

    @property
    def description(self) -> tuple[str, str]:
        """Kind (urdf, mjcf or sdf) and name of the description."""
        given = {"urdf": self.urdf, "mjcf": self.mjcf, "sdf": self.sdf}
        return next((kind, name) for kind, name in given.items() if name is not None)


POSITIVE = ("stiffness", "motor_inertia", "torque_limit", "gear_ratio", "torque_constant")
_SINGLE: dict[str, type[Strict]] = {"rates": Rates, "tolerance": Tolerance}
_NAMED: dict[str, type[Strict]] = {
    "joints": JointEntry,
    "sections": Section,
    "presets": Preset,
    "contacts": ContactEntry,
    "couplings": CouplingEntry,
}


def parse(raw: Any, where: str, described: bool = True) -> RobotFile:
    """The checked file; raises RobotError naming the key, what was expected and what came.

    `described`: whether it has to name the robot's description.
    """
    if not isinstance(raw, dict):
        raise RobotError(f"{where}: expected a mapping with name, urdf and joints, got {type(raw).__name__}")
    check_values(raw, where)
    try:
        file = RobotFile.model_validate(raw)
    except ValidationError as error:
        raise _readable(error, raw, where) from None
    check_values(file.model_dump(), where)  # numbers that stood as texts, such as 1e20 without a point
    given = [kind for kind in ("urdf", "mjcf", "sdf") if getattr(file, kind) is not None]
    if described and len(given) != 1:
        came = " and ".join(given) or "none of them"
        raise RobotError(f"{where}: expected one of urdf, mjcf and sdf, the robot's description; got {came}")
    _check_joints(file, where)
    _check_lists(file, where)
    return file


def _check_joints(file: RobotFile, where: str) -> None:
    for name, joint in file.joints.items():
        for key in POSITIVE:
            number = getattr(joint, key)
            if number is not None and 0.0 < number < ROBOT_FILE.positive:
                raise RobotError(
                    f"{where}: joints.{shown(name)}.{key}: {number:g} is below {ROBOT_FILE.positive:g}, the"
                    " least that is read (docs/reference/limits.md); check the unit"
                )
        if joint.motor_inertia == 0.0 and joint.stiffness < float("inf"):
            raise RobotError(
                f"{where}: joints.{name}: a motor behind a spring of {joint.stiffness:g} N m/rad needs its"
                " inertia; give motor_inertia > 0 [kg m^2], or .inf as the stiffness of a rigid joint"
            )


def _check_lists(file: RobotFile, where: str) -> None:
    for key in ("lock", "continuous", "spawn"):
        listed = getattr(file, key) or ()
        for name, count in Counter(listed).items():
            if count > 1:
                raise RobotError(f"{where}: {key}: '{shown(name)}' is listed twice; keep one")
    for name, section in file.sections.items():
        if section.roots and section.parts:
            raise RobotError(f"{where}: section {name} has both roots and parts; keep one of them")
    seen: set[str] = set()
    for contact in file.contacts:
        if contact.frame in seen:
            raise RobotError(f"{where}: contacts: frame {contact.frame} is listed twice; keep one entry")
        seen.add(contact.frame)
        if contact.rolls is not None and contact.radius == 0.0:
            raise RobotError(
                f"{where}: contacts: {contact.frame} rolls with {contact.rolls} and has no radius; give the"
                " wheel's radius [m]"
            )


def _readable(error: ValidationError, raw: dict[str, Any], where: str) -> FlexJointError:
    first = error.errors()[0]
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        kind: type[Strict] = RobotFile
        if len(path) > 1:
            kind = (_NAMED if len(path) > 2 else _SINGLE).get(path[0], RobotFile)
        inside = f" in {'.'.join(path[:-1])}" if len(path) > 1 else ""
        return RobotError(
            f"{where}{inside}: {unknown('key', path[-1], kind.model_fields)}{_elsewhere(path[-1])}"
        )
    hint = RIGID if path[0] == "joints" and path[-1] == "stiffness" else ""
    if first["type"] == "missing":
        return RobotError(f"{where}: {'.'.join(path)} is missing; every robot needs it{hint}")
    return RobotError(
        f"{where}: {'.'.join(path)}: {first['msg']}, got {shown(repr(first.get('input')))}{hint}"
    )


def _elsewhere(key: str) -> str:
    """Where a key would be known, if that is in another place of a robot file."""
    if key in RobotFile.model_fields:
        return f"; '{key}' stands at the top of the file"
    if key in JointEntry.model_fields:
        return f"; '{key}' stands in an entry of joints"
    return ""
