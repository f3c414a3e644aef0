from __future__ import annotations

from collections.abc import Iterator, Sequence

from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.result import Estimation, Finding
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.checks._numbers import distance


class AbsentOnTheSimulation(Check[StatedCase]):
    name = "absent on the simulation"
    stage = "findings"
    reason = (
        "A cause whose refined numbers do not differ clearly from those of no effect is not reported: where a"
        " friction sticks, a balance can show a smaller standard error than the simulation confirms."
    )

    def limit(self, settings: Settings) -> float:
        return settings.verdict.sure

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        best = case.selection.best
        limit, why = (
            self.limit(best.settings),
            "on the simulation its numbers do not differ clearly from those of no effect",
        )
        return tuple(
            Objection(f.planned, furthest, why)
            for f, furthest in _distances(best, *case.estimated)
            if furthest < limit
        )


def _distances(
    best: Fit, found: Sequence[Finding], estimation: Estimation | None
) -> Iterator[tuple[Finding, float]]:
    """The findings that were refined on the simulation, each with the distance from absence, in standard
    errors, of the number that is furthest from it. Shape parameters are fixed: they mean nothing without the
    law."""
    if estimation is None or estimation.method != "output_error":
        return
    for f in found:
        shapes = [p for p in f.planned.effect.params if p.null is None]
        distances = [distance(best, f, param, estimation, shapes) for param in f.planned.effect.nulls]
        if distances:
            yield f, max(distances)
