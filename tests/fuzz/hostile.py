"""Hostile input: files with bytes changed, and what every reader and command has to do with it."""

from __future__ import annotations

import contextlib
import io
import os
import re
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from support.cli_runs import run

from flexjoint.core.errors import FlexJointError
from flexjoint.core.messages import LONGEST_LINE

EXAMPLES = "FLEXJOINT_FUZZ"  # environment variable: examples of each test; `make fuzz` sets many
SLOWEST = 10.0  # seconds of any input
NUMBERS = re.compile(rb"-?\d+\.?\d*([eE]-?\d+)?")
TOKENS = tuple(
    text.encode("utf-8")
    for text in (
        *("nan", ".nan", "inf", ".inf", "-1", "0", "1e300", "-1e300", "1e20", "1e-300", "1,5", "9" * 400),
        *("", " ", "\n", "\t", "\0", "\x1b[31m", "\u202e", '"', "'", ",", ":", "- ", "{", "}", "[", "]"),
        *("&a ", "*a", "<<: *a", "!!python/name:os", "null", "true", "yes", "~", "|", ">", "? ", "#", "%"),
        *("<", "/>", "<!--", "]]>", "&lt;", "&#0;", "<!DOCTYPE a>", "<a>", "<link name='a'/>", "<mimic/>"),
        *("a" * 3000, "time", "q.elbow", "é"),
    )
)


def fuzz(examples: int) -> Any:
    """Settings of a test: the same `examples` each time, or as many new ones as FLEXJOINT_FUZZ says."""
    many = os.environ.get(EXAMPLES)
    return settings(
        max_examples=int(many) if many else examples,
        derandomize=many is None,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


@st.composite
def mutated(draw: st.DrawFn, content: bytes) -> bytes:
    """The content with one to four places changed."""
    for _ in range(draw(st.integers(1, 4))):
        numbers = list(NUMBERS.finditer(content))
        how = draw(st.sampled_from(("number", "number", "byte", "cut", "twice", "insert", "swap", "end")))
        at = draw(st.integers(0, max(0, len(content) - 1)))
        until = min(len(content), at + draw(st.integers(0, 60)))
        if how == "number" and numbers:
            place = draw(st.sampled_from(numbers))
            content = content[: place.start()] + draw(st.sampled_from(TOKENS)) + content[place.end() :]
        elif how == "byte":
            content = content[:at] + bytes([draw(st.integers(0, 255))]) + content[at + 1 :]
        elif how == "cut":
            content = content[:at] + content[until:]
        elif how == "twice":
            content = content[:until] + content[at:until] * draw(st.integers(1, 5)) + content[until:]
        elif how == "insert":
            content = content[:at] + draw(st.sampled_from(TOKENS)) + content[at:]
        elif how == "swap":
            middle = (at + until) // 2
            content = content[:at] + content[middle:until] + content[at:middle] + content[until:]
        elif how == "end":
            content = content[:at]
    return content


@contextlib.contextmanager
def only_refusals() -> Any:
    """What is not usable is refused in words; nothing else may be raised, and nothing may take long."""
    begin = time.monotonic()
    with contextlib.suppress(FlexJointError):
        yield
    assert time.monotonic() - begin < SLOWEST


def command(out: Path, *words: object) -> int:
    """Run a command: exit code 0 and its output whole, or 2, one line, and no output.

    Warnings, one line each, may stand before.
    """
    out.unlink(missing_ok=True)
    begin = time.monotonic()
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        code = run(*words)
    lines = complained.getvalue().splitlines()
    refused = [line for line in lines if not line.startswith("flexjoint: warning: ")]
    assert code in (0, 2), code
    assert len(refused) == (1 if code == 2 else 0), lines
    assert all(line.startswith("flexjoint: ") and len(line) <= LONGEST_LINE for line in lines)
    assert all(line.isprintable() for line in [*lines, *said.getvalue().splitlines()])
    assert out.exists() == (code == 0)
    assert not list(out.parent.glob(f".{out.name}*"))  # no half of a file
    assert time.monotonic() - begin < SLOWEST
    return code


def corpus(suffix: str) -> list[Any]:
    """Files that once broke something."""
    folder = Path(__file__).parent / "corpus"
    return [pytest.param(path, id=path.name) for path in sorted(folder.glob(f"*{suffix}"))]
