"""Candidates ranked by the error that each removes alone."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result.wording import cause, percent, values
from flexjoint.report.material import Material

ROWS = 12


@dataclass(frozen=True)
class Bar:
    cause: str
    values: str
    removes: str
    share: float  # in [0, 1]
    named: bool
    tied: bool


@dataclass(frozen=True)
class RankingSection:
    bars: tuple[Bar, ...]
    more: int


def build(material: Material) -> RankingSection | None:
    diagnosis = material.diagnosis
    ranked = sorted(diagnosis.ranking, key=lambda r: -r.removes)
    if not ranked:
        return None
    sliding = material.robot.prismatic
    named = {(f.effect, f.joint) for f in diagnosis.findings}
    tied = {(tie.effect, tie.joint) for f in diagnosis.findings for tie in f.indistinguishable}
    bars = tuple(
        Bar(
            cause(r.effect, r.joint),
            values(r.effect, r.values, r.joint in sliding),
            percent(r.removes),
            min(max(r.removes, 0.0), 1.0),
            (r.effect, r.joint) in named,
            (r.effect, r.joint) in tied,
        )
        for r in ranked[:ROWS]
    )
    return RankingSection(bars, max(0, len(ranked) - ROWS))
