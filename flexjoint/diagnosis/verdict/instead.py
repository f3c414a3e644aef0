"""Causes in the place of what the nominal model claims: a joint has Dahl friction where the robot file lists
Coulomb friction. A set says so by two effects, of which the second only takes the claim away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexjoint.diagnosis.result import Finding
from flexjoint.diagnosis.result.wording import effect_name, number, with_unit
from flexjoint.diagnosis.search.criteria import given_up_for
from flexjoint.effects import Planned


def without(one: Planned, effects: Sequence[Planned], nominal: Sequence[Planned]) -> list[Planned]:
    """The effects without one, and without that which only makes room for it: the claim is back then."""
    pairs = [(e, given_up_for(e, effects, nominal)) for e in effects]
    gone = {id(one), *(id(x) for pair in pairs if any(one is e for e in pair) for x in pair if x is not None)}
    return [e for e in effects if id(e) not in gone]


def paired(found: Sequence[Finding], nominal: Sequence[Planned]) -> tuple[Finding, ...]:
    """The findings, those that only make room for others told with these."""
    planned = [f.planned for f in found]
    out = {f.planned.key: f for f in found}
    for f in found:
        less = given_up_for(f.planned, planned, nominal)
        if less is None or less.key not in out or f.members:
            continue
        other = out.pop(less.key)
        note = f"in the place of {_told(other, nominal)}"
        out[f.planned.key] = replace(f, members=(f.planned, less), instead_of=other, note=note)
    return tuple(out.values())


def _told(less: Finding, nominal: Sequence[Planned]) -> str:
    """Of what there is less: "motor Coulomb friction (25 -> 3.5 N)"."""
    claim = next(e for e in nominal if e.key == less.planned.key)
    size = less.planned.effect.nulls[0]
    unit = getattr(less.parameters[size.name], "unit", size.unit)
    left, was = (number(abs(e.values[size.name])) for e in (less.planned, claim))
    return f"{effect_name(less.effect)} ({was} → {with_unit(left, unit)})"
