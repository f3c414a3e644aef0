from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Estimation, Finding
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.checks._numbers import correlation, distance, fitted_number
from flexjoint.diagnosis.verdict.unseen.torques import joint_left, unseen_problem
from flexjoint.effects import Parameter, Planned, numbers_beyond


class FinerThanKnown(Check[StatedCase]):
    name = "finer than known"
    stage = "findings"
    reason = "Where the data do not support the extra parameters of a law, the simpler law is reported."

    def limit(self, settings: Settings) -> float:
        """[standard errors] as many as the price of a further number in chi-square asks for."""
        return max(settings.verdict.sure, settings.search.price_number**0.5)

    def objections(self, case: StatedCase) -> tuple[Objection, ...]:
        best = case.selection.best
        why = "the data do not support its extra parameters"
        unknown = (f for f in finer(best, *case.estimated) if not leaves_less(best, f.planned))
        # one at a time: beside the law in its place, the others have other numbers
        return tuple(
            Objection(f.planned, self.limit(best.settings), why, simpler=True) for f in islice(unknown, 1)
        )


def leaves_less(best: Fit, planned: Planned) -> bool:
    """Whether every simpler law in the place of one leaves a twentieth more of its joint, or of one of its
    balances, on blocks of time that no fit saw. Numbers that trade places (a static friction with the speed
    at which it fades) may each be uncertain where the law is not: then it is asked what it explains."""
    if planned.joint is None or not planned.effect.contains:
        return False
    seen = unseen_problem(best.problem)
    others = [e for e in best.effects if e.key != planned.key]
    law = _left(seen, [*others, planned], planned, planned.joint)
    within = best.settings.verdict.better_without
    for simple in (one for name in planned.effect.contains for one in planned.special_cases(name)):
        if any(e.key == simple.key for e in others):
            continue
        simpler = _left(seen, [*others, simple], planned, planned.joint)
        if all(now >= within * then for now, then in zip(law, simpler, strict=True)):
            return False
    return True


def _left(seen: Problem, effects: Sequence[Planned], changed: Planned, joint: str) -> tuple[float, ...]:
    """[N m] of a joint, and of each of its balances, where the fit did not look."""
    total, balances = joint_left(fit(seen, effects, changed=changed), joint)
    return total, *balances


def finer(best: Fit, found: Sequence[Finding], estimation: Estimation | None) -> tuple[Finding, ...]:
    """Findings of a law that contains a simpler one, where none of the numbers that it adds differs from none
    by enough standard errors; where only the added ones do (a static friction without Coulomb friction); or
    where two numbers of one kind (two levels) do not differ from each other."""
    return tuple(f for f in found if estimation is not None and _finer(best, f, estimation))


def _finer(best: Fit, finding: Finding, estimation: Estimation) -> bool:
    sure = FinerThanKnown().limit(best.settings)
    effect = finding.planned.effect
    if effect.alike:
        one, other = (param for param in effect.params if param.name in effect.alike)
        (x, std), (y, other_std) = (fitted_number(finding, param) for param in (one, other))
        tight = correlation(finding, estimation, [one, other])[0, 1]
        spread = std**2 + other_std**2 - 2.0 * tight * std * other_std
        return bool((x - y)[0] ** 2 < sure**2 * spread[0])
    shapes = [p for p in effect.params if p.null is None and p.size == 1 and not p.wraps]
    if effect.contains and any(_any_shape(finding, p) for p in shapes):
        return True
    for name in effect.contains:
        added = numbers_beyond(effect, name)
        parts = [added, [p for p in effect.nulls if p not in added]] if added else []
        if any(all(distance(best, finding, p, estimation, ()) < sure for p in part) for part in parts):
            return True
    return False


def _any_shape(finding: Finding, shape: Parameter) -> bool:
    """Whether a law's shape may as well be at its bound, where the law is a simpler one."""
    value, std = fitted_number(finding, shape)
    return bool(value[0] - std[0] <= shape.low or value[0] + std[0] >= shape.high)
