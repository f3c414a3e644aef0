"""JSON schemas (2020-12) of what the commands write: a file each beside this one, versioned as the output
is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from flexjoint.core.errors import unknown

FOLDER = Path(__file__).parent / "schemas"


def names() -> tuple[str, ...]:
    """The outputs that have one (docs/reference/programs.md)."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def schema(name: str) -> dict[str, Any]:
    """The schema of an output; UnknownNameError where there is none of that name."""
    if name not in names():
        raise unknown("schema", name, names())
    content: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return content
