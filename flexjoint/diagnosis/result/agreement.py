"""Several recordings beside each other, in words: values of every number, which recording is odd, and how
well the others foretell it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

from flexjoint.core.text import EMPTY, Block, Line, Table
from flexjoint.diagnosis.result import merit
from flexjoint.diagnosis.result.values import Agreement, Repeated, Shown
from flexjoint.diagnosis.result.wording import (
    NOTHING,
    capital,
    cause,
    clean,
    listed,
    number,
    sentence,
    with_error,
    with_unit,
)


def label(index: int) -> str:
    """A recording in tables and figures: [1], [2], ..."""
    return f"[{index + 1}]"


def name_of(repeated: Repeated) -> str:
    return f"{cause(repeated.effect, repeated.joint)}: {clean(repeated.parameter)}"


def mean_of(repeated: Repeated) -> str:
    """The common value with its error and unit."""
    return with_unit(with_error(repeated.mean, repeated.std), repeated.unit)


def value_of(repeated: Repeated, index: int) -> str:
    """A recording's own value with its error."""
    std = repeated.stds[index]
    return with_error(repeated.values[index], std) if math.isfinite(std) else NOTHING


def spread_of(repeated: Repeated) -> str:
    """The spread in words: agree, or by how much they do not, and who is odd."""
    if not repeated.freedom:
        return NOTHING
    size = f"{number(repeated.chi_square / repeated.freedom, 2)} x errors²"
    if not repeated.disagree:
        return f"agree ({size})"
    odd = f": {listed(label(k) for k in repeated.odd)} odd" if repeated.odd else ""
    return f"disagree ({size}){odd}"


def shown_lines(causes: Sequence[Shown], count: int) -> Iterator[str]:
    """What all recordings show, and what only some do."""
    everywhere = [c for c in causes if len(c.there) == count]
    if everywhere:
        names = listed(cause(c.effect, c.joint) for c in everywhere)
        yield sentence(f"Shown by each recording: {names}")
    for c in causes:
        if len(c.there) < count:
            there = f"shown by {listed(map(label, c.there))}" if c.there else "shown by none of them alone"
            absent = f", absent in {listed(map(label, c.absent))}" if c.absent else ""
            rest = [k for k in range(count) if k not in c.there and k not in c.absent]
            blind = f", {listed(map(label, rest))} cannot tell" if rest else ""
            yield sentence(f"{capital(cause(c.effect, c.joint))}: {there}{absent}{blind}")


@dataclass(frozen=True)
class Foretold:
    """A recording and the errors of its simulation (NRMSE): with the nominal model and with the numbers of
    the others, over all measured channels and of the deflections theta - q."""

    name: str
    nominal: str
    foretold: str
    nominal_phi: str
    foretold_phi: str


HEADS = ("recording", "nominal", "foretold", "theta - q nominal", "foretold")


def foretold(agreement: Agreement) -> Iterator[Foretold]:
    """Each recording with what the others foretell of it."""
    for one in agreement.left_out:
        name = f"{label(one.recording)} {clean(agreement.recordings[one.recording])}"
        errors = merit.channel_errors(one.gain)
        sides = [[e for e in errors if (e.channel == "phi") == phi] for phi in (False, True)]
        numbers = [
            number(merit.root_mean_square(getattr(e, key) for e in side))
            for side in sides
            for key in ("before", "after")
        ]
        yield Foretold(name, *numbers)


def blocks(agreement: Agreement) -> Iterator[Block]:
    """The section of the terminal and of a notebook."""
    count = len(agreement.recordings)
    yield EMPTY
    yield Line(f"{count} recordings beside each other", "bold")
    for k, name in enumerate(agreement.recordings):
        yield Line(f"{label(k)} {clean(name)}", whole=True)
    for line in shown_lines(agreement.causes, count):
        yield Line(line)
    if agreement.numbers:
        heads = [("number", False), ("all", True), *((label(k), True) for k in range(count)), ("", False)]
        rows = [
            (name_of(r), mean_of(r), *(value_of(r, k) for k in range(count)), spread_of(r))
            for r in agreement.numbers
        ]
        yield Table(tuple(heads), tuple(rows))
        yield EMPTY
    if agreement.left_out:
        yield Line("Each recording simulated with the numbers of the others (NRMSE)", "bold")
        titles = tuple((head, k > 0) for k, head in enumerate(HEADS))
        yield Table(titles, tuple(astuple(one) for one in foretold(agreement)))
        yield EMPTY
