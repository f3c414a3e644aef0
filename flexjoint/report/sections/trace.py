"""How the set of causes came about, one line a step."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result.wording import capital, clean, number, sentence
from flexjoint.report.material import Material


@dataclass(frozen=True)
class Line:
    stage: str
    action: str
    text: str
    evidence: str


def build(material: Material) -> tuple[Line, ...]:
    steps = getattr(material.diagnosis, "trace", ())
    return tuple(
        Line(clean(s.stage), clean(s.action), sentence(capital(s.text)), number(s.evidence)) for s in steps
    )
