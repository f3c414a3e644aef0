"""A table of an experiment, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Grid:
    """Rows of cells under heads; `words` names the columns of words beside the first, `note` explains."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Sequence[str] = ()
    note: str = ""

    def show(self, console: Console) -> None:
        """Print it; a first cell that is the one above it is left blank."""
        from rich.markup import escape
        from rich.table import Table

        table = Table(title=self.title, title_justify="left")
        for k, label in enumerate(self.head):
            words = k == 0 or label in self.words
            table.add_column(escape(label), justify="left" if words else "right")
        above = None
        for first, *cells in self.rows:
            table.add_row(*(escape(cell) for cell in ("" if first == above else first, *cells)))
            above = first
        console.print(table)
        if self.note:
            console.print(self.note, markup=False, soft_wrap=True)
