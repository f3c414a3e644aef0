from __future__ import annotations

from flexjoint.diagnosis.regression.fit import refit_without
from flexjoint.diagnosis.search.criteria import contradicted
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class ContradictedByABalance(Check[Case]):
    name = "contradicted by a balance"
    stage = "balances"
    reason = "A true cause does not leave many times more in another balance."

    def limit(self, settings: Settings) -> float:
        return settings.search.cleared

    def objections(self, case: Case) -> tuple[Objection, ...]:
        best = case.selection.best
        denied = next((e for e in best.effects if contradicted(best, refit_without(best, e))), None)
        if denied is None:
            return ()
        why = "it makes the error of one balance smaller and that of another one many times larger"
        return (Objection(denied, self.limit(best.settings), why),)
