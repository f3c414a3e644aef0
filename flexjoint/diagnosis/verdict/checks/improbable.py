from __future__ import annotations

from flexjoint.diagnosis.result import Finding
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class Improbable(Check[StatedCase]):
    name = "improbable"
    stage = "findings"
    reason = "Where an alternative fits clearly better, something is wrong there, but not this."

    def limit(self, settings: Settings) -> float:
        return settings.verdict.probable

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        least = self.limit(case.selection.best.settings)
        why = "it explains part of the error, but an alternative fits clearly better"
        return tuple(
            Objection(f.planned, against_alternatives(f), why)
            for f in case.named
            if against_alternatives(f) < least
        )


def against_alternatives(finding: Finding) -> float:
    """Probability of a finding and its ties together, whatever it leaves unexplained."""
    return finding.probability / finding.reliability
