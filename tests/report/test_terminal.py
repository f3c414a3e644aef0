"""A diagnosis on the terminal: at 80 columns, without colour, in ASCII; and the progress bar."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console
from support.fake_diagnosis import slide, traced

from flexjoint.diagnosis import result as d
from flexjoint.diagnosis.result import sentences
from flexjoint.diagnosis.result.wording import when
from flexjoint.effects import effect
from flexjoint.report import terminal

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
        effect("backlash", joint, gap=0.0112),
        indistinguishable=(d.Tie("transmission_error", joint, "fits as well, as the load keeps its sign"),),
        hidden_by_refit=True,
        removed=d.Removed(joint, "spring", 3.1, 0.21, 0.1, "phi"),
    )


CAUSES = d.Diagnosis(
    "causes",
    "one cause brings the residual down to its noise",
    findings=(backlash(),),
    unexplained=(d.Unexplained("elbow", "spring", 0.04, "theta"),),
    remaining=(
        d.Remaining("a", 30.0, 0.5, 0.4, 0.3, 0.1, "q"),
        d.Remaining("elbow", 10.0, 4.0, 0.6, 0.2, 0.45, "q.a"),
    ),
    not_excited=(("end_stop", "elbow"), ("end_stop", "a")),
    within_tolerance=(d.WithinTolerance("payload", "elbow", "mass", 0.008),),
    comparison=d.Gain(
        True,
        0.5,
        {"rms": NRMSE, "nrmse": NRMSE},
        {"rms": {}, "nrmse": {key: 0.02 for key in NRMSE}},
        {"rms": {}, "simulated": {key: 0.01 for key in NRMSE}},
    ),
    next_experiment="load the elbow from both sides",
    notes=("encoder offsets were estimated",),
)
HEALTHY = d.Diagnosis("healthy", "nothing beats the noise", comparison=CAUSES.comparison)
UNEXPLAINED = d.Diagnosis(
    "unexplained",
    "nothing fits",
    unexplained=(d.Unexplained("a", "motor", 0.93, "dtheta"),),  # before tolerances; what is left decides
    remaining=(
        d.Remaining("a", 30.0, 0.9, 0.35, 0.3, 0.1, "q"),
        d.Remaining("elbow", 10.0, 4.0, 3.8, 0.2, 3.0, "dtheta"),
    ),
)
REFUSED = d.Diagnosis("refused", "the recording holds no motor torque", next_experiment="record tau_m")


@dataclass(frozen=True)
class Machine:
    """What a summary tells of a robot: its name, joints that slide, and whether none has a spring."""

    name: str = "arm2"
    slides: tuple[str, ...] = ()
    rigid: bool = False


ARM = Machine()


def printed(diagnosis: d.Diagnosis, width: int = 80, encoding: str = "utf-8", robot: Machine = ARM) -> str:
    """What a pipe receives."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    told = replace(diagnosis, robot=robot.name, prismatic=frozenset(robot.slides), rigid=robot.rigid)
    terminal.summary(told, Console(file=stream, width=width))
    stream.flush()
    return cast(io.BytesIO, stream.buffer).getvalue().decode(encoding)


def words(diagnosis: d.Diagnosis, robot: Machine = ARM) -> str:
    return " ".join(printed(diagnosis, robot=robot).split())


def test_everything_that_was_found_is_said():
    text = words(CAUSES)
    for said in (
        "Causes named: arm2 Is it there? The model lacks backlash at elbow (gap 0.0112 ± 0.0002 rad),"
        " probability 97 %: error of the spring's torque 3.1 → 0.21 N m (93 % less).",
        "Is it all? 0.6 N m of 4 N m are left at elbow (15 %): 6.0 % of its torque and 3 times sensor noise.",
        "Of what is left at elbow, 0.45 N m follow link position q of a, by a law that no named cause has.",
        "Is it this law? This recording cannot distinguish backlash at elbow from transmission error at"
        " elbow: it fits as well, as the load keeps its sign. Next experiment: load the elbow from both"
        " sides.",
        "backlash gap 0.0112 ± 0.0002 rad 97 % spring's torque",
        "since t = 4 s",
        "would be hidden by a refit",
        "Torque error by joint (N m, RMS, on data that the fit did not see)",
        "q.elbow 0.2 0.02 90 % 0.01",
        "2 more channels",
        "4.0 % of the spring balance's squared error at elbow is left; it depends most on motor position",
        "Not excited, so nothing is said of end stop (elbow, a).",
        "payload at elbow +0.008 kg",
        "Encoder offsets were estimated.",
    ):
        assert said in text, said


