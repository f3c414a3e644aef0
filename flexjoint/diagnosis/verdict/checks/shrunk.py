from __future__ import annotations

from flexjoint.diagnosis.search.criteria import degenerate
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class ShrunkLaw(Check[Case]):
    name = "shrunk law"
    stage = "balances"
    reason = (
        "A law whose numbers lie at their bounds, or below what the sensors resolve, acts as a simpler one"
        " or as none."
    )

    def limit(self, settings: Settings) -> float:
        return settings.search.at_bound

    def objections(self, case: Case) -> tuple[Objection, ...]:
        best = case.selection.best
        shrunk = next((e for e in best.effects if degenerate(best.problem, e)), None)
        if shrunk is None:
            return ()
        return (
            Objection(
                shrunk,
                0.0,
                "its numbers are at their bounds or too small, so that it acts as a simpler law or as none",
                simpler=True,
            ),
        )
