from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.regression.uncertainty import certainty, standard_errors
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class UncertainSize(Check[Case]):
    name = "uncertain size"
    stage = "balances"
    reason = (
        "The numbers of a cause must differ by several standard errors from those of no effect; where the"
        " residual is not white, these errors are larger than the curvature of a fit suggests."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.sure

    def objections(self, case: Case) -> tuple[Objection, ...]:
        best = case.selection.best
        pairs = zip(best.effects, standard_errors(best), strict=True)
        certain = [certainty(best, e, std) for e, std in pairs]
        worst = int(np.argmin(certain))
        if certain[worst] >= self.limit(best.settings):
            return ()
        why = f"its size is known to only {certain[worst]:.1f} standard errors"
        return (Objection(best.effects[worst], certain[worst], why),)
