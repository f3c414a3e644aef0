"""Learned laws: each drawn with its band, what it resembles, and what to look at."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result import learned
from flexjoint.diagnosis.result.wording import capital, clean, sentence
from flexjoint.report import plots
from flexjoint.report.material import Material


@dataclass(frozen=True)
class LawView:
    title: str
    image: plots.Image
    lines: tuple[str, ...]


@dataclass(frozen=True)
class LearnedSection:
    title: str
    intro: str
    laws: tuple[LawView, ...]
    simulation: str
    notes: tuple[str, ...]


def build(material: Material) -> LearnedSection | None:
    """None where no law was asked for."""
    found, joints = material.diagnosis.learned, material.joints
    if found is None:
        return None
    laws = []
    for law in found.laws:
        name = capital(learned.name_of(law, joints))
        lines = (learned.removed_line(law, joints), *learned.likeness_lines(law), learned.advice_line(law))
        laws.append(LawView(name, plots.law(law, joints.signal(law.signal), name), lines))
    return LearnedSection(
        learned.TITLE,
        learned.NO_CAUSE if laws else learned.NOTHING,
        tuple(laws),
        learned.simulation_line(found),
        tuple(sentence(capital(clean(note))) for note in found.notes),
    )
