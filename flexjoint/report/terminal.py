"""A diagnosis and its progress on the terminal; readable at 80 columns, without colour and when piped."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Self

from rich import box, progress
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from flexjoint.core.text import Block, Line, Table
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.summary import summary as said
from flexjoint.diagnosis.result.wording import clean

PATIENCE = 2.0  # [s] of work before a bar is shown
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


class Progress:
    """Shows how far a long computation is: `progress(fraction, what)`, with a fraction in [0, 1].

    A bar appears on standard error, and only when that is a terminal and the work has lasted longer than
    about two seconds. Use it as a context manager, so that the bar is taken away at the end.
    """

    def __init__(self, console: Console | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._console = console if console is not None else Console(file=sys.stderr)
        self._clock = clock
        self._start = clock()
        self._bar: progress.Progress | None = None
        self._task = progress.TaskID(0)

    def __call__(self, fraction: float, what: str) -> None:
        """Say that this share of the work is done and what is being done now."""
        if self._bar is None:
            waiting = self._clock() - self._start < PATIENCE
            if waiting or not self._console.is_terminal or self._console.is_dumb_terminal:
                return
            self._bar = progress.Progress(
                progress.TextColumn("{task.description}", markup=False),
                progress.BarColumn(),
                progress.TaskProgressColumn(),
                console=self._console,
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=1.0)
        self._bar.update(self._task, completed=min(max(fraction, 0.0), 1.0), description=clean(what))

    def close(self) -> None:
        """Take the bar away; nothing when there is none."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def no_progress(fraction: float, what: str) -> None:
    """The progress of a library call: says nothing."""


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
