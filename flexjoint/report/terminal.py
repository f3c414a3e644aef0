"""A diagnosis on the terminal; readable at 80 columns, without colour and when piped."""

from __future__ import annotations

from collections.abc import Iterable

from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from flexjoint.core.text import Block, Line, Table
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.summary import summary as said

_ASCII = str.maketrans({"±": "+-", "→": "->", "–": "-", "²": "2", "\ufffd": "?"})


def summary(diagnosis: Diagnosis, console: Console) -> None:
    """Print the verdict, the causes, what they are tied with, the errors before and after, and what next."""
    show(said(diagnosis), console)


def show(blocks: Iterable[Block], console: Console) -> None:
    """Print lines and tables. Nothing depends on colour. A console that cannot print Unicode gets ASCII.
    Names are printed as they are: rich's markup in them means nothing."""
    say = _Printer(console)
    for block in blocks:
        if isinstance(block, Table):
            say.table(block)
        elif block.text:
            say.line(block)
        else:
            console.print()


class _Printer:
    """Lines and tables of plain text on a console, in ASCII where it must be."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._ascii = console.options.ascii_only

    def text(self, text: str, style: str = "") -> Text:
        if self._ascii:
            text = text.translate(_ASCII).encode("ascii", "replace").decode("ascii")
        return Text(text, style=style, overflow="fold")

    def line(self, line: Line) -> None:
        self._console.print(self.text(line.text, line.style), soft_wrap=line.whole)

    def table(self, table: Table) -> None:
        grid = Grid(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, safe_box=True)
        for title, right in table.heads:
            grid.add_column(
                self.text(title), justify="right" if right else "left", overflow="fold", no_wrap=False
            )
        for row in table.rows:
            grid.add_row(*(self.text(cell) for cell in row))
        self._console.print(grid)
