"""Text as blocks, lines and tables: laid out as plain text or HTML, and coloured by who owns a terminal."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Style = Literal["", "bold", "dim"]
WIDTH = 100  # of plain text [characters]


@dataclass(frozen=True)
class Line:
    """A paragraph; a bold one is a heading where an empty line precedes it."""

    text: str
    style: Style = ""
    whole: bool = False  # not to be broken, for it holds a path


@dataclass(frozen=True)
class Table:
    """Rows of cells, which may hold several lines; `heads` are titles and whether cells are right-aligned."""

    heads: tuple[tuple[str, bool], ...]
    rows: tuple[tuple[str, ...], ...]


Block = Line | Table
EMPTY = Line("")


def plain(blocks: Iterable[Block]) -> str:
    """The blocks as plain text; lines are broken, tables are as wide as they are."""
    return "\n".join(_grid(b) if isinstance(b, Table) else _line(b) for b in blocks)


def as_html(blocks: Iterable[Block]) -> str:
    """The blocks as HTML, for a notebook's cell."""
    return "\n".join(_html_table(b) if isinstance(b, Table) else _html_line(b) for b in blocks if b != EMPTY)


def _line(line: Line) -> str:
    return line.text if line.whole else textwrap.fill(line.text, WIDTH)


def _grid(table: Table) -> str:
    cells = [
        [[title] for title, _ in table.heads],
        *([cell.split("\n") for cell in row] for row in table.rows),
    ]
    widths = [max(len(line) for row in cells for line in row[k]) for k in range(len(table.heads))]
    lines = []
    for number, row in enumerate(cells):
        for k in range(max(map(len, row))):
            parts = [cell[k] if k < len(cell) else "" for cell in row]
            columns = zip(parts, widths, table.heads, strict=True)
            fitted = (part.rjust(wide) if right else part.ljust(wide) for part, wide, (_, right) in columns)
            lines.append("  ".join(fitted).rstrip())
        if number == 0:
            lines.append("  ".join("-" * wide for wide in widths))
    return "\n".join(lines)


def _html_line(line: Line) -> str:
    text = html.escape(line.text)
    if line.style == "bold":
        return f"<p><strong>{text}</strong></p>"
    return f'<p style="opacity: 0.7">{text}</p>' if line.style == "dim" else f"<p>{text}</p>"


def _html_table(table: Table) -> str:
    align = ["right" if right else "left" for _, right in table.heads]

    def row(cells: Iterable[str], tag: str) -> str:
        parts = (
            f'<{tag} style="text-align: {side}; vertical-align: top">'
            f"{html.escape(cell).replace(chr(10), '<br>')}</{tag}>"
            for cell, side in zip(cells, align, strict=True)
        )
        return f"<tr>{''.join(parts)}</tr>"

    head = row((title for title, _ in table.heads), "th")
    return f"<table><thead>{head}</thead><tbody>{''.join(row(r, 'td') for r in table.rows)}</tbody></table>"
