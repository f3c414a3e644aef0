from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.search.criteria import known_sizes, makes_room
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
        certain, needed = known_sizes(best, self.limit(best.settings))
        certain[[makes_room(e, best) for e in best.effects]] = np.inf  # what it makes room for is asked
        worst = int(np.argmin(certain / needed))
        if certain[worst] >= needed[worst]:
            return ()
        why = f"its size is known to only {certain[worst]:.1f} standard errors, of {needed[worst]:.1f} needed"
        return (Objection(best.effects[worst], float(certain[worst]), why),)
