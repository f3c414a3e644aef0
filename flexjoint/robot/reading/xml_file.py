"""An XML description within limits: elements, depth and attributes are counted while it is read.

The C++ parsers behind Pinocchio recurse on bodies within bodies and search lists for every name: a file of
20,000 nested bodies ends the process. What passes here they read in less than a second, so that they need
no process of their own, which would cost every command another import of Pinocchio.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from flexjoint.core.errors import FlexJointError, RobotError
from flexjoint.core.files import read_text
from flexjoint.core.limits import DESCRIPTION
from flexjoint.core.messages import shown

NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\Z")
SPELT = {"inf": math.inf, "+inf": math.inf, "-inf": -math.inf}  # where a limit may be none


def read(path: Path) -> Element:
    """The root element.

    Raises RobotError beyond the limits, ElementTree.ParseError where it is no XML, OSError and
    UnicodeDecodeError where it cannot be read.
    """
    try:
        text = read_text(path, DESCRIPTION.file_bytes)
    except FlexJointError as error:
        raise RobotError(str(error)) from None
    parser = ElementTree.XMLParser(target=_Counted())
    try:
        parser.feed(text)
        root: Element = parser.close()
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None
    return root


class _Counted(ElementTree.TreeBuilder):
    """Builds the tree as long as it is within the limits."""

    def __init__(self) -> None:
        super().__init__()
        self._elements = 0
        self._depth = 0

    def doctype(self, name: str, _public: str | None, _system: str | None) -> None:
        raise RobotError(f"<!DOCTYPE {shown(name)}> may define entities, which are not read; delete it")

    def start(self, tag: str, attributes: dict[str, str], /) -> Element:
        self._elements += 1
        self._depth += 1
        for count, most, what in (
            (self._elements, DESCRIPTION.elements, "elements"),
            (self._depth, DESCRIPTION.depth, "levels of elements within elements"),
            (len(attributes), DESCRIPTION.attributes, f"attributes of <{shown(tag)}>"),
        ):
            if count > most:
                raise RobotError(
                    f"more than {most} {what}, the most that are read (docs/reference/limits.md)"
                )
        for name, value in attributes.items():
            if len(value) > DESCRIPTION.text:
                raise RobotError(
                    f"<{shown(tag)}> {shown(name)} has {len(value)} characters, expected at most"
                    f" {DESCRIPTION.text} (docs/reference/limits.md)"
                )
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> Element:
        self._depth -= 1
        return super().end(tag)


def numbers(text: str, counts: Collection[int], where: str, *, endless: bool = False) -> list[float]:
    """The numbers of an attribute, separated by blanks, as many as one of `counts` (none given: any).

    Raises RobotError for what is no number, also for 1,5, nan and inf (unless `endless`), which parsers take
    for 0 or for 1.
    """
    out = []
    for word in text.split():
        if NUMBER.match(word):
            out.append(float(word))
        elif endless and word.lower() in SPELT:
            out.append(SPELT[word.lower()])
            continue
        else:
            raise RobotError(f"{where}: expected a number with a decimal point, got '{shown(word)}'")
        if abs(out[-1]) > DESCRIPTION.number and not endless:
            raise RobotError(
                f"{where}: {shown(word)} is beyond {DESCRIPTION.number:g}, the largest that is read"
            )
    if counts and len(out) not in counts:
        expected = " or ".join(map(str, counts))
        raise RobotError(f"{where}: expected {expected} numbers, got '{shown(text)}'")
    return out


def name_of(element: Element, kind: str, where: str) -> str:
    """The name of a link, joint or body; raises RobotError where there is none that can be printed."""
    name = element.get("name")
    if not name:
        raise RobotError(f"{where}: a <{kind}> has no name; name it")
    if not name.isprintable():
        raise RobotError(f"{where}: <{kind}> '{shown(name)}' has control characters in its name; rename it")
    return name


def check_count(counts: Mapping[str, int], where: str) -> None:
    """Raises RobotError where there are more links, joints or bodies than are read."""
    for what, count in counts.items():
        if count > DESCRIPTION.bodies:
            raise RobotError(
                f"{where}: {count} {what}, expected at most {DESCRIPTION.bodies} (docs/reference/limits.md)"
            )
