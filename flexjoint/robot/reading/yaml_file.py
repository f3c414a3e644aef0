"""A YAML within limits: values and depth are counted while it is read, aliases as what they stand for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from flexjoint.core.errors import FlexJointError, RobotError
from flexjoint.core.files import read_text
from flexjoint.core.limits import ROBOT_FILE
from flexjoint.core.messages import shown

FREE = ("sources", "controller")  # keys below which anything may stand
SWITCHES = ("supports", "nominal")  # keys that hold true or false
PLAIN = re.compile(  # decimal numbers, and YAML's infinity and NaN
    r"[-+]?((0|[1-9]\d*)(\.\d*)?|\.\d+)([eE][-+]?\d+)?\Z|[-+]?\.(inf|Inf|INF|nan|NaN|NAN)\Z"
)
MULTILINE = "\n\t\r"
NO_YAML = (  # what is raised of a text that is none: PyYAML's constructors of numbers and dates stumble, too
    yaml.YAMLError,
    ValueError,
    LookupError,
    AttributeError,
    TypeError,
    RecursionError,
    OverflowError,
)


def read(path: Path) -> Any:
    """What stands in a YAML; raises RobotError where it cannot be read, or is beyond `ROBOT_FILE`."""
    try:
        return values_of(read_text(path, ROBOT_FILE.file_bytes))
    except FileNotFoundError:
        raise RobotError(f"robot file {path} does not exist; give the path of a robot YAML") from None
    except IsADirectoryError:
        raise RobotError(f"{path} is a folder; give the robot YAML inside it") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(f"{path} cannot be read as text: {error}") from None
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None
    except FlexJointError as error:
        raise RobotError(str(error)) from None
    except NO_YAML as error:
        raise RobotError(f"{path} is not valid YAML: {shown(' '.join(str(error).split()), 200)}") from None


def values_of(text: str) -> Any:
    """What a text in YAML says; raises RobotError where it is beyond `ROBOT_FILE`, and one of `NO_YAML`."""
    return yaml.load(text, Loader=_Loader)


def check_values(raw: Any, where: str) -> None:
    """Names without control characters, numbers of a size that a robot has, and truth values only where one
    is asked for; raises RobotError that names the key."""
    for path, value in _leaves(raw, ()):
        key = ".".join(path)
        if isinstance(value, str):
            kept = MULTILINE if path[0] in (*FREE, "presets") else ""
            if not "".join(c for c in value if c not in kept).isprintable():
                raise RobotError(
                    f"{where}: {shown(key)}: '{shown(value)}' holds control characters; rename it"
                )
        elif isinstance(value, bool):
            if path[-1] not in SWITCHES and not any(part in FREE for part in path):
                said = str(value).lower()
                raise RobotError(f"{where}: {shown(key)}: expected a number or a name, got {said}")
        elif isinstance(value, int | float):
            if isinstance(value, float) and math.isnan(value):
                raise RobotError(f"{where}: {shown(key)}: expected a number, got .nan; leave the key out")
            if ROBOT_FILE.number < abs(value) < math.inf:
                raise RobotError(
                    f"{where}: {shown(key)}: {shown(value, 30)} is beyond {ROBOT_FILE.number:g}, the largest"
                    " that is read (docs/reference/limits.md); check the unit"
                )


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Keys, items and values with where they stand; the loader has bounded their number and depth."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*path, str(key)), str(key)
            yield from _leaves(item, (*path, str(key)))
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from _leaves(item, (*path, str(k)))
    elif path:
        yield path, value


class _Loader(yaml.SafeLoader):
    """Composes nodes within the limits, and refuses a key that stands twice."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._nodes = 0
        self._open: list[str] = []  # anchors of the nodes that are being composed
        self._sizes: dict[str, int] = {}
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()
        anchor = event.anchor
        if isinstance(event, yaml.AliasEvent):
            if anchor in self._open:
                raise RobotError(f"alias *{shown(anchor)} stands within what it names; write the values out")
            self._count(self._sizes.get(anchor, 1))
            return super().compose_node(parent, index)
        self._depth += 1
        if self._depth > ROBOT_FILE.depth:
            raise RobotError(
                f"more than {ROBOT_FILE.depth} levels of nesting; the form is in docs/reference/formats.md"
            )
        before = self._nodes
        self._count(1)
        if anchor is not None:
            self._open.append(anchor)
        node = super().compose_node(parent, index)
        if anchor is not None:
            self._open.pop()
            self._sizes[anchor] = self._nodes - before
        self._depth -= 1
        return node

    def _count(self, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes > ROBOT_FILE.nodes:
            raise RobotError(
                f"more than {ROBOT_FILE.nodes} values, aliases counted as what they stand for; no robot"
                " has so many"
            )

    def plain_number(self, node: yaml.ScalarNode) -> float:
        """A number as it is read by people: YAML 1.1 takes 010 for 8, 1:30 for 90 and 1_0 for 10."""
        text = str(node.value)
        if not PLAIN.match(text):
            raise RobotError(
                f"line {node.start_mark.line + 1}: '{shown(text)}' would be read as an octal, hexadecimal or"
                " sexagesimal number; write it as a decimal one, or in quotes"
            )
        made: float = (
            self.construct_yaml_int(node) if node.tag.endswith(":int") else self.construct_yaml_float(node)
        )
        return made

    def construct_mapping(self, node: yaml.Node, deep: bool = False) -> dict[Any, Any]:
        if isinstance(node, yaml.MappingNode):
            seen: set[Any] = set()
            for key, _ in node.value:
                name = key.value if isinstance(key, yaml.ScalarNode) else None
                if name is not None and name != "<<" and name in seen:
                    raise RobotError(
                        f"key '{shown(name)}' stands twice in line {key.start_mark.line + 1}; keep one"
                    )
                seen.add(name)
        return super().construct_mapping(node, deep)  # type: ignore[arg-type]


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.plain_number)
