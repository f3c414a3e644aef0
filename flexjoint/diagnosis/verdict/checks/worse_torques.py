from __future__ import annotations

from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection

EVEN = 0.5  # of its torque held by unseen data, with which the error is as large as without the cause


class WorseTorques(Check[StatedCase]):
    """Of several such causes the one that unseen data hold least goes first: the others are asked again."""

    name = "worse torques"
    stage = "findings"
    reason = (
        "A cause with which the torque error on data that the fit did not see is clearly larger than without"
        " it was fitted to what others leave."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.same

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        least = self.limit(case.selection.best.settings)
        below = [
            ((EVEN - f.removed.held) / f.removed.held_std, f)
            for f in case.named
            if f.removed is not None and f.removed.held is not None and f.removed.held_std
        ]
        worst = max(below, key=lambda one: one[0], default=None)
        if worst is None or worst[0] <= least:
            return ()
        why = "with it the torque error on data that the fit did not see is larger than without it"
        return (Objection(worst[1].planned, worst[0], why),)
