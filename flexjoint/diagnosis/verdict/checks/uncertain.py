from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.regression.uncertainty import certainty, standard_errors
from flexjoint.diagnosis.search.criteria import makes_room, prices, repeated
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class UncertainSize(Check[Case]):
    name = "uncertain size"
    stage = "balances"
    reason = (
        "The numbers of a cause must differ from those of no effect by as many standard errors as its price"
        " in chi-square asks for; where the residual is not white, these errors are larger than the curvature"
        " of a fit suggests, and the energy that it explains is worth less. A cause that several"
        " joints have in common is one."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.sure

    def objections(self, case: Case) -> tuple[Objection, ...]:
        best = case.selection.best
        pairs = zip(best.effects, standard_errors(best), strict=True)
        certain = np.array([certainty(best, e, std) for e, std in pairs])
        price, again = np.array(prices(best)), repeated(best.effects, best.settings.search)
        for k in set(again.values()):  # one cause of several joints: they tell together how large it is
            joints = [k, *(other for other, first in again.items() if first == k)]
            certain[joints] = np.sqrt(np.sum(certain[joints] ** 2))
            price[joints] = price[k]
        certain[[makes_room(e, best) for e in best.effects]] = np.inf  # what it makes room for is asked
        needed = np.maximum(self.limit(best.settings), np.sqrt(price))
        worst = int(np.argmin(certain / needed))
        if certain[worst] >= needed[worst]:
            return ()
        why = f"its size is known to only {certain[worst]:.1f} standard errors, of {needed[worst]:.1f} needed"
        return (Objection(best.effects[worst], float(certain[worst]), why),)
