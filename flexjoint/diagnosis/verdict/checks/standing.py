from __future__ import annotations

import numpy as np

from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection


class FrictionAtRest(Check[StatedCase]):
    name = "friction at rest"
    stage = "findings"
    reason = (
        "Any friction that is large enough holds a joint that never moves, and so does a brake, a lock, or an"
        " encoder that is dead: such a friction is not reported."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.at_rest

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        best = case.selection.best
        readings, names = best.problem.readings, best.problem.robot.joint_names
        found = []
        for planned in best.effects:
            if planned.joint is None or not planned.effect.overrides("level"):
                continue
            j = names.index(planned.joint)
            sides = [x[j][np.isfinite(x[j])] for x in (readings.q, readings.theta)]
            travel = max(float(np.ptp(x)) for x in sides if x.size)
            if travel <= self.limit(best.settings):
                why = f"{planned.joint} never moves in this recording, so that any friction would hold it"
                found.append(Objection(planned, travel, why))
        return tuple(found)
