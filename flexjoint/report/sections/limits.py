"""What the diagnosis does not say: left unexplained, not excited, within tolerance; and what to do next."""

from __future__ import annotations

from dataclasses import astuple, dataclass

from flexjoint.diagnosis import Diagnosis
from flexjoint.report.material import Material
from flexjoint.report.wording import (
    capital,
    cause,
    clean,
    deviation,
    effect_name,
    percent,
    sentence,
    signal_name,
)


@dataclass(frozen=True)
class Tied:
    cause: str
    other: str


@dataclass(frozen=True)
class Left:
    joint: str
    balance: str
    share: str
    against: str


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
    left: tuple[Left, ...]
    untested: tuple[Untested, ...]
    within: tuple[Deviation, ...]
    next_experiment: str
    notes: tuple[str, ...]


def build(material: Material) -> LimitsSection | None:
    """None where nothing is open; what a refused recording needs stands in the verdict."""
    diagnosis = material.diagnosis
    sliding = material.robot.prismatic
    refused = diagnosis.verdict == "refused"
    section = LimitsSection(
        tuple(
            Tied(cause(f.effect, f.joint), cause(t.effect, t.joint))
            for f in diagnosis.findings
            for t in f.indistinguishable
        ),
        tuple(
            Left(clean(u.joint), clean(u.balance), percent(u.share), signal_name(u.against))
            for u in diagnosis.unexplained
        ),
        _untested(diagnosis, len(material.robot.joints)),
        tuple(
            Deviation(cause(w.effect, w.joint), deviation(w.effect, w.value, w.joint in sliding))
            for w in diagnosis.within_tolerance
        ),
        "" if refused else sentence(capital(diagnosis.next_experiment)),
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
