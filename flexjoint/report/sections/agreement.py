"""Several recordings beside each other: every number by recording, and how well the others foretell each."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result import Repeated, agreement
from flexjoint.diagnosis.result.wording import clean
from flexjoint.report import plots
from flexjoint.report.material import Material

PLOTS = 8  # numbers that are drawn: those that spread most


@dataclass(frozen=True)
class NumberRow:
    name: str
    mean: str
    cells: tuple[str, ...]
    spread: str


@dataclass(frozen=True)
class NumberPlot:
    image: plots.Image
    caption: str


@dataclass(frozen=True)
class AgreementSection:
    names: tuple[str, ...]
    labels: tuple[str, ...]
    shown: tuple[str, ...]
    rows: tuple[NumberRow, ...]
    plots: tuple[NumberPlot, ...]
    foretold: tuple[agreement.Foretold, ...]


def build(material: Material) -> AgreementSection | None:
    """None of a single recording."""
    found = material.diagnosis.agreement
    if found is None:
        return None
    count = len(found.recordings)
    labels = tuple(agreement.label(k) for k in range(count))
    worst = sorted((r for r in found.numbers if r.freedom), key=lambda r: r.chance)
    return AgreementSection(
        tuple(f"{label} {clean(name)}" for label, name in zip(labels, found.recordings, strict=True)),
        labels,
        tuple(agreement.shown_lines(found.causes, count)),
        tuple(_row(r, count) for r in found.numbers),
        tuple(_plot(r) for r in worst[:PLOTS]),
        tuple(agreement.foretold(found)),
    )


def _row(number: Repeated, count: int) -> NumberRow:
    cells = tuple(agreement.value_of(number, k) for k in range(count))
    return NumberRow(agreement.name_of(number), agreement.mean_of(number), cells, agreement.spread_of(number))


def _plot(number: Repeated) -> NumberPlot:
    name = agreement.name_of(number)
    alt = f"{name} by recording: {agreement.spread_of(number)}"
    return NumberPlot(plots.by_recording(number, alt), f"{name}: {agreement.spread_of(number)}")
