"""The named causes: parameters with standard errors, evidence, law, and what each is tied with."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result import Finding, sentences, torque
from flexjoint.diagnosis.result.wording import (
    Joints,
    capital,
    cause,
    clean,
    effect_name,
    fitted,
    listed,
    percent,
    sentence,
    when,
)
from flexjoint.report import plots
from flexjoint.report.material import Material


@dataclass(frozen=True)
class ParameterLine:
    name: str
    symbol: plots.Image | None
    value: str


@dataclass(frozen=True)
class TieLine:
    causes: str
    why: str


@dataclass(frozen=True)
class Cause:
    title: str
    about: str
    parameters: tuple[ParameterLine, ...]
    probability: str
    removal: torque.Removal | None
    when: str
    kind: str
    change: bool  # the nominal model lists this effect: the parameters are the change
    law: plots.Image | None
    law_text: str
    reference: str
    ties: tuple[TieLine, ...]
    hidden_by_refit: bool
    note: str


@dataclass(frozen=True)
class CausesSection:
    causes: tuple[Cause, ...]
    possible: tuple[Cause, ...]  # more likely absent
    disbelieved: str  # in one sentence; empty without any
    numbers: tuple[str, ...]  # how they were found, which are correlated, which are at a bound


def build(material: Material) -> CausesSection:
    diagnosis = material.diagnosis
    said = (sentences.found_by(diagnosis), *sentences.numbers(diagnosis))
    return CausesSection(
        tuple(_cause(finding, material.joints) for finding in sentences.likely(diagnosis)),
        tuple(_cause(finding, material.joints) for finding in sentences.possible(diagnosis)),
        sentences.disbelieved(diagnosis),
        tuple(line for line in said if line),
    )


def _cause(finding: Finding, joints: Joints) -> Cause:
    effect = finding.planned.effect
    symbols = {param.name: param.symbol for param in effect.params}
    where = f" at {clean(finding.joint)}" if finding.joint is not None else ", the whole robot"
    return Cause(
        title=capital(effect_name(finding.effect)) + where,
        about=sentence(" ".join((effect.__doc__ or "").split("\n\n")[0].split())),
        parameters=tuple(
            ParameterLine(
                clean(name), plots.formula(symbols[name]) if symbols.get(name) else None, fitted(value)
            )
            for name, value in finding.parameters.items()
        ),
        probability=percent(finding.probability),
        removal=torque.removal(finding, joints),
        when=capital(when(finding)),
        kind=clean(finding.kind),
        change=finding.planned.nominal,
        law=plots.formula(effect.law) if effect.law else None,
        law_text=effect.law,
        reference=clean(effect.reference),
        ties=_ties(finding),
        hidden_by_refit=finding.hidden_by_refit,
        note=sentence(capital(finding.note)),
    )


def _ties(finding: Finding) -> tuple[TieLine, ...]:
    """The tied causes, those with the same reason in one line."""
    by_reason: dict[str, list[str]] = {}
    for tie in finding.indistinguishable:
        by_reason.setdefault(tie.why, []).append(cause(tie.effect, tie.joint))
    return tuple(
        TieLine(
            listed(names, "or"),
            sentence(f"{'It' if len(names) == 1 else 'Each'} {clean(why)}") if why else "",
        )
        for why, names in by_reason.items()
    )
