"""A diagnosis and its progress on the terminal; readable at 80 columns, without colour and when piped."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Iterable
from types import TracebackType
from typing import Self

from rich import box, progress
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flexjoint.diagnosis import Diagnosis
from flexjoint.report import merit, sentences
from flexjoint.report.wording import (
    capital,
    cause,
    clean,
    deviation,
    effect_name,
    fitted,
    number,
    percent,
    sentence,
    signal_name,
)
from flexjoint.robot import Robot

CHANNELS = 8  # rows of the error table; the JSON and the report hold all
PATIENCE = 2.0  # [s] that work may last before a bar is worth showing
_ASCII = str.maketrans({"±": "+-", "→": "->", "–": "-", "²": "2", "\ufffd": "?"})


def summary(diagnosis: Diagnosis, robot: Robot, console: Console) -> None:
    """Print the verdict, the causes, what they are tied with, the errors before and after, and what next.

    Nothing depends on colour. A console that cannot print Unicode gets ASCII. Names are printed as they
    are: rich's markup in them means nothing.
    """
    say = _Printer(console)
    first, second = sentences.verdict(diagnosis, diagnosis.comparison)
    say.line(f"{sentences.VERDICTS[diagnosis.verdict]}: {clean(robot.name)}", style="bold")
    say.line(first)
    say.line(second)
    if diagnosis.verdict in ("causes", "unexplained"):
        say.line(sentence(capital(diagnosis.reason)), style="dim")
    if diagnosis.findings:
        _causes(say, diagnosis)
    for tie in sentences.ties(diagnosis):
        say.line(tie)
    for line in sentences.numbers(diagnosis):
        say.line(line)
    for finding in diagnosis.findings:
        if finding.hidden_by_refit:
            name = capital(cause(finding.effect, finding.joint))
            say.line(f"{name} would be hidden by a refit of the nominal numbers.")
    _errors(say, diagnosis)
    _open_ends(say, diagnosis, robot.prismatic)
    if diagnosis.next_experiment:
        say.heading("Next experiment")
        say.line(sentence(capital(diagnosis.next_experiment)))


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

    def line(self, text: str, style: str = "") -> None:
        if text:
            self._console.print(self.text(text, style))

    def heading(self, text: str) -> None:
        self._console.print()
        self.line(text, style="bold")

    def table(self, heads: Iterable[tuple[str, bool]], rows: Iterable[Iterable[str]]) -> None:
        """Columns as (title, whether numbers stand to the right)."""
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, safe_box=True)
        for title, right in heads:
            table.add_column(
                self.text(title), justify="right" if right else "left", overflow="fold", no_wrap=False
            )
        for row in rows:
            table.add_row(*(self.text(cell) for cell in row))
        self._console.print(table)
        self._console.print()


def _causes(say: _Printer, diagnosis: Diagnosis) -> None:
    say.heading("Causes")
    rows = []
    for finding in diagnosis.findings:
        lines = [f"{clean(name)} {fitted(value)}" for name, value in finding.parameters.items()]
        if finding.since is not None:
            lines.append(f"since t = {finding.since:.4g} s")
        rows.append(
            (
                effect_name(finding.effect),
                clean(finding.joint) if finding.joint is not None else "whole robot",
                "\n".join(lines),
                percent(finding.probability),
                percent(finding.gain),
            )
        )
    heads = (
        ("effect", False),
        ("joint", False),
        ("parameters", False),
        ("prob.", True),
        ("removes", True),
    )
    say.table(heads, rows)


def _errors(say: _Printer, diagnosis: Diagnosis) -> None:
    gain = diagnosis.comparison
    errors = merit.channel_errors(gain)
    if gain is None or not errors:
        return
    worst = sorted(errors, key=lambda error: -error.before if error.before == error.before else 0.0)
    data = "on data that the fit did not see" if gain.held_out else "on the data of the fit"
    say.heading(f"Error of the simulation (NRMSE, {data})")
    two = bool(diagnosis.findings)
    rows = []
    for error in worst[:CHANNELS]:
        after = (number(error.after), percent(error.removed)) if two else ()
        rows.append(
            (f"{error.channel}.{clean(error.joint)}", number(error.before), *after, number(error.floor))
        )
    middle = (("after", True), ("removed", True)) if two else ()
    heads = (("channel", False), ("before" if two else "error", True), *middle, ("noise alone", True))
    say.table(heads, rows)
    if len(worst) > CHANNELS:
        say.line(f"{len(worst) - CHANNELS} more channels err less.", style="dim")


def _open_ends(say: _Printer, diagnosis: Diagnosis, prismatic: Collection[str]) -> None:
    said = diagnosis.verdict == "unexplained" and len(diagnosis.unexplained) == 1  # in the first sentence
    if diagnosis.unexplained and not said:
        say.heading("Remains unexplained")
    for left in () if said else diagnosis.unexplained:
        say.line(
            f"{percent(left.share)} of the {clean(left.balance)} balance's error at {clean(left.joint)};"
            f" it depends most on {signal_name(left.against)}."
        )
    if diagnosis.not_excited:
        joints: dict[str, list[str]] = {}
        for effect, joint in diagnosis.not_excited:
            joints.setdefault(effect_name(effect), []).extend([] if joint is None else [clean(joint)])
        say.heading("Not excited, so nothing is said of")
        say.line(sentence("; ".join(f"{n} ({', '.join(j)})" if j else n for n, j in joints.items())))
    if diagnosis.within_tolerance:
        say.heading("Within the tolerance of the nominal numbers")
        sizes = (
            f"{cause(w.effect, w.joint)} {deviation(w.effect, w.value, w.joint in prismatic)}"
            for w in diagnosis.within_tolerance
        )
        say.line(sentence(", ".join(sizes)))
    for note in diagnosis.notes:
        say.line(sentence(capital(note)), style="dim")