def test_of_many_causes_the_kinds_of_those_that_are_not_told_are_counted():
    other = replace(backlash(), effect="payload")
    text = words(replace(CAUSES, findings=(*[backlash()] * 5, other)))
    assert "and 3 more: backlash at 2 joints and payload at elbow." in text


def test_of_many_causes_that_a_refit_would_hide_their_number_is_said():
    few, many = (words(replace(CAUSES, findings=(backlash(),) * count)) for count in (3, 4))
    assert "Backlash at elbow, backlash at elbow and backlash at elbow would be hidden by a refit" in few
    assert "4 of these 4 causes would be hidden by a refit" in many


def test_the_torque_of_every_joint_is_stated_in_three_units():
    text = words(CAUSES)
    assert "joint torque before after of before of torque x noise" in text
    assert "a 30 0.5 0.4 80 % 1.3 % 1.3" in text
    assert "elbow 10 4 0.6 15 % 6.0 % 3" in text


@pytest.mark.parametrize(
    ("diagnosis", "said"),
    [
        (HEALTHY, "Healthy: arm2 The simulation agrees with the recording"),
        (
            UNEXPLAINED,
            "Is it there? The simulation is wrong at elbow, and no effect of the catalogue accounts for it."
            " What is left? 3.8 N m of 4 N m are left at elbow (95 %): 38 % of its torque and 19 times sensor"
            " noise. Of what is left at elbow, 3 N m follow motor velocity dtheta, by a law that no effect of"
            " the catalogue has.",
        ),
        (
            REFUSED,
            "This recording cannot carry a verdict: the recording holds no motor torque. Nothing is claimed"
            " about the simulation, neither that it is right nor that it is wrong. What to do: Record tau_m.",
        ),
    ],
)
def test_the_other_verdicts_say_what_they_are(diagnosis, said):
    assert said in words(diagnosis)


def test_nobody_is_blamed_for_what_tolerances_cover():
    """The raw error of joint a is large; nominal numbers within their tolerances leave the noise of it."""
    text = words(UNEXPLAINED)
    assert "wrong at a" not in text and "93" not in text


def test_what_is_noise_is_called_so():
    """Of a small error under noisy currents 57 % are left, and nobody can do better."""
    noisy = replace(CAUSES, remaining=(d.Remaining("elbow", 10.0, 0.8, 0.456, 0.45, 0.0, "t"),))
    said = "0.456 N m of 0.8 N m are left at elbow (57 %): 4.6 % of its torque and no more than sensor noise."
    assert said in words(noisy)


def test_most_of_an_error_may_be_numbers_within_their_tolerances():
    """Nobody who reads on would think that the simulation cannot be mended."""
    covered = replace(
        UNEXPLAINED,
        remaining=(d.Remaining("elbow", 10.0, 4.0, 0.4, 0.2, 0.1, "q"),),
        within_tolerance=(d.WithinTolerance("motor_viscous_friction", "elbow", "coefficient", 3.2),),
        comparison=CAUSES.comparison,
    )
    text = words(covered)
    assert "account for 90 % of the torque error at elbow (motor viscous friction +3.2 N m s/rad)." in text
    assert "of the signals' standard deviation" in text and "with the nominal numbers as they are." in text
    assert "nothing that was tried removes it" not in text and "The simulation is wrong" not in text


def test_friction_within_its_tolerance_is_no_law_without_a_name():
    """What is left is counted beside the friction that a model claims, which may be off."""
    left = d.Remaining("elbow", 10.0, 4.0, 3.8, 0.2, 3.5, "dtheta")
    off = d.WithinTolerance("motor_coulomb_friction", "elbow", "level", -3.4)
    partial = replace(UNEXPLAINED, findings=(backlash(),), comparison=CAUSES.comparison, remaining=(left,))
    assert "by a law that no named cause has" in words(partial)
    told = words(replace(partial, within_tolerance=(off,)))
    assert "as friction does that is off by no more than its tolerance (motor Coulomb friction -3.4" in told
    assert "no named cause" not in told
    of_position = replace(partial, within_tolerance=(off,), remaining=(replace(left, against="theta"),))
    assert "by a law that no named cause has" in words(of_position)


def test_found_but_not_all_of_it_says_what_was_found_first_and_what_is_left_second():
    partial = replace(UNEXPLAINED, findings=(backlash(),), comparison=CAUSES.comparison)
    text = words(partial)
    found, left = text.index("The model lacks backlash at elbow"), text.index("3.8 N m of 4 N m are left at")
    assert found < left < text.index("So the causes named are not all of it.")
    assert "probability 97 %" in text[found:left]
    without_shape = replace(partial, remaining=(d.Remaining("elbow", 10.0, 4.0, 3.8, 0.2, 0.3, "dtheta"),))
    assert "What is left at elbow follows no single signal." in words(without_shape)


