"""Errors of the numbers of planted causes before and after their refinement on the simulation, and how often
their standard errors cover the truth: python -m study.refined [--first 1] [--every 4].

The causes are given by name, as the diagnosis has them once it has named them; their numbers are not. Robots
of seven joints and sensor sets without a motor torque are left out.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from support.diagnose_cases import as_recording

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.refinement import refined
from flexjoint.diagnosis.regression.fit import Fit, Slot, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import standard_errors
from flexjoint.diagnosis.result import Finding, Fitted
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.effects import Planned

from .cases import COUNTS, StudyCase, make
from .run import _nominal

BLIND = ("no command", "link side only")


@dataclass(frozen=True)
class Number:
    """One number of a planted cause: relative errors, and errors in standard errors."""

    effect: str
    before: float
    after: float
    before_std: float
    after_std: float


def measured(case: StudyCase) -> tuple[list[Number], str]:
    """The numbers of a case, and why they were not refined (empty: they were)."""
    nominal = _nominal(case)
    recording = as_recording(replace(case.case, effects=(*case.case.effects, *case.hidden)).train())
    problem = Problem(balances_of(nominal, recording))
    planned = [Planned.of(p.effect, p.joint, dict(p.parameters), since=p.since) for p in case.case.effects]
    best = at_own_level(fit(problem, planned))
    first = _findings(best)
    found, estimation = refined.refine(best, first)
    out = []
    for slot in best.slots:
        truth = case.case.effects[slot.effect].parameters.get(slot.param.name)
        hidden = slot.param.unit == "m" or not np.any(truth)  # components that the recording may not show
        if truth is None or hidden:
            continue
        true = float(np.ravel(truth)[slot.component])
        b, bs = _error(first[slot.effect], slot, true)
        o, os = _error(found[slot.effect], slot, true)
        if bs > 0.0 and os > 0.0:
            effect = case.case.effects[slot.effect].effect
            out.append(Number(effect, abs(b / true), abs(o / true), abs(b / bs), abs(o / os)))
    return out, estimation.why


def _findings(best: Fit) -> list[Finding]:
    out = []
    for planned, errors in zip(best.effects, standard_errors(best), strict=True):
        numbers: dict[str, Fitted | str] = {}
        for p in planned.effect.params:
            std = errors[p.name]
            numbers[p.name] = Fitted(planned.values[p.name], std[0] if p.size == 1 else tuple(std), p.unit)
        out.append(Finding(planned.effect.name, planned.joint, 1.0, numbers, None, 1.0, "", planned))
    return out


def _error(finding: Finding, slot: Slot, true: float) -> tuple[float, float]:
    fitted = finding.parameters[slot.param.name]
    assert isinstance(fitted, Fitted)
    error = float(np.ravel(fitted.value)[slot.component]) - true
    if slot.param.wraps:
        error = float(np.angle(np.exp(1j * error)))
    return error, float(np.ravel(fitted.std)[slot.component])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--every", type=int, default=4)
    arguments = parser.parse_args()
    numbers: list[Number] = []
    cases = kept = 0
    for number in range(arguments.first, COUNTS["single"], arguments.every):
        case = make("single", number)
        if case.sensors in BLIND or case.case.robot.startswith("reach"):
            continue
        more, why = measured(case)
        cases, kept = cases + 1, kept + bool(why)
        numbers += more
        print(
            f"{case.name} {[p.effect for p in case.case.effects]} {case.sensors}: {why or 'refined'}",
            flush=True,
        )
    print(f"{cases} cases, {kept} left as they were, {len(numbers)} numbers")
    for label, error, std in (("balances", "before", "before_std"), ("simulation", "after", "after_std")):
        z = np.array([getattr(n, std) for n in numbers])
        covered = ", ".join(f"{np.mean(z < k):.2f} within {k}" for k in (1, 2, 3))
        median = np.median([getattr(n, error) for n in numbers])
        print(f"{label}: median relative error {median:.1e}; {covered}; furthest {z.max():.1f}")
    by: dict[str, list[Number]] = defaultdict(list)
    for n in numbers:
        by[n.effect].append(n)
    for effect in sorted(by):
        before, after = (np.median([getattr(n, k) for n in by[effect]]) for k in ("before", "after"))
        furthest = [max(getattr(n, k) for n in by[effect]) for k in ("before_std", "after_std")]
        print(f"| {effect} | {before:.1e} | {after:.1e} | {furthest[0]:.1f} | {furthest[1]:.1f} |")


if __name__ == "__main__":
    main()
