"""How far a long work is: a function of the share that is done, in [0, 1], and of what is being done."""

from __future__ import annotations

from collections.abc import Callable

Report = Callable[[float, str], None]


def silent(share: float, what: str) -> None:
    """Says nothing."""


def part(report: Report, begin: float, share: float) -> Report:
    """The report of a part of the work, which begins at `begin` and is that `share` of the whole."""
    return lambda done, what: report(begin + share * done, what)
