from __future__ import annotations

from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.unseen.torques import lowered, small_errors


class BesideItsSpecialCase(Check[StatedCase]):
    name = "beside its special case"
    stage = "findings"
    reason = (
        "A law beside one that it contains takes a part of that one's number; where it adds no more to it"
        " than small errors make, the simpler law is reported alone."
    )

    def limit(self, settings: Settings) -> float:
        """Times a background."""
        return settings.verdict.background_even

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        best = case.selection.best
        there = {(e.effect.name, e.joint) for e in best.effects}
        nested = [
            e
            for e in best.effects
            if e.joint is not None and any((name, e.joint) in there for name in e.effect.contains)
        ]
        if not nested:
            return ()
        left = {joint.joint: joint for joint in case.remaining}
        for planned in nested:
            own = left.get(str(planned.joint))
            if own is None:
                continue
            others = [e for e in best.effects if e is not planned]
            adds, least = lowered(best, others, own.joint), small_errors(own, best.settings.verdict)
            if adds < least:
                why = (
                    f"beside the simpler law that it contains it removes {adds:.2g} N m of the joint's torque"
                    " error, as small errors may make that have no name"
                )
                return (Objection(planned, adds, why),)
        return ()
