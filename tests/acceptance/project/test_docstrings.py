"""What the API reference is made of: every public name says shapes, units and errors."""

from __future__ import annotations

import inspect
import re
from typing import Any

import pytest

import flexjoint as fj

SHAPE = re.compile(r"\((?:\.\.\.|[A-Za-z0-9_ +*]+),[A-Za-z0-9_ +*,]*\)")  # (N,), (N, nq), (..., n)
UNIT = re.compile(r"\[[^\]]+\]|\bSI\b|\b(?:rad|Hz|N m|seconds|s)\b")
FUNCTIONS = [name for name in fj.__all__ if inspect.isroutine(getattr(fj, name))]
CLASSES = [name for name in fj.__all__ if inspect.isclass(getattr(fj, name))]
WITHOUT_ERRORS = (  # nothing that they are given can be wrong
    "catalogue",
    "longest_period",
    "margins",
    "shipped_robots",
)
BARE = ("has", "joint", "duration", "verdict")  # methods and properties whose name says it all


def doc(thing: Any) -> str:
    return inspect.getdoc(thing) or ""


def annotated(name: str) -> str:
    signature = inspect.signature(getattr(fj, name))
    given = [str(parameter.annotation) for parameter in signature.parameters.values()]
    return " ".join([*given, str(signature.return_annotation)])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_says_what_it_takes_and_what_can_go_wrong(name: str) -> None:
    text = doc(getattr(fj, name))
    assert text.split("\n")[0].rstrip().endswith((".", ":", ";")) or len(text) > 80
    if "ndarray" in annotated(name):
        assert SHAPE.search(text), f"{name}: no shape such as (N,) in its docstring"
        assert UNIT.search(text), f"{name}: no unit such as [rad] in its docstring"
    if name not in WITHOUT_ERRORS:
        assert re.search(r"[Rr]aises|Error", text), f"{name}: no errors in its docstring"


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_and_its_methods_say_what_they_are(name: str) -> None:
    kind = getattr(fj, name)
    assert len(doc(kind)) > 40
    silent = []
    for member in vars(kind):
        value = inspect.getattr_static(kind, member)
        own = inspect.isfunction(value) or isinstance(value, property | staticmethod | classmethod)
        if own and not member.startswith("_") and not doc(getattr(kind, member)):
            silent.append(member)
    assert [member for member in silent if member not in BARE] == [], f"{name}: without a docstring"


def test_the_lists_of_exceptions_are_needed() -> None:
    assert all("aises" not in doc(getattr(fj, name)) for name in WITHOUT_ERRORS)
