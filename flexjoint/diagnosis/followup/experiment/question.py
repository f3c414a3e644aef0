"""What the next recording has to decide: read from a diagnosis, or everything when there is none."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexjoint.core.errors import FlexJointError
from flexjoint.core.limits import DIAGNOSIS_FILE, RECORDING
from flexjoint.diagnosis.followup.experiment.evidence import Key, Sensors
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.result.known import keys_of, parsed, planned_of
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned
from flexjoint.recording.table import MEASURED
from flexjoint.robot.robot import Robot


@dataclass(frozen=True)
class Tie:
    """A cause as found, and another that explains the same: which one is it?"""

    truth: tuple[Planned, ...]  # one effect, on every joint that shares it
    rival: tuple[Key, ...]
    beside: tuple[Planned, ...]  # the other findings, which both share

    @property
    def names(self) -> tuple[str, str]:
        return named([e.key for e in self.truth]), named(self.rival)


@dataclass(frozen=True)
class Question:
    """Ties to break, or (none) the whole catalogue to be excited on top of `found`; and the sensors."""

    ties: tuple[Tie, ...]
    found: tuple[Planned, ...]
    sensors: Sensors


def named(keys: Sequence[Key]) -> str:
    """`torque_gain on elbow`, `torque_delay on all joints`."""
    effect, joint = keys[0]
    place = "all joints" if len(keys) > 1 else joint
    return f"{effect} on {place}" if place else effect


def without_diagnosis(robot: Robot) -> Question:
    """Excite everything, with all sensors at the noise that is usual (docs/howto/planning_experiments.md)."""
    return Question((), (), Sensors({(c, j): usual_noise(robot, c, j) for c, j in _every_sensor(robot)}))


def question_of(given: Question | Diagnosis | str | os.PathLike[str] | None, robot: Robot) -> Question:
    """What was handed in as a question; see `read`. Raises FlexJointError where it is none."""
    if given is None:
        return without_diagnosis(robot)
    if isinstance(given, Question):
        return given
    if isinstance(given, Diagnosis):
        return _question(to_json(given), robot)
    if isinstance(given, str | os.PathLike):
        return read(Path(given), robot)
    raise FlexJointError(
        f"plan: expected a diagnosis, or the path of one as JSON, got a {type(given).__name__}; diagnose a"
        " recording first, or leave it out to excite the whole catalogue"
    )


def read(path: Path, robot: Robot) -> Question:
    """The question of a diagnosis (schema 1).

    Raises FlexJointError: not such a file, or one of another robot or another version of the catalogue.
    """
    return parsed(path, robot, _question)


def _question(content: Mapping[str, Any], robot: Robot) -> Question:
    if content.get("verdict") == "refused":
        return without_diagnosis(robot)
    if len(content["findings"]) > DIAGNOSIS_FILE.findings:
        raise FlexJointError(f"more than {DIAGNOSIS_FILE.findings} causes; diagnose anew")
    findings = [(entry, planned_of(robot, entry)) for entry in content["findings"]]
    ties = []
    for entry, truth in findings:
        beside = tuple(e for other, planned in findings if other is not entry for e in planned)
        taken = {e.key for e in beside}
        for tie in entry["indistinguishable"]:
            rival = keys_of(robot, tie["effect"], tie["joint"])
            if not taken & set(rival):
                ties.append(Tie(truth, rival, beside))
    found = tuple(e for _, planned in findings for e in planned)
    return Question(tuple(ties), found, _sensors(content, robot))


def _sensors(content: Mapping[str, Any], robot: Robot) -> Sensors:
    """What was recorded and how well, as the comparison of the diagnosis tells; else everything."""
    floor = ((content.get("comparison") or {}).get("noise_floor") or {}).get("rms") or {}
    noise = {}
    for name, value in floor.items():
        channel, _, joint = name.partition(".")
        if channel in MEASURED and joint in robot.joint_names:
            known = value is not None and 0.0 < float(value) < RECORDING.value
            noise[channel, joint] = float(value) if known else usual_noise(robot, channel, joint)
    return Sensors(noise) if noise else without_diagnosis(robot).sensors


def _every_sensor(robot: Robot) -> list[tuple[str, str]]:
    channels = {
        j.name: [c for c in MEASURED if not (j.rigid and c in ("theta", "dtheta", "tau_t"))]
        for j in robot.joints
    }
    return [(channel, name) for name, own in channels.items() for channel in own]


def usual_noise(robot: Robot, channel: str, joint: str) -> float:
    """Standard deviation of a sensor of which nothing is known: usual values, or its resolution."""
    own, plan = robot.joint(joint), USUAL.plan
    limit = own.torque_limit if own.torque_limit < 1e9 else plan.usual_limit
    usual = {
        "q": plan.encoder_noise,
        "theta": plan.encoder_noise,
        "dq": plan.speed_noise,
        "dtheta": plan.speed_noise,
        "tau_t": plan.torque_noise * limit,
    }[channel]
    return max(usual, (own.resolution or {}).get(channel, 0.0) / 12.0**0.5)
