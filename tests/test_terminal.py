"""A diagnosis on the terminal: at 80 columns, without colour, in ASCII; and the progress bar."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest
from rich.console import Console

from flexjoint import diagnosis as d
from flexjoint import terminal
from flexjoint.effect import plan
from flexjoint.robot import Robot

ARM = cast(Robot, SimpleNamespace(name="arm2", prismatic=frozenset()))  # what a summary asks a robot
NRMSE = {
    f"{channel}.{joint}": 0.2
    for channel in ("q", "dq", "theta", "dtheta", "tau_t")
    for joint in ("a", "elbow")
}


def backlash(joint: str = "elbow") -> d.Finding:
    return d.Finding(
        "backlash",
        joint,
        0.97,
        {"gap": d.Fitted(0.0112, 0.0002, "rad")},
        4.0,
        0.31,
        "mechanical",
        plan("backlash", joint, {"gap": 0.0112}),
        indistinguishable=(d.Tie("transmission_error", joint, "the load keeps its sign"),),
        hidden_by_refit=True,
    )


CAUSES = d.Diagnosis(
    "causes",
    "one cause brings the residual down to its noise",
    findings=(backlash(),),
    unexplained=(d.Unexplained("elbow", "spring", 0.04, "theta"),),
    not_excited=(("end_stop", "elbow"), ("end_stop", "a")),
    within_tolerance=(d.WithinTolerance("payload", "elbow", 0.008),),
    comparison=d.Gain(
        True,
        0.5,
        {"rms": NRMSE, "nrmse": NRMSE},
        {"rms": {}, "nrmse": {key: 0.02 for key in NRMSE}},
        {"nrmse": {key: 0.01 for key in NRMSE}},
    ),
    next_experiment="load the elbow from both sides",
    notes=("encoder offsets were estimated",),
)
HEALTHY = d.Diagnosis("healthy", "nothing beats the noise", comparison=CAUSES.comparison)
UNEXPLAINED = d.Diagnosis(
    "unexplained", "nothing fits", unexplained=(d.Unexplained("elbow", "motor", 0.93, "dtheta"),)
)
REFUSED = d.Diagnosis("refused", "the recording holds no motor torque", next_experiment="record tau_m")


def printed(diagnosis: d.Diagnosis, width: int = 80, encoding: str = "utf-8") -> str:
    """What a pipe receives."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    terminal.summary(diagnosis, ARM, Console(file=stream, width=width))
    stream.flush()
    return cast(io.BytesIO, stream.buffer).getvalue().decode(encoding)


def test_everything_that_was_found_is_said():
    text = " ".join(printed(CAUSES).split())
    for said in (
        "Causes named: arm2",
        "because the model lacks backlash at elbow (gap 0.0112 ± 0.0002 rad)",
        "gap 0.0112 ± 0.0002 rad 97% 31%",
        "since t = 4 s",
        "removes 90% of the error: it falls from 20% to 2.0%",
        "cannot tell backlash at elbow from transmission error at elbow: the load keeps its sign.",
        "would be hidden by a refit",
        "q.elbow 0.2 0.02 90% 0.01",
        "2 more channels",
        "4.0% of the spring balance's error at elbow; it depends most on motor position theta.",
        "Not excited, so nothing is said of end stop (elbow, a).",
        "payload at elbow 0.008 kg",
        "Encoder offsets were estimated.",
        "Next experiment Load the elbow from both sides.",
    ):
        assert said in text, said


@pytest.mark.parametrize(
    ("diagnosis", "said"),
    [
        (HEALTHY, "Healthy: arm2 The simulation agrees with the recording"),
        (UNEXPLAINED, "no effect of the catalogue accounts for it: 93% of the motor balance's error"),
        (REFUSED, "This recording cannot carry a verdict: the recording holds no motor torque."),
    ],
)
def test_the_other_verdicts_say_what_they_are(diagnosis, said):
    assert said in " ".join(printed(diagnosis).split())


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize(
    "joint", ["elbow", "left_front_upper_leg_" * 6, "[red]a[/red] [/] \u20ac\x1b[2J\u202e"]
)
def test_it_fits_80_columns_and_holds_no_codes(joint, encoding):
    finding = backlash("elbow")
    diagnosis = replace(
        CAUSES,
        findings=(replace(finding, joint=joint), replace(finding, joint=None)),
        unexplained=(d.Unexplained(joint, "spring", 0.04, joint),),
        comparison=d.Gain(True, 0.5, {"nrmse": {f"q.{joint}": 0.3}}, {}, {}),
    )
    text = printed(diagnosis, encoding=encoding)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "\x1b" not in text and "\u202e" not in text
    if joint.startswith("[red]"):
        assert "[red]a[/red] [/]" in text  # a name is no markup
    if encoding == "ascii":
        assert "0.0112 +- 0.0002" in text


def test_colour_is_never_needed(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    stream = io.StringIO()
    terminal.summary(CAUSES, ARM, Console(file=stream, width=80, force_terminal=True))
    assert "\x1b[3" not in stream.getvalue()  # bold is allowed, colours are not
    assert "Causes named" in stream.getvalue()


@pytest.fixture
def clock() -> Iterator[list[float]]:
    yield [100.0]


def screen(is_terminal: bool, monkeypatch: pytest.MonkeyPatch, term: str = "xterm") -> Console:
    monkeypatch.setenv("TERM", term)
    return Console(file=io.StringIO(), width=80, force_terminal=is_terminal)


def run(console: Console, clock: list[float], seconds: float, what: str = "scan") -> str:
    with terminal.Progress(console, lambda: clock[0]) as progress:
        for step in range(5):
            progress(step / 4, what)
            clock[0] += seconds / 4
    return cast(io.StringIO, console.file).getvalue()


def test_long_work_shows_its_progress_on_a_terminal(clock, monkeypatch):
    text = run(screen(True, monkeypatch), clock, 8.0, "scan [bold]of backlash")
    assert "scan [bold]of backlash" in text and "100%" in text


def test_short_work_pipes_and_dumb_terminals_show_nothing(clock, monkeypatch):
    assert run(screen(True, monkeypatch), clock, 1.0) == ""
    assert run(screen(False, monkeypatch), clock, 60.0) == ""
    assert run(screen(True, monkeypatch, term="dumb"), clock, 60.0) == ""


def test_fractions_beyond_the_end_are_harmless(clock, monkeypatch):
    console = screen(True, monkeypatch)
    progress = terminal.Progress(console, lambda: clock[0])
    clock[0] += 3.0
    progress(1.7, "late")
    progress.close()
    progress.close()
    assert "100%" in cast(io.StringIO, console.file).getvalue()


def test_the_null_progress_says_nothing(capsys):
    terminal.no_progress(0.5, "scan")
    assert capsys.readouterr() == ("", "")
