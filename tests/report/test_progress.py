"""The progress of a long command: a bar on a terminal, lines elsewhere, and how long it takes."""

from __future__ import annotations

import io
import time
from typing import cast

import pytest
from rich.console import Console

from flexjoint.core.running import progress as silent_progress
from flexjoint.report.progress import Progress, duration


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def screen(is_terminal: bool, monkeypatch: pytest.MonkeyPatch, term: str = "xterm") -> Console:
    monkeypatch.setenv("TERM", term)
    return Console(file=io.StringIO(), width=80, force_terminal=is_terminal)


def text_of(console: Console) -> str:
    return cast(io.StringIO, console.file).getvalue()


def run(console: Console, seconds: float, what: str = "scan") -> str:
    clock = Clock()
    with Progress(console, clock) as progress:
        for step in range(5):
            progress(step / 4, what)
            clock.now += seconds / 4
    return text_of(console)


def test_long_work_shows_its_progress_on_a_terminal(monkeypatch):
    text = run(screen(True, monkeypatch), 8.0, "scan [bold]of backlash")
    assert "scan [bold]of backlash" in text and "100%" in text


def test_short_work_shows_nothing(monkeypatch):
    assert run(screen(True, monkeypatch), 1.0) == ""
    assert run(screen(False, monkeypatch), 8.0) == ""


def test_fractions_beyond_the_end_are_harmless(monkeypatch):
    console, clock = screen(True, monkeypatch), Clock()
    progress = Progress(console, clock)
    clock.now += 3.0
    progress(1.7, "late")
    progress.close()
    progress.close()
    assert "100%" in text_of(console)


@pytest.mark.parametrize("term", ["xterm", "dumb"])
def test_a_pipe_gets_a_line_now_and_then_also_during_a_step(monkeypatch, term):
    console, clock = screen(term == "dumb", monkeypatch, term), Clock()
    with Progress(console, clock, interval=0.02) as progress:
        progress(0.1, "first")
        clock.now += 10.0
        progress(0.3, "second\x1b[31m")
        waited(lambda: text_of(console).count("\n") >= 3)
    lines = text_of(console).splitlines()
    # 0.2 of the work took 10 s, so that the other 0.7 take 35 s
    assert set(lines) == {"flexjoint: 30 %, second\ufffd[31m, about 35 s left"}
    time.sleep(0.05)
    assert text_of(console).splitlines() == lines  # nothing after the end


def test_a_run_of_more_than_a_minute_says_so_first(monkeypatch):
    for expected in (59.0, 200.0):
        console = screen(False, monkeypatch)
        with Progress(console, Clock()) as progress:
            progress.expect(expected)
        assert text_of(console) == ("" if expected < 60.0 else "flexjoint: this will take about 3 min\n")


def test_what_was_expected_gives_way_to_what_is_seen(monkeypatch):
    clock = Clock()
    with Progress(screen(False, monkeypatch), clock) as progress:
        progress.expect(50.0)
        assert progress.left() == pytest.approx(50.0)
        progress(1e-3, "")
        clock.now += 10.0
        progress(0.251, "")
        # by what is seen 30 s, by what was expected 40 s, half and half
        assert progress.left() == pytest.approx(0.502 * 29.96 + 0.498 * 40.0, rel=1e-3)
        clock.now += 10.0
        progress(0.501, "")
        assert progress.left() == pytest.approx(20.0, rel=0.01)


def test_work_that_tells_how_fast_it_goes_says_how_long_it_takes(monkeypatch):
    console, clock = screen(False, monkeypatch), Clock()
    with Progress(console, clock) as progress:
        clock.now += 30.0  # of getting ready
        for k in range(6):
            progress((k + 1) / 100, "")
            clock.now += 1.0
    assert text_of(console) == "flexjoint: this will take about 2 min\n"


def test_a_stream_that_was_closed_is_no_matter(monkeypatch):
    console = screen(False, monkeypatch)
    with Progress(console, Clock()) as progress:
        cast(io.StringIO, console.file).close()
        progress.expect(200.0)


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0.2, "about 1 s"),
        (8.4, "about 8 s"),
        (57.0, "about 55 s"),
        (200.0, "about 3 min"),
        (9e3, "about 2.5 h"),
    ],
)
def test_times_are_told_as_well_as_they_are_known(seconds, said):
    assert duration(seconds) == said


def test_the_silent_progress_says_nothing(capsys):
    silent_progress.silent(0.5, "scan")
    assert capsys.readouterr() == ("", "")


def test_a_part_is_a_share_of_the_whole():
    told: list[tuple[float, str]] = []
    silent_progress.part(lambda share, what: told.append((share, what)), 0.2, 0.5)(0.5, "scan")
    assert told == [(pytest.approx(0.45), "scan")]


def waited(there, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end
        time.sleep(0.01)