def test_what_hides_in_the_noise_of_a_torque_is_told_by_all_balances_together():
    """An unexplained error beside "1 times sensor noise" would contradict itself."""
    hidden = replace(
        UNEXPLAINED,
        remaining=(d.Remaining("elbow", 10.0, 0.22, 0.21, 0.2, 0.02, "q"),),
        energy=(900.0, 529.0),
    )
    assert "are left at 23 times the noise" in words(hidden)
    assert "times the noise" not in words(replace(UNEXPLAINED, energy=(900.0, 529.0)))  # its torque shows it
    assert "times the noise" not in words(replace(hidden, verdict="causes"))


def test_another_joint_of_which_more_is_left_is_named_too():
    joints = (
        d.Remaining("a", 30.0, 20.0, 0.6, 0.3, 0.1, "q"),
        d.Remaining("b", 2.0, 0.5, 0.4, 0.1, 0.0, "t"),
    )
    text = words(replace(CAUSES, remaining=joints))
    assert "0.6 N m of 20 N m are left at a (3.0 %)" in text
    assert "Most, for its torque: 0.4 N m of 0.5 N m are left at b (80 %): 20 % of its torque" in text


def test_a_leftover_of_the_size_of_the_noise_follows_nothing():
    joints = (d.Remaining("elbow", 10.0, 4.0, 0.28, 0.2, 0.25, "q"),)
    assert "follow link position" not in words(replace(CAUSES, remaining=joints))


# ------------------------------------------------------------------ the signal that the cause moves
def test_the_simulation_is_quoted_where_the_cause_acts():
    """The wrist errs most and gains nothing; the deflection of the cause's own joint gains sixteenfold."""
    rms = {"q.wrist": 0.02, "q.elbow": 0.01, "phi.elbow": 0.0032}
    nrmse = {"q.wrist": 0.9, "q.elbow": 0.023, "phi.elbow": 0.32}
    less = {"phi.elbow": 0.0002}, {"phi.elbow": 0.02}
    gain = d.Gain(
        True, 0.5, {"rms": rms, "nrmse": nrmse}, {"rms": rms | less[0], "nrmse": nrmse | less[1]}, {}
    )
    text = words(replace(CAUSES, comparison=gain))
    assert (
        "the error of deflection theta - q at elbow falls: 0.0032 → 0.0002 rad; 32 % → 2.0 % of its standard"
        " deviation." in text
    )


def test_a_cause_of_the_whole_robot_is_quoted_where_the_error_falls_most():
    tilt = replace(
        backlash(), effect="base_tilt", joint=None, removed=d.Removed("a", "link", 5.0, 1.0, 0, "q")
    )
    gain = d.Gain(True, 0.5, {"nrmse": {"q.a": 0.5, "q.b": 0.3}}, {"nrmse": {"q.a": 0.4, "q.b": 0.1}}, {})
    text = words(replace(CAUSES, findings=(tilt,), comparison=gain))
    assert "the error of link position q at b falls: 30 % → 10 % of its standard deviation." in text
    assert "torque error of the link at a 5 → 1 N m (80 % less)" in text


def load(**more: Any) -> d.Finding:
    return replace(
        backlash(),
        effect="payload",
        parameters={"mass": d.Fitted(1.5, 0.01, "kg")},
        planned=effect("payload", "elbow", mass=1.5),
        **more,
    )


def test_a_load_is_quoted_at_the_joint_that_carries_it():
    gain = d.Gain(
        True, 0.5, {"nrmse": {"q.elbow": 0.012, "q.a": 0.7}}, {"nrmse": {"q.elbow": 0.011, "q.a": 0.03}}, {}
    )
    text = words(replace(CAUSES, findings=(load(),), comparison=gain))
    assert "the error of link position q at a falls: 70 % → 3.0 % of its standard deviation." in text


@pytest.mark.parametrize(
    ("during", "said"),
    [
        (((0.0, 3.104),), "at t = 0 to 3.104 s"),
        (((3.104, 6.4), (10.2, None)), "at t = 3.104 to 6.4 s and since 10.2 s"),
        (
            tuple((float(k), k + 0.5) for k in range(6)),
            "6 times, first at t = 0 to 0.5 s, last at t = 5 to 5.5",
        ),
    ],
)
def test_when_a_load_was_there_is_said(during: tuple[tuple[float, float | None], ...], said: str):
    found = load(since=during[0][0], during=during)
    assert when(found).startswith(said)
    assert said[:8] in words(replace(CAUSES, findings=(found,)))


