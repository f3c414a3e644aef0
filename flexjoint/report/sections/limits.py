"""What the diagnosis does not say: what is tied, not excited, within tolerance; and its notes."""

from __future__ import annotations

from dataclasses import astuple, dataclass

from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.wording import (
    capital,
    cause,
    clean,
    deviation,
    effect_name,
    sentence,
)
from flexjoint.report.material import Material


@dataclass(frozen=True)
class Tied:
    cause: str
    other: str


@dataclass(frozen=True)
class Untested:
    effect: str
    joints: str


@dataclass(frozen=True)
class Deviation:
    cause: str
    value: str


@dataclass(frozen=True)
class LimitsSection:
    tied: tuple[Tied, ...]
    untested: tuple[Untested, ...]
    within: tuple[Deviation, ...]
    notes: tuple[str, ...]


def build(material: Material) -> LimitsSection | None:
    """None where nothing is open; what is left and what to do next stand in the verdict."""
    diagnosis = material.diagnosis
    sliding = material.robot.prismatic
    section = LimitsSection(
        tuple(
            Tied(cause(f.effect, f.joint), cause(t.effect, t.joint))
            for f in diagnosis.findings
            for t in f.indistinguishable
        ),
        _untested(diagnosis, len(material.robot.joints)),
        tuple(
            Deviation(cause(w.effect, w.joint), deviation(w.effect, w.value, w.joint in sliding))
            for w in diagnosis.within_tolerance
        ),
        tuple(sentence(capital(note)) for note in diagnosis.notes),
    )
    return section if any(astuple(section)) else None


def _untested(diagnosis: Diagnosis, joint_count: int) -> tuple[Untested, ...]:
    """By effect, so that a robot of thirty joints stays readable."""
    joints: dict[str, list[str]] = {}
    for effect, joint in diagnosis.not_excited:
        joints.setdefault(effect, []).extend([] if joint is None else [clean(joint)])
    out = []
    for effect, names in joints.items():
        everywhere = len(names) in (0, joint_count) and joint_count > 1
        out.append(Untested(capital(effect_name(effect)), "whole robot" if everywhere else ", ".join(names)))
    return tuple(out)
