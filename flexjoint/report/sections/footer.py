"""What the diagnosis was made of, and how to read the page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import PurePath

from flexjoint.diagnosis.result.wording import clean, number, percent, unit_of, with_unit
from flexjoint.report.material import Material

NOISE_ROWS = 30


@dataclass(frozen=True)
class Fact:
    name: str
    value: str


@dataclass(frozen=True)
class Noise:
    joint: str
    balance: str
    value: str


@dataclass(frozen=True)
class FooterSection:
    robot: str
    recording: str
    version: str
    rigid: bool
    facts: tuple[Fact, ...]
    noise: tuple[Noise, ...]


def build(material: Material) -> FooterSection:
    recording = PurePath(material.recording.name.replace("\\", "/")).name or material.recording.name
    sliding = material.robot.prismatic
    return FooterSection(
        clean(material.robot.name),
        clean(recording),
        installed_version(),
        material.joints.rigid,
        tuple(_facts(material)),
        tuple(
            Noise(
                clean(view.joint),
                clean(view.balance),
                with_unit(number(view.noise), unit_of("tau_t", view.joint in sliding)),
            )
            for view in material.diagnosis.residuals[:NOISE_ROWS]
        ),
    )


def installed_version() -> str:
    try:
        return version("flexjoint")
    except PackageNotFoundError:  # run from a checkout
        return "(not installed)"


def _facts(material: Material) -> list[Fact]:
    robot, recording, diagnosis = material.robot, material.recording, material.diagnosis
    tolerance = robot.tolerance
    measured = tuple(dict.fromkeys(channel for channel, _ in recording.columns))
    facts = [
        Fact(
            "Robot", f"{clean(robot.name)}, {len(robot.joints)} actuated joint{'s'[: len(robot.joints) != 1]}"
        ),
        Fact(
            "Recording",
            f"{recording.duration:.4g} s, {recording.time.size} samples, typically every"
            f" {1000 * recording.period:.3g} ms",
        ),
        Fact("Channels", ", ".join(measured)),
        Fact("Control rate", f"{robot.rates.control:g} Hz"),
        Fact(
            "Tolerance of the nominal numbers",
            f"inertial {percent(tolerance.inertial)},"
            + ("" if material.joints.rigid else f" stiffness {percent(tolerance.stiffness)},")
            + f" damping {percent(tolerance.damping)}, torque {percent(tolerance.torque)} of its RMS",
        ),
    ]
    if diagnosis.residuals:
        before, after = (number(e) if math.isfinite(e) else "unknown" for e in diagnosis.energy)
        facts.append(Fact("Residual energy per sample", f"{before} before, {after} after (1 is noise alone)"))
    if robot.effects:
        facts.append(Fact("Effects of the nominal model", ", ".join(clean(str(p)) for p in robot.effects)))
    return facts