def test_a_law_in_the_place_of_a_listed_one_is_told_so():
    coulomb = replace(backlash(), effect="motor_coulomb_friction")
    note = "in the place of motor Coulomb friction (25 → 3.5 N m)"
    text = words(replace(CAUSES, findings=(replace(backlash(), instead_of=coulomb, note=note),)))
    assert f"(gap 0.0112 ± 0.0002 rad, {note}), probability 97 %" in text


def test_a_law_and_the_claim_in_whose_place_it_is_are_not_told_as_correlated():
    dahl = replace(backlash(), effect="dahl_friction", joint="elbow")
    coulomb = replace(dahl, effect="motor_coulomb_friction")
    names = ("dahl_friction.elbow.level", "dahl_friction.elbow.scale", "motor_coulomb_friction.elbow.level")
    correlation = np.array([[1.0, -0.97, 0.99], [-0.97, 1.0, 0.2], [0.99, 0.2, 1.0]])
    result = replace(
        CAUSES,
        findings=(replace(dahl, instead_of=coulomb),),
        estimation=d.Estimation("balances", "", names, correlation),
    )
    (told,) = sentences.numbers(result)
    assert "scale of Dahl friction at elbow and level of Dahl friction at elbow" in told
    assert len(sentences.numbers(replace(result, findings=(dahl, coulomb)))) == 2


def test_no_fall_is_no_gain():
    gain = d.Gain(
        True, 0.5, {"nrmse": {"q.elbow": 0.2, "q.a": 0.9}}, {"nrmse": {"q.elbow": 0.2, "q.a": 0.1}}, {}
    )
    text = words(replace(CAUSES, comparison=gain))
    assert "the error of no measured signal of elbow becomes smaller with it" in text


# ------------------------------------------------------------------ possible causes, tables, rigid joints
def test_a_cause_more_likely_absent_stands_apart():
    unsure = replace(backlash("a"), probability=0.23)
    text = words(replace(CAUSES, findings=(backlash(), unsure)))
    first, apart = (text.index(head) for head in ("Causes cause numbers", "Possible, not in the extended"))
    assert "97 %" in text[first:apart] and "23 %" not in text[first:apart]
    assert "23 %" in text[apart:]
    assert "This is with the possible causes, too" in text and "possible causes, too" not in words(CAUSES)
    assert "Possible: backlash at a (gap 0.0112 ± 0.0002 rad), probability 23 %" in text
    alone = words(replace(UNEXPLAINED, findings=(unsure,)))
    assert "Is it there? No cause is more likely there than not. Possible: backlash at a" in alone
    assert "Causes cause" not in alone


@pytest.mark.parametrize("diagnosis", [CAUSES, slide()])
def test_the_table_of_causes_breaks_no_number(diagnosis):
    lines = printed(diagnosis, robot=Machine(slides=("slide",))).splitlines()
    assert max(map(len, lines)) <= 80
    for finding in diagnosis.findings:
        for line in finding.parameters:
            assert any(re.search(rf"{line} \S+ ± \S+ (N|rad) ", row) for row in lines)


def test_without_springs_nothing_speaks_of_springs():
    text = words(slide("unexplained", after=30.0), Machine("screw", ("slide",), True))
    assert not re.search("spring|deflection|transmission|phi|N m|rad", text)
    assert "30 N of 53 N are left at slide (57 %)" in text
    assert "24 N follow load torque tau_t" in text


def test_joints_that_turn_and_slide_have_their_own_units():
    text = words(
        replace(CAUSES, remaining=(*CAUSES.remaining, *slide().remaining)), Machine(slides=("slide",))
    )
    assert "Torque error by joint (RMS, on data" in text
    assert "slide 120 N 53 N 2.2 N 4.2 %" in text and "elbow 10 N m 4 N m 0.6 N m" in text


def test_steps_are_not_for_the_terminal():
    assert printed(traced(CAUSES)) == printed(CAUSES)


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
        remaining=(d.Remaining(joint, 9.0, 4.0, 0.5, 0.1, 0.4, f"q.{joint}"),),
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
    terminal.summary(replace(CAUSES, robot="arm2"), Console(file=stream, width=80, force_terminal=True))
    assert "\x1b[3" not in stream.getvalue()  # bold is allowed, colours are not
    assert "Causes named" in stream.getvalue()
