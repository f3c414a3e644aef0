"""What only `make test-all` runs: tests that take long because they diagnose a lot, or a large robot.

`make test` keeps a fixed part of every long list of diagnoses, so that each rule is tried by it, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

thorough = pytest.mark.thorough


def sample(cases: Iterable[Any], one_in: int, several: bool = False) -> list[Any]:
    """The cases as parameters of a test: one of every `one_in` is run always, the others are thorough.

    `several` says that a case is a tuple of several arguments.
    """
    marked = []
    for number, case in enumerate(cases):
        values = tuple(case) if several else (case,)
        marked.append(pytest.param(*values, marks=() if number % one_in == 0 else thorough))
    return marked
