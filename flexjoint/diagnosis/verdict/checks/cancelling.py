from __future__ import annotations

from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.unseen.torques import spoiling

WHY = "it cancels with nominal numbers that are off, and leaves far more of its joint beside them as they are"


class CancelsWithNumbers(Check[StatedCase]):
    """Of causes that are not likely: a likely one may act beside numbers that are off within their
    tolerances."""

    name = "cancels with numbers"
    stage = "findings"
    reason = (
        "A wrong cause may cancel with nominal numbers that are all off; with it, and these as they are, a"
        " model is far worse than without."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.spoilt

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        settings = case.selection.best.settings
        worse = [
            (spoiling(case.unseen, k), e)
            for k, e in enumerate(case.selection.best.effects)
            if not any(f.planned is e and f.probability >= settings.verdict.likely for f in case.named)
        ]
        most, planned = max(worse, key=lambda one: one[0], default=(0.0, None))
        if planned is None or most <= self.limit(settings):
            return ()
        return (Objection(planned, most, WHY),)
