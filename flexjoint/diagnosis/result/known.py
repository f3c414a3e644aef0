"""What is known of a machine from before: the causes of a diagnosis or of an extended robot, read back."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from flexjoint.core.errors import FlexJointError, RobotError, unknown
from flexjoint.core.files import read_text
from flexjoint.core.limits import DIAGNOSIS_FILE
from flexjoint.diagnosis.result.values import Remaining, Result, to_json
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, catalogue
from flexjoint.robot.robot import Robot, load

Key = tuple[str, str | None]
Made = TypeVar("Made")
ROBUST = "robust search"  # the stage of the steps that it took


@dataclass(frozen=True)
class Known:
    """A machine as it was. `causes` are those beyond the nominal `robot`, in total and always on; their `std`
    is empty where a source states none. `named` are those that were believed to be there. `remaining` is the
    torque error that was left by joint, empty where a source does not say; `level` the whitened variance that
    was left, in that of the sensors' noise, or None."""

    robot: Robot
    causes: tuple[Planned, ...]
    named: frozenset[Key]
    remaining: Mapping[str, Remaining]
    source: str
    level: float | None = None
    robust: bool = False

    @property
    def measured(self) -> bool:
        """Whether it was a recording that said so, with errors and with what it left."""
        return bool(self.remaining)


Against = Result | Robot | Mapping[str, Any] | str | os.PathLike[str]


def known_of(robot: Robot, against: Against | None) -> Known:
    """What `against` says of a nominal robot: a diagnosis, its JSON form, an extended robot, or a path.

    None: the robot is the extended one itself; what it lists that is not `nominal` are its causes.

    Raises FlexJointError where it is none of these, is of another robot, or was refused.
    """
    if against is None:
        nominal = tuple(e for e in robot.effects if e.nominal)
        return _of_robot(replace(robot, effects=nominal), robot)
    if isinstance(against, Result):
        return _of_diagnosis(to_json(against), robot, f"the diagnosis of {against.robot or robot.name}")
    if isinstance(against, Robot):
        return _of_robot(robot, against)
    if isinstance(against, Mapping):
        return _of_diagnosis(against, robot, "a diagnosis")
    if not isinstance(against, str | os.PathLike):
        raise FlexJointError(
            "check: expected a diagnosis, an extended robot or the path of one, got a"
            f" {type(against).__name__}; diagnose a recording first"
        )
    path = Path(against)
    if path.suffix in (".yaml", ".yml"):
        return _of_robot(robot, load(path))
    return parsed(path, robot, lambda content, nominal: _of_diagnosis(content, nominal, path.name))


def _of_robot(nominal: Robot, extended: Robot) -> Known:
    if nominal.joint_names != extended.joint_names:
        raise RobotError(
            f"{extended.name} has the joints {', '.join(extended.joint_names)}, and {nominal.name}"
            f" {', '.join(nominal.joint_names)}: give two files of one robot"
        )
    same = {e.identity for e in nominal.effects}
    laws = [e for e in extended.effects if not e.effect.is_cause]
    causes = tuple(
        replace(e, nominal=False) for e in extended.effects if e.identity not in same and e.effect.is_cause
    )
    nominal = nominal.extended(laws)  # a learned law has no number of its own to check
    return Known(nominal, causes, frozenset(e.key for e in causes), {}, extended.name)


def _of_diagnosis(content: Mapping[str, Any], robot: Robot, source: str) -> Known:
    if content["verdict"] == "refused":
        raise FlexJointError(
            f"{source} refused its recording, and says nothing of the machine; diagnose anew"
        )
    causes: list[Planned] = []
    named: set[Key] = set()
    for entry in content["findings"]:
        if entry.get("during"):  # a load that was picked and placed is no part of the machine
            continue
        std = {
            name: _numbers(given["std"])
            for name, given in entry["parameters"].items()
            if not isinstance(given, str)
        }
        own = [
            replace(e, std=std if e.effect.name == entry["effect"] else {}) for e in planned_of(robot, entry)
        ]
        causes += own
        if entry["probability"] >= USUAL.verdict.likely:
            named |= {e.key for e in own}
    remaining = {entry["joint"]: Remaining(**entry) for entry in content.get("remaining", [])}
    for joint in remaining:
        if joint not in robot.joint_names:
            raise unknown("joint", joint, robot.joint_names)
    level = content["level"]["after"] if "level" in content else None
    robust = any(step["stage"] == ROBUST for step in content.get("trace", []))
    return Known(robot, tuple(causes), frozenset(named), remaining, source, level, robust)


def _numbers(given: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in given) if isinstance(given, (list, tuple)) else (float(given),)


# ------------------------------------------------------------------ the JSON of a diagnosis
def parsed(path: Path, robot: Robot, make: Callable[[Mapping[str, Any], Robot], Made]) -> Made:
    """What `make` makes of a diagnosis's JSON (schema 1) and the robot.

    Raises FlexJointError: not such a file, or one of another robot or another version of the catalogue.
    """
    try:
        content = json.loads(read_text(path, DIAGNOSIS_FILE.file_bytes), parse_constant=_no_number)
    except FlexJointError:
        raise
    except RecursionError:
        raise FlexJointError(
            f"{path} is nested too deeply; give what `flexjoint diagnose --json` wrote"
        ) from None
    except OSError as error:
        raise FlexJointError(f"diagnosis {path} cannot be read: {error.strerror or error}") from None
    except (UnicodeDecodeError, ValueError) as error:
        raise FlexJointError(
            f"{path} is no JSON: {error}; give what `flexjoint diagnose --json` wrote"
        ) from None
    if not isinstance(content, dict) or content.get("schema") != 1 or "findings" not in content:
        raise FlexJointError(
            f"{path} is no diagnosis of schema 1; give what `flexjoint diagnose --json` wrote"
        )
    try:
        return make(content, robot)
    except FlexJointError as error:
        raise FlexJointError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FlexJointError(
            f"{path} is not as docs/reference/formats.md has it ({error!r}); diagnose anew"
        ) from None


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number of JSON")


def planned_of(robot: Robot, entry: Mapping[str, Any]) -> tuple[Planned, ...]:
    """A finding of the JSON as effects: on every joint where the finding is one of the robot, and with the
    change of what it is in the place of."""
    values: dict[str, Any] = {
        name: given if isinstance(given, str) else given["value"]
        for name, given in entry["parameters"].items()
    }
    out = []
    for effect, joint in keys_of(robot, entry["effect"], entry["joint"]):
        listed = next((e for e in robot.effects if e.key == (effect, joint)), None)
        total = dict(values)
        if listed is not None:  # parameters give the change
            numbers = [p.name for p in listed.effect.params if p.size == 1 and p.name in values]
            total.update({name: values[name] + float(listed.values[name]) for name in numbers})
        out.append(
            Planned.of(effect, joint, {k: tuple(v) if isinstance(v, list) else v for k, v in total.items()})
        )
    other = entry.get("instead_of")
    return (*out, *(planned_of(robot, other) if other is not None else ()))


def keys_of(robot: Robot, effect: str, joint: str | None) -> tuple[Key, ...]:
    """Where an effect of a diagnosis acts: on its joint, or on all where joints share it."""
    if effect not in catalogue():
        raise unknown("effect", effect, catalogue())
    if joint is not None and joint not in robot.joint_names:
        raise unknown("joint", joint, robot.joint_names)
    if joint is None and not catalogue()[effect].whole_robot:
        return tuple((effect, name) for name in robot.joint_names)
    return ((effect, joint),)
