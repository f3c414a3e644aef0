"""What takes long because it diagnoses a lot, or a large robot: `thorough` tests are left out by `make test`,
the longest of them, `exhaustive`, by `make test-ci`, too. `make test-all` runs all.

A fixed part of every long list of diagnoses is in each, so that each rule is tried by it, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

thorough, exhaustive = pytest.mark.thorough, pytest.mark.exhaustive


def sample(cases: Iterable[Any], one_in: int, several: bool = False, thorough_in: int = 1) -> list[Any]:
    """The cases as parameters of a test: one of every `one_in` is run always, one of every `thorough_in` is
    thorough, and the others are exhaustive.

    `several` says that a case is a tuple of several arguments.
    """
    marked = []
    for number, case in enumerate(cases):
        values = tuple(case) if several else (case,)
        marks: Any = () if number % one_in == 0 else thorough if number % thorough_in == 0 else exhaustive
        marked.append(pytest.param(*values, marks=marks))
    return marked
