"""The one loop in which checks change a set of causes, and the steps that it writes down."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

from flexjoint.diagnosis.result import Step
from flexjoint.diagnosis.result.wording import cause
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks import EVERY, Check, Objection
from flexjoint.diagnosis.verdict.edits import plainer, without

Looked = TypeVar("Looked", bound=Case)
ROOM = "makes room"  # in the trace


def reviewed(case: Looked, checks: Sequence[Check[Looked]]) -> Looked:
    """The case after all checks: the first one that objects changes the set, and all are asked again."""
    waiting = list(checks)
    while case.selection.best.effects:
        check, objections = _first(case, waiting)
        if check is None:
            break
        for objection in objections:
            case = _edited(case, check, objection)
        if check.once:
            waiting.remove(check)
    return case


def _first(
    case: Looked, checks: Iterable[Check[Looked]]
) -> tuple[Check[Looked] | None, tuple[Objection, ...]]:
    """The first check that objects, and its objections."""
    for check in checks:
        objections = check.objections(case)
        if objections:
            return check, objections
    return None, ()


def _edited(case: Looked, check: Check[Looked], objection: Objection) -> Looked:
    before, effect = case.selection, objection.effect
    if objection.instead is not None:
        after = objection.instead
    elif objection.simpler:
        after = plainer(before, effect)
    else:
        after = without(before, effect)
    steps = (_step(check, objection, before, after), *_with_it(check, objection, before, after))
    return case.changed(after, *steps)


def _step(check: Check[Looked], objection: Objection, before: Selection, after: Selection) -> Step:
    known, effect = {e.key for e in before.best.effects}, objection.effect
    other = next((e for e in after.best.effects if e.key not in known), None)
    name = cause(*effect.key)
    done = (
        f"{name} is not reported" if other is None else f"{cause(*other.key)} is reported instead of {name}"
    )
    return Step(
        stage=check.stage,
        action="dropped" if other is None else "replaced",
        effect=effect.effect.name,
        joint=effect.joint,
        by=None if other is None else other.key,
        check=check.name,
        evidence=objection.evidence,
        text=f"{done}: {objection.why}",
    )


def _with_it(
    check: Check[Looked], objection: Objection, before: Selection, after: Selection
) -> Iterator[Step]:
    """The steps of what went with a cause, because it only made room for that."""
    effect, left = objection.effect, {e.key for e in after.best.effects}
    if objection.instead is not None or not left < {e.key for e in before.best.effects}:
        return
    for one in before.best.effects:
        if one.key not in {*left, effect.key}:
            why = f"{cause(*one.key)} is not reported: it made room for {cause(*effect.key)}"
            yield Step(check.stage, "dropped", *one.key, None, ROOM, objection.evidence, why)


def notes(trace: Iterable[Step]) -> tuple[str, ...]:
    """What the checks of a trace did, as sentences for a reader."""
    noted = {check.name for check in EVERY if check.noted}
    return tuple(step.text for step in trace if step.check in noted)
