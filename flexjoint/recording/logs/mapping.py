"""The mapping of a log to the channels of a recording: a YAML file, as a schema.

docs/reference/formats.md has every key.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from flexjoint.core.errors import FlexJointError, RecordingError, RobotError, unknown
from flexjoint.core.files import read_text
from flexjoint.core.limits import ROBOT_FILE
from flexjoint.recording.logs.units import UNITS_OF, dimension
from flexjoint.recording.messages import shown
from flexjoint.recording.table import UNITS
from flexjoint.robot.reading.yaml_file import NO_YAML, values_of
from flexjoint.robot.schema import Strict

Numbers = float | tuple[float, ...] | dict[str, float]  # of all joints, in order, or by joint


class ChannelEntry(Strict):
    """Where the samples of one channel stand, and what is done to them."""

    source: str | tuple[str, ...] = Field(alias="from")  # a signal, or one column a joint
    unit: str | None = None
    side: Literal["link", "motor"] | None = None
    gear_ratio: Numbers | None = None  # rotor turns per turn of the joint
    torque_constant: Numbers | None = None  # N m/A at the rotor
    sign: Numbers | None = None  # 1 or -1
    offset: Numbers | None = None  # added last, in SI units at the link
    joints: tuple[str, ...] | None = None  # of the columns, in their order

    @field_validator("gear_ratio", "torque_constant", "offset")
    @classmethod
    def _finite(cls, given: Numbers | None) -> Numbers | None:
        for value in _each(given):
            if not math.isfinite(value):
                raise ValueError("expected finite numbers")
        return given

    @field_validator("gear_ratio", "torque_constant")
    @classmethod
    def _not_zero(cls, given: Numbers | None) -> Numbers | None:
        if any(value == 0.0 for value in _each(given)):
            raise ValueError("expected numbers other than 0")
        return given

    @field_validator("sign")
    @classmethod
    def _one(cls, given: Numbers | None) -> Numbers | None:
        if any(value not in (1.0, -1.0) for value in _each(given)):
            raise ValueError("expected 1 or -1")
        return given


class MappingFile(Strict):
    """The whole file; every key may be left out where the format says it."""

    time: str | None = None  # the signal that holds the stamps
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    rate: float | None = Field(None, gt=0, le=1e6)  # Hz, of a log without stamps
    joints: tuple[str, ...] | None = Field(None, min_length=1)  # names in the order of the log's columns
    rename: dict[str, str] = Field(default_factory=dict)  # the log's names of joints: those of the robot
    angles: Literal["rad", "deg", "rev"] | None = None  # unit of angles that state none
    encoder: Literal["link", "motor"] | None = None  # that of positions of which the format does not say
    gear_ratio: Numbers | None = None
    torque_constant: Numbers | None = None
    episode: int | None = Field(None, ge=0)  # of a LeRobot dataset
    channels: dict[str, ChannelEntry] = Field(default_factory=dict)

    _finite = field_validator("gear_ratio", "torque_constant")(ChannelEntry._finite.__func__)  # type: ignore[attr-defined]
    _not_zero = field_validator("gear_ratio", "torque_constant")(ChannelEntry._not_zero.__func__)  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, raw: Any) -> Any:
        """`q: actual_q` stands for `q: {from: actual_q}`."""
        if not isinstance(raw, dict) or not isinstance(raw.get("channels"), dict):
            return raw
        short = {
            key: {"from": entry} if isinstance(entry, str | list | tuple) else entry
            for key, entry in raw["channels"].items()
        }
        return {**raw, "channels": short}


EMPTY = MappingFile()  # type: ignore[call-arg]


def read(source: str | os.PathLike[str]) -> MappingFile:
    """The mapping of a YAML file; RecordingError says what is wrong with it."""
    path = Path(source)
    try:
        raw = values_of(read_text(path, ROBOT_FILE.file_bytes))
    except FileNotFoundError:
        raise RecordingError(
            f"mapping {path} does not exist; docs/reference/formats.md has an example"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"mapping {path} cannot be read as text: {error}") from None
    except RobotError as error:  # beyond the limits of a robot file
        raise RecordingError(f"mapping {path}: {error}") from None
    except FlexJointError as error:
        raise RecordingError(f"mapping {error}") from None
    except NO_YAML as error:
        raise RecordingError(f"mapping {path} is not valid YAML: {' '.join(str(error).split())}") from None
    return parse(raw, f"mapping {path}")


def parse(raw: Any, where: str = "mapping") -> MappingFile:
    """The checked mapping; RecordingError names the key, what was expected and what came."""
    if not isinstance(raw, Mapping):
        raise RecordingError(f"{where}: expected a mapping with `channels`, got {type(raw).__name__}")
    try:
        file = MappingFile.model_validate(dict(raw))
    except ValidationError as error:
        raise _readable(error, where) from None
    for channel, entry in file.channels.items():
        if channel not in UNITS:
            raise RecordingError(f"{where}: channels: {unknown('channel', shown(channel), UNITS)}")
        valid = UNITS_OF[dimension(channel)]
        if entry.unit is not None and entry.unit not in valid:
            raise RecordingError(f"{where}: channels.{channel}: {unknown('unit', shown(entry.unit), valid)}")
    for names, key in (
        (file.joints, "joints"),
        *((e.joints, f"channels.{c}.joints") for c, e in file.channels.items()),
    ):
        if names is not None and len(set(names)) != len(names):
            raise RecordingError(f"{where}: {key}: a joint stands twice; name each once")
    if file.time is not None and file.rate is not None:
        raise RecordingError(f"{where}: both time and rate; a log with stamps needs no rate, keep one")
    return file


def stated(file: MappingFile, **given: Any) -> MappingFile:
    """The mapping with what the command line states; an option that contradicts the file is refused."""
    changes = {key: value for key, value in given.items() if value is not None}
    for key, value in changes.items():
        before = getattr(file, key)
        if before is not None and before != value:
            raise RecordingError(
                f"the mapping states {key}: {before}, and the command line {value}; keep one of them"
            )
    return parse(file.model_dump(by_alias=True, exclude_unset=True) | changes, "the command line")


def by_joint(given: Numbers | None, joints: Sequence[str], key: str, where: str) -> list[float] | None:
    """One number a joint; RecordingError where they do not fit the joints."""
    if given is None:
        return None
    if isinstance(given, dict):
        missing = [joint for joint in joints if joint not in given]
        if missing:
            raise RecordingError(f"{where}: {key} has no number for {shown(missing[0])}; give one a joint")
        return [float(given[joint]) for joint in joints]
    if isinstance(given, tuple):
        if len(given) != len(joints):
            raise RecordingError(
                f"{where}: {key}: expected {len(joints)} numbers, one a joint"
                f" ({', '.join(map(shown, joints))}),"
                f" got {len(given)}"
            )
        return [float(value) for value in given]
    return [float(given)] * len(joints)


def _each(given: Numbers | None) -> list[float]:
    if given is None:
        return []
    if isinstance(given, dict):
        return list(given.values())
    return list(given) if isinstance(given, tuple) else [given]


def _readable(error: ValidationError, where: str) -> FlexJointError:
    first = error.errors()[0]
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        inside = f" in {'.'.join(map(shown, path[:-1]))}" if len(path) > 1 else ""
        kind = ChannelEntry if len(path) > 1 else MappingFile
        keys = [item.alias or name for name, item in kind.model_fields.items()]
        return RecordingError(f"{where}{inside}: {unknown('key', shown(path[-1]), keys)}")
    place = ".".join(shown(part) for part in path[:3])
    if first["type"] == "missing":
        return RecordingError(f"{where}: {place} is missing; name the log's signal there")
    message = first["msg"].removeprefix("Value error, ")
    return RecordingError(f"{where}: {place}: {message}, got {shown(repr(first.get('input')))}")
