"""The robot YAML as a schema (docs/formats.md): what may stand in it, with units and defaults."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from flexjoint.errors import FlexJointError, RobotError, unknown


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)


class Rates(Strict):
    """Sampling rates [Hz]: f_s of the physics, f_c of the controller."""

    physics: float = Field(1000.0, gt=0, le=1e6)
    control: float = Field(1000.0, gt=0, le=1e6)


class Tolerance(Strict):
    """How far the nominal numbers are trusted: relative standard deviations; torque as a share of RMS."""

    inertial: float = Field(0.02, ge=0, le=1)
    stiffness: float = Field(0.02, ge=0, le=1)
    damping: float = Field(0.1, ge=0, le=10)
    torque: float = Field(0.01, ge=0, le=1)


class JointEntry(Strict):
    """One actuated joint, link-referred."""

    stiffness: float = Field(gt=0)  # N m/rad; .inf is rigid
    damping: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    motor_inertia: float = Field(gt=0, lt=float("inf"))  # kg m^2
    motor_damping: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    torque_limit: float = Field(float("inf"), gt=0)  # N m
    kp: float = Field(0.0, ge=0, lt=float("inf"))  # N m/rad
    kd: float = Field(0.0, ge=0, lt=float("inf"))  # N m s/rad
    gear_ratio: float | None = Field(None, gt=0)
    torque_constant: float | None = Field(None, gt=0)  # N m/A at the motor
    controller: dict[str, Any] | str | None = None
    resolution: dict[str, float] = Field(default_factory=dict)


class RobotFile(Strict):
    """The whole file; effects are checked against the catalogue by `flexjoint.robot`."""

    name: str
    urdf: str
    base: Literal["fixed", "floating"] = "fixed"
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    rates: Rates = Rates()  # type: ignore[call-arg]
    lock: tuple[str, ...] = ()
    tolerance: Tolerance = Tolerance()  # type: ignore[call-arg]
    joints: dict[str, JointEntry] = Field(min_length=1)
    effects: tuple[dict[str, Any], ...] = ()
    sources: dict[str, Any] = Field(default_factory=dict)
    offsets: Literal["per_recording"] | None = None
    presets: dict[str, Any] = Field(default_factory=dict)
    sections: dict[str, Any] = Field(default_factory=dict)
    contacts: Any = None
    initial: dict[str, float] = Field(default_factory=dict)
    sensing_delay: float = Field(0.0, ge=0, le=0.1)
    package_dirs: tuple[str, ...] = ()


_SECTIONS: dict[str, type[Strict]] = {"rates": Rates, "tolerance": Tolerance}


def parse(raw: Any, where: str) -> RobotFile:
    """The checked file; raises RobotError naming the key, what was expected and what came."""
    if not isinstance(raw, dict):
        raise RobotError(f"{where}: expected a mapping with name, urdf and joints, got {type(raw).__name__}")
    try:
        return RobotFile.model_validate(raw)
    except ValidationError as error:
        raise _readable(error, raw, where) from None


def _readable(error: ValidationError, raw: dict[str, Any], where: str) -> FlexJointError:
    first = error.errors()[0]
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        kind: type[Strict] = RobotFile
        if len(path) > 1:
            kind = JointEntry if path[0] == "joints" else _SECTIONS.get(path[0], RobotFile)
        inside = f" in {'.'.join(path[:-1])}" if len(path) > 1 else ""
        return RobotError(f"{where}{inside}: {unknown('key', path[-1], kind.model_fields)}")
    if first["type"] == "missing":
        return RobotError(f"{where}: {'.'.join(path)} is missing; every robot needs it")
    return RobotError(f"{where}: {'.'.join(path)}: {first['msg']}, got {first.get('input')!r}")
