from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.regression.uncertainty import certainty, standard_errors
from flexjoint.diagnosis.result import Gain
from flexjoint.diagnosis.search.criteria import at_own_level, degenerate, score
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import SimulatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.edits import given_way, without
from flexjoint.effects import Planned

WHY = "it lowers a balance, but makes the simulation of its joint worse on held-out data"


class WorseSimulation(Check[SimulatedCase]):
    """A cause must make the simulation worse on held-out data, and on the whole recording with the nominal
    numbers corrected within their tolerances: a small true cause need not improve a simulation whose
    stiffness is 2 % wrong, nor one that acts only for a while what the other blocks tell of it. The best
    alternative that does not make the simulation worse takes the place of the cause."""

    name = "worse simulation"
    stage = "simulation"
    reason = "A wrong cause can make a balance smaller, but rarely improves the simulation of its joint."

    def limit(self, settings: Settings) -> float:
        return settings.verdict.worse

    def objections(self, case: SimulatedCase) -> tuple[Objection, ...]:
        selection, measured, best = case.selection, case.measured, case.selection.best
        if measured is None:
            return ()
        limits = best.settings.verdict
        worse = [e for e in best.effects if e.joint and _worsened(measured, e.joint, limits.worse)]
        if worse:
            fair = _compared(case, best, fair=True)
            worse = [e for e in worse if fair is not None and _worsened(fair, str(e.joint), limits.worse)]
        if not worse:
            return ()
        dropped = worse[-1]
        before = _size(measured, dropped.joint, "before")
        evidence = _size(measured, dropped.joint) / max(before, 1e-300)
        instead = _instead(case, dropped)
        if instead is not None:
            return (Objection(dropped, evidence, WHY, instead=instead),)
        trial = without(selection, dropped)
        again = _compared(case, trial.best)
        with_it = _size(measured, dropped.joint)
        if again is None or _size(again, dropped.joint) > limits.better_without * with_it:
            return ()
        return (Objection(dropped, evidence, WHY, instead=trial),)


def _instead(case: SimulatedCase, dropped: Planned) -> Selection | None:
    """The selection with the best alternative to a cause that does not make the simulation worse."""
    selection, best = case.selection, case.selection.best
    limits = best.settings.verdict
    k = best.effects.index(dropped)
    bare = score(refit_without(best, dropped))
    for rival in selection.rivals[k][: limits.alternatives_tried]:
        joints = {j for j in (dropped.joint, rival.effects[-1].joint) if j is not None}
        if score(rival) >= bare or len(rival.effects) > len(best.effects):
            continue
        there = at_own_level(rival)
        named = there.effects[-1]
        if degenerate(there.problem, named):
            continue
        if certainty(there, named, standard_errors(there)[-1]) < limits.sure:
            continue
        fair = _compared(case, there, fair=True)
        if fair is not None and not any(_worsened(fair, joint, limits.worse) for joint in joints):
            again = _compared(case, there)
            return None if again is None else given_way(selection, k, rival, there)
    return None


def _compared(case: SimulatedCase, best: Fit, fair: bool = False) -> Gain | None:
    """A fit's simulation on held-out data; `fair`: the models with and without causes are compared on the
    whole recording with the nominal numbers corrected, each as its own fit has them."""
    nothing, known = (case.selection.nothing, None) if fair else (None, case.measured)
    return case.gain(best, known, nothing)


def _worsened(gain: Gain, joint: str, limit: float) -> bool:
    """Whether the error of a joint's simulation is more than so many times that of the nominal model."""
    return _size(gain, joint) > limit * _size(gain, joint, "before")


def _size(gain: Gain, joint: str | None, when: str = "after") -> float:
    """Mean NRMSE of the positions of a joint."""
    table = (gain.after if when == "after" else gain.before)["nrmse"]
    sizes = [table[key] for key in (f"q.{joint}", f"theta.{joint}") if key in table]
    return float(np.mean(sizes)) if sizes else 0.0
