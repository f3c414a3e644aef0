"""What a search did to its set of causes, step by step."""

from __future__ import annotations

from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.result import Action, Step
from flexjoint.effects import Planned


def steps_between(before: Fit, after: Fit, stage: str, check: str, why: str) -> tuple[Step, ...]:
    """The steps from one set to another. Evidence is the energy (chi-square) that they gain together, at the
    noise level of the set after them."""
    had, has = {e.key for e in before.effects}, {e.key for e in after.effects}
    gone = [e for e in before.effects if e.key not in has]
    new = [e for e in after.effects if e.key not in had]
    if not gone and not new:
        return ()
    # the two may be of differently whitened recordings, which keep other samples
    there = after.problem.residual(before.effects)
    gained = after.problem.energy(there) - after.problem.energy(after.y)
    out = []
    for one in gone:
        heir = next((e for e in after.effects if _contains(e, one)), None)
        if heir is not None and heir not in new:
            out.append(_step(stage, "merged", one, heir, check, gained, f"{heir} contains {one}"))
        elif new:
            other = new.pop(0)
            out.append(_step(stage, "exchanged", one, other, check, gained, f"{other} for {one}: {why}"))
        else:
            out.append(_step(stage, "dropped", one, None, check, gained, f"{one} is dropped: {why}"))
    out += [_step(stage, "added", one, None, check, gained, f"{one} is added: {why}") for one in new]
    return tuple(out)


def _contains(wide: Planned, narrow: Planned) -> bool:
    return wide.joint == narrow.joint and narrow.effect.name in wide.effect.contains


def _step(
    stage: str, action: Action, effect: Planned, by: Planned | None, check: str, evidence: float, text: str
) -> Step:
    return Step(
        stage, action, effect.effect.name, effect.joint, None if by is None else by.key, check, evidence, text
    )
