"""XML as the targets write it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

HEAD = '<?xml version="1.0"?>\n'


def text(values: float | Iterable[float]) -> str:
    """Numbers as an attribute that reads back as the same ones."""
    if isinstance(values, int | float):
        return repr(float(values))
    return " ".join(repr(float(value) + 0.0) for value in values)


def child(parent: Element, tag: str, **attributes: object) -> Element:
    """A new element; numbers and vectors are written in full, what is None is left out."""
    written = {key: _value(value) for key, value in attributes.items() if value is not None}
    return SubElement(parent, tag, written)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    return text(value)  # type: ignore[arg-type]


def whole(root: Element, comment: Sequence[str]) -> str:
    """The file, with lines of comment before its first element."""
    indent(root)
    return f"{HEAD}<!--\n{_lines(comment)}\n-->\n{tostring(root, encoding='unicode')}\n"


def note(parent: Element, line: str) -> None:
    parent.append(Comment(f" {_plain(line)} "))


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z."""
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


def _lines(comment: Sequence[str]) -> str:
    return "\n".join(f"  {_plain(line)}" for line in comment)


def _plain(line: str) -> str:
    """XML's comments may hold no two hyphens one after the other, nor end in one."""
    while "--" in line:
        line = line.replace("--", "- -")
    return line.removesuffix("-")
