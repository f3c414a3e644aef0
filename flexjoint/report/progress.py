"""The progress of a long command on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich import progress
from rich.console import Console

from flexjoint.diagnosis.result.wording import clean

PATIENCE = 2.0  # s of work before a bar is shown, or a time is told from the share that is done
INTERVAL = 10.0  # s between two lines where there is no terminal
LONG = 60.0  # s, beyond which a run says how long it will take
TOLD = 0.01  # share of the work from which on it tells how long the rest takes


class Progress:
    """Shows how far a long computation is: `progress(fraction, what)`, with a fraction in [0, 1].

    On a terminal a bar appears after about two seconds of work, elsewhere a line every ten; both say what is
    done and how much time is left, and where the whole takes more than a minute a line says so first. Use it
    as a context manager, so that the bar is taken away and no more lines come at the end.
    """

    def __init__(
        self,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
        interval: float = INTERVAL,
    ) -> None:
        self._console = console if console is not None else Console(file=sys.stderr)
        self._clock, self._interval = clock, interval
        self._start = clock()
        self._bar: progress.Progress | None = None
        self._task = progress.TaskID(0)
        self._done, self._what = 0.0, ""
        self._begun: tuple[float, float] | None = None  # when, and at which share, work first told of itself
        self._expected: float | None = None  # s, as told beforehand
        self._announced = False
        self._over = threading.Event()
        self._ticker: threading.Thread | None = None

    def expect(self, seconds: float) -> None:
        """Say how long the work will take, where that is more than a minute; time left is counted from it
        until the work itself tells."""
        self._expected = seconds
        if seconds > LONG:
            self._announce(seconds)

    def __call__(self, fraction: float, what: str) -> None:
        """Say that this share of the work is done and what is being done now."""
        self._done, self._what = min(max(fraction, 0.0), 1.0), clean(what)
        now = self._clock()
        if self._begun is None and self._done > 0.0:
            self._begun = (now, self._done)
        drawn = self._console.is_terminal and not self._console.is_dumb_terminal
        if not drawn and self._ticker is None and not self._over.is_set():
            self._ticker = threading.Thread(target=self._tick, daemon=True, name="progress")
            self._ticker.start()
        if now - self._start < PATIENCE:
            return
        if not self._announced and self._expected is None:
            left = self._by_share()
            if left is not None and now - self._start + left > LONG:
                self._announce(now - self._start + left)
        if drawn:
            self._draw()

    def left(self) -> float | None:
        """Seconds that are left, as far as that is known."""
        told, by_share = self._expected, self._by_share()
        if told is None:
            return by_share
        told = max(0.0, told - (self._clock() - self._start))
        if by_share is None:
            return told or None  # it takes longer than was told: nobody knows how long
        # the first steps tell little of the others: what was told beforehand counts until half is done
        weight = min(1.0, 2.0 * self._done)
        return weight * by_share + (1.0 - weight) * told

    def _by_share(self) -> float | None:
        """Seconds that are left by how fast the work went since it first told of itself."""
        if self._begun is None:
            return None
        seconds, share = self._clock() - self._begun[0], self._done - self._begun[1]
        if seconds < PATIENCE or share < TOLD:
            return None
        return seconds * (1.0 - self._done) / share

    def line(self) -> str:
        """What a line without a terminal says now."""
        left = self.left()
        rest = "" if left is None or self._done >= 1.0 else f", {duration(left)} left"
        what = f", {self._what}" if self._what else ""
        return f"{100.0 * self._done:.0f} %{what}{rest}"

    def close(self) -> None:
        """Take the bar away, and end the lines; nothing when there is neither."""
        self._over.set()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _announce(self, seconds: float) -> None:
        self._announced = True
        self._say(f"this will take {duration(seconds)}")

    def _draw(self) -> None:
        if self._bar is None:
            self._bar = progress.Progress(
                progress.TextColumn("{task.description}", markup=False),
                progress.BarColumn(),
                progress.TaskProgressColumn(),
                progress.TextColumn("{task.fields[left]}", markup=False),
                console=self._console,
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=1.0, left="")
        left = self.left()
        said = "" if left is None or self._done >= 1.0 else f"{duration(left)} left"
        self._bar.update(self._task, completed=self._done, description=self._what, left=said)

    def _tick(self) -> None:
        """A line every some seconds, also while a step takes longer than that."""
        while not self._over.wait(self._interval):
            self._say(self.line())

    def _say(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # a stream that was closed
            self._console.print(f"flexjoint: {text}", markup=False, highlight=False, soft_wrap=True)


def duration(seconds: float) -> str:
    """A time that need not be known well: about 40 s, about 5 min, about 2 h."""
    if seconds < 100.0:
        return f"about {max(1, round(seconds / 5) * 5 if seconds > 10 else round(seconds))} s"
    if seconds < 6000.0:
        return f"about {round(seconds / 60)} min"
    return f"about {seconds / 3600:.2g} h"
