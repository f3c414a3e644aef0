"""Writes the table of packages in architecture.md from their own docstrings: `make docs`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

DOCS = Path(__file__).parent
PACKAGE = DOCS.parent / "flexjoint"
PAGE = DOCS / "explained" / "architecture.md"
BEGIN, END = "<!-- packages: written by make docs -->\n", "<!-- end of packages -->\n"
FLOORS = (
    ("cli",),
    ("report",),
    ("diagnosis", "design", "export"),
    ("simulation",),
    ("recording",),
    ("model",),
    ("robot",),
    ("effects", "rigidbody"),
    ("core",),
)


def table() -> str:
    """The packages from top to bottom, each with what it is and what lies in it."""
    rows = [row for floor in FLOORS for name in floor for row in _rows(PACKAGE / name)]
    return "\n".join(["| package | what | modules |", "|---|---|---|", *rows]) + "\n"


def page(text: str) -> str:
    """The page with the table as it is now."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def _rows(folder: Path) -> Iterator[str]:
    if not (folder / "__init__.py").is_file():
        return
    modules = sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
    if folder.name == "effects":  # docs/reference/effects.md has them
        modules = [name for name in modules if name.startswith("_")] + ["one an effect"]
    name = folder.relative_to(PACKAGE.parent).as_posix()
    yield f"| `{name}/` | {_first(folder / '__init__.py')} | {', '.join(modules)} |"
    for inner in sorted(folder.iterdir()):
        yield from _rows(inner)


def _first(path: Path) -> str:
    """The first paragraph of a docstring, without its full stop."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".").replace("|", r"\|")


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
