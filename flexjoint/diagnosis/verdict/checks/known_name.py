from __future__ import annotations

from dataclasses import replace

from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.search.criteria import at_own_level, repeated, score
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.edits import given_way
from flexjoint.diagnosis.verdict.ties import ties


class KnownName(Check[Case]):
    name = "known name"
    stage = "balances"
    reason = (
        "Of two effects with nearly the same trace, the better known one is reported where it fits as well."
    )
    once = True  # one exchange of names does not lead to another
    noted = False  # the other name stays among the ties

    def limit(self, settings: Settings) -> float:
        return settings.verdict.tie

    def objections(self, case: Case) -> tuple[Objection, ...]:
        selection, best = case.selection, case.selection.best
        again = repeated(best.effects, best.settings.search)
        shared = {*again, *again.values()}  # one cause of several joints has one name
        for k, planned in enumerate(best.effects):
            for rival in selection.rivals[k] if planned.effect.known_as and k not in shared else ():
                other = rival.effects[-1]
                known = other.joint == planned.joint and other.effect.name in planned.effect.known_as
                alone = len(rival.effects) == len(best.effects)
                if known and alone and ties(best, planned, [rival], selection.explains.get(planned.key)):
                    named = given_way(selection, k, rival, at_own_level(rival))
                    own = fit(named.best.problem, [*named.best.effects[:-1], planned])
                    last = tuple(sorted((*named.rivals[-1], own), key=score))
                    named = replace(named, rivals=(*named.rivals[:-1], last))
                    why = f"it is known as {other}, which fits as well"
                    return (Objection(planned, score(rival) - score(best), why, instead=named),)
        return ()
