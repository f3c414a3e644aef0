"""The HTML page of a diagnosis: what it says, that it stands alone, and that hostile names stay text."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import sys
from dataclasses import fields, replace
from html.parser import HTMLParser

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from support.fake_diagnosis import (
    JOINTS,
    STEPS,
    Simulated,
    arm,
    causes,
    delay,
    friction,
    healthy,
    preload,
    refused,
    signals,
    simulation,
    slide,
    traced,
    unexplained,
    views,
)

from flexjoint import report
from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.diagnosis import result as d
from flexjoint.diagnosis.result import sentences, wording
from flexjoint.effects import Effect, Planned, catalogue, effect
from flexjoint.recording import table as recording
from flexjoint.report import plots
from flexjoint.robot import robot


class Page(HTMLParser):
    """Text, tags, and everything that could load something."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.text, self.tags, self.links, self.images = "", [], [], []
        self.open: list[str] = []
        self.feed(html)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href"):
                self.links.append(value or "")
            if tag == "img" and name == "alt":
                self.images.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> does not close what is open"
        if tag in ("td", "th", "dd", "dt", "h3"):
            self.text += " "

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.text += data


@pytest.fixture(scope="module")
def arm2(tmp_path_factory: pytest.TempPathFactory) -> robot.Robot:
    return arm(tmp_path_factory.mktemp("arm2"))


@pytest.fixture(scope="module")
def measured() -> recording.Recording:
    return signals()


@pytest.fixture(scope="module")
def before(measured: recording.Recording) -> Simulated:
    return simulation(measured, 0.5)


@pytest.fixture(scope="module")
def after(measured: recording.Recording) -> Simulated:
    return simulation(measured, 0.05)


@pytest.fixture(scope="module")
def pages(arm2, measured, before, after) -> dict[str, str]:
    return {
        "causes": report.render(causes(measured, before, after), arm2, measured, before, after),
        "healthy": report.render(healthy(measured, after), arm2, measured, after, after),
        "unexplained": report.render(unexplained(measured, before), arm2, measured, before, None),
        "refused": report.render(refused(), arm2, measured),
    }


# --- what the page says ------------------------------------------------------------------------------


def test_causes_are_named_with_numbers_and_ties(pages):
    text = Page(pages["causes"]).text
    for said in (
        "Causes named",
        "Is it there? The model lacks motor Coulomb friction at elbow (level 0.401 ± 0.003 N m), probability"
        " 97 %: torque error 4.02 → 0.161 N m (96 % less); sensor delay at shoulder (delay 0.00512 ± 0.00012"
        " s, channel theta), probability 88 %: error of the spring's torque 0.91 → 0.11 N m (88 % less).",
        "In the simulation of data that the fit did not see, the error of",
        "Is it all? 0.161 N m of 4.02 N m are left at elbow (4.0 %): 2.0 % of its torque and 3.2 times sensor"
        " noise.",
        "4.02 N m torque error at elbow, nominal model 0.161 N m torque error there, with the causes",
        "Torque error by joint",
        "cannot distinguish motor Coulomb friction at elbow from Stribeck friction at elbow or asymmetric"
        " friction at elbow: Stribeck friction at elbow fits as well, as the motion never rests; asymmetric"
        " friction at elbow fits as well, as the motion never rests.",
        "Not distinguishable from Stribeck friction at elbow or asymmetric friction at elbow. Each fits as"
        " well, as the motion never rests.",
        "Motor Coulomb friction at elbow",
        "Dry friction on the motor shaft",
        "97 %",
        "Sensor delay at shoulder",
        "0.00512 ± 0.00012 s",
        "t = 7.5 s",
        "A refit of the nominal numbers would absorb most of this cause",
        "4.3 % of the spring balance's squared error at elbow is left; it depends most on motor position",
        "End stop: whole robot",
        "Cable spring: elbow",
        "payload at elbow: +0.008 kg",
        "Next experiment: hold the elbow still for 2 s between moves",
        "Encoder offsets were estimated on the first 0.5 s.",
        "motor viscous friction at elbow",
        "64.2 before, 1.04 after",
        "monday.csv",
        "stiffness 2.0 %, damping 10 %",
    ):
        assert said in text, said


def test_the_other_verdicts_say_what_they_are(pages):
    healthy_text = Page(pages["healthy"]).text
    assert "Healthy" in healthy_text and "agrees with the recording within the noise" in healthy_text
    assert "with the named causes" not in healthy_text
    lost = Page(pages["unexplained"]).text
    assert "The simulation is wrong at elbow, and no effect of the catalogue accounts for it." in lost
    assert "3.86 N m of 4.02 N m are left at elbow (96 %)" in lost
    assert (
        "3.1 N m follow motor velocity dtheta" in lost
        and "Next experiment: turn the elbow slowly both ways" in lost
    )
    none = Page(pages["refused"]).text
    assert "cannot carry a verdict: the recording holds no motor torque." in none
    assert "What to do: Record tau_m beside theta and q." in none


def test_every_measure_at_the_top_has_its_unit(arm2, measured):
    """A cause that removes nearly all of a torque error need not help the simulation: both are said apart."""
    sliding = replace(slide(), findings=(replace(slide().findings[0], gain=0.9991),))
    text = Page(report.render(sliding, drive(arm2), measured)).text
    top = text[: text.index("Asymmetric friction at slide")]
    for said in (
        "53 N torque error at slide, nominal model",
        "2.2 N torque error there, with the causes",
        "3.2 % → 2.8 % error of motor position theta at slide in the simulation, of its standard deviation"
        " (NRMSE)",
    ):
        assert said in top, said
    assert "> 99 %" not in text


def drive(arm2: robot.Robot) -> robot.Robot:
    """The arm as if its joints were rigid and one, which its URDF does not have, slid."""
    stiff = tuple(replace(j, drive=replace(j.drive, K=math.inf)) for j in arm2.joints)
    return _Sliding(**{f.name: getattr(arm2, f.name) for f in fields(robot.Robot)} | {"joints": stiff})


class _Sliding(robot.Robot):
    @property
    def prismatic(self) -> frozenset[str]:
        return frozenset(["slide"])


def test_a_page_of_rigid_joints_speaks_of_friction_and_load(arm2, measured):
    at = {"dtheta": measured.get("dtheta", "elbow"), "tau_t": measured.get("tau_t", "elbow")}
    view = replace(views(measured)[3], joint="slide", signals=at)
    page = Page(report.render(replace(slide(), residuals=(view,)), drive(arm2), measured))
    said = " ".join([page.text, *page.images])
    said = said.replace("spring_", "")  # names of files
    assert not re.search("spring|deflection|transmission|phi|stiffness|N m", said, re.IGNORECASE)
    assert "over load torque tau_t" in said and "load of the model" in said


def test_possible_causes_stand_apart(arm2, measured, before, after):
    diagnosis = causes(measured, before, after)
    diagnosis = replace(diagnosis, findings=(*diagnosis.findings, preload()))
    text = Page(report.render(diagnosis, arm2, measured, before, after)).text
    apart = text.index("Possible, not in the extended model")
    assert text.index("Sensor delay at shoulder") < apart < text.index("possibleSpring preload at shoulder")
    assert "is there 23 %" in text[apart:]
    alone = replace(diagnosis, verdict="unexplained", findings=(preload(),))
    text = Page(report.render(alone, arm2, measured, before, after)).text
    assert "No cause is more likely there than not." in text and "1Spring preload" not in text


def test_the_steps_are_folded_away(pages, arm2, measured, before, after):
    html = report.render(traced(causes(measured, before, after)), arm2, measured, before, after)
    page = Page(html)
    assert page.tags.count("details") == 1 and "<details open" not in html
    folded = page.text[page.text.index("How the causes were found, step by step (2)") :]
    for step in STEPS:
        assert step.text in folded or step.text[0].upper() + step.text[1:] in folded
    assert "details" not in Page(pages["causes"]).tags


def test_partial_findings_of_an_unexplained_error_are_named(measured, before):
    partial = replace(unexplained(measured, before), findings=(delay(),))
    found, left, _ = sentences.statements(partial, partial.comparison, wording.Joints())
    assert found.lines[0].startswith("The model takes no account of sensor delay at shoulder (delay 0.00512")
    assert "probability 88 %" in found.lines[0]
    assert left.lines[0].startswith("3.86 N m of 4.02 N m are left at elbow (96 %)")
    assert left.lines[-1] == "So the causes named are not all of it."


def test_diagnoses_without_torque_errors_have_a_page(arm2, measured, before, after):
    """Where no motor torque was recorded there is none to state."""
    findings = tuple(replace(f, removed=None) for f in (friction(), delay()))
    bare = replace(causes(measured, before, after), remaining=(), findings=findings)
    text = Page(report.render(bare, arm2, measured, before, after)).text
    assert "Torque error by joint" not in text and "torque error at" not in text
    assert "Two causes bring the residual down to its noise." in text  # the reason, as nothing else says it
    assert "4.3 % of the spring balance's squared error at elbow is left" in text
    none = sentences.statements(replace(bare, unexplained=()), None, wording.Joints())[1]
    assert none.lines == ("No joint's torque was compared on unseen data: what is left is not known.",)


def test_the_error_table_holds_every_channel_worst_joint_first(pages, before):
    text = Page(pages["causes"]).text
    table = text[text.index("joint channel NRMSE before") : text.index("What the residual depends on")]
    assert table.index("elbow") < table.index("shoulder")  # the elbow's error is five times larger
    for channel in ("q", "dq", "theta", "dtheta", "tau_t"):
        assert f" {channel} " in table
    assert wording.number(before.nrmse["q.elbow"]) in table


def test_the_residual_is_drawn_first_against_the_signal_of_the_effect(pages):
    alts = [
        alt
        for alt in Page(pages["causes"]).images
        if alt.startswith("Residual of the motor balance of elbow")
    ]
    assert len(alts) == 4
    assert alts[0].endswith("over motor velocity dtheta")  # MotorCoulombFriction.against
    assert not any("link velocity" in alt for alt in alts)  # one signal of a group


def test_without_simulations_the_numbers_stay(arm2, measured, before, after):
    page = Page(report.render(causes(measured, before, after), arm2, measured))
    assert "Error per channel" in page.text
    assert not any("measured and simulated" in alt for alt in page.images)


def test_without_a_held_out_comparison_the_simulations_give_the_numbers(arm2, measured, before, after):
    diagnosis = replace(causes(measured, before, after), comparison=None, residuals=())
    text = Page(report.render(diagnosis, arm2, measured, before, after)).text
    assert "In the simulation of the data of the fit itself, the error of" in text
    assert "20 % → 2.0 % error of motor velocity dtheta at elbow in the simulation" in text


def test_a_change_of_a_nominal_effect_is_called_one(measured, before, after):
    planned = effect("motor_viscous_friction", "elbow", nominal=True, coefficient=1.0)
    finding = replace(friction(), effect="motor_viscous_friction", planned=planned, indistinguishable=())
    assert sentences.because(finding).startswith("the model's motor viscous friction at elbow is off (level")


def test_a_law_that_cannot_be_drawn_is_shown_as_text(arm2, measured):
    class Odd(Effect):
        """Odd."""

        law = r"\nosuchmacro{<x>}"

    finding = replace(friction(), planned=Planned(Odd(), "elbow", {}))
    diagnosis = d.Diagnosis("causes", "odd", findings=(finding,))
    html = report.render(diagnosis, arm2, measured)
    assert r"<code>\nosuchmacro{&lt;x&gt;}</code>" in html


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_laws_and_symbols_of_the_catalogue_can_be_drawn(name):
    effect = catalogue()[name]
    for latex in filter(None, (effect.law, *(param.symbol for param in effect.params))):
        assert plots.formula(latex) is not None, latex


# --- it stands alone ---------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", ["causes", "healthy", "unexplained", "refused"])
def test_the_page_needs_nothing_from_outside(pages, verdict):
    html = pages[verdict]
    page = Page(html)
    assert page.open == []  # every tag is closed
    assert not {"link", "iframe", "object", "embed"} & set(page.tags)
    (script,) = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline';" in html
    assert f" script-src 'sha256-{digest}'\"" in html
    for scheme in ("http://", "https://", "file://", "@import", "url("):
        assert scheme not in html
    assert len(html.encode()) < 4_000_000
    assert page.tags.count("img") == len(page.links) == len([alt for alt in page.images if alt])
    for link in page.links:
        kind, _, content = link.partition(";base64,")
        assert kind == "data:image/svg+xml"
        svg = base64.b64decode(content).decode()
        assert "<script" not in svg and "DOCTYPE" not in svg
        assert all(ref.startswith(("#", "data:")) for ref in re.findall(r'href="([^"]*)"', svg))


def test_the_same_diagnosis_gives_the_same_bytes(pages, arm2, measured, before, after):
    with mpl.rc_context({"font.size": 23, "svg.hashsalt": "other", "axes.grid": False}):  # a user's taste
        again = report.render(causes(measured, before, after), arm2, measured, before, after)
    assert again == pages["causes"]


def test_names_are_text_whatever_they_hold(arm2, measured, before, after):
    evil = "<script>alert('1')</script>\" onerror=\"x\u202e\x1b[31m$\\frac{"
    columns = {(c, evil if j == "elbow" else j): v for (c, j), v in measured.columns.items()}
    bad = recording.make(measured.time, columns, f"{evil}.csv")
    sims = [simulation(bad, size) for size in (0.5, 0.05)]
    view = replace(views(measured)[3], joint=evil, balance=evil, signals={evil: measured.get("q", "elbow")})
    removed = d.Removed(evil, evil, 4.0, 0.2, 0.1, evil)
    finding = replace(friction(why=evil), joint=evil, note=evil, kind=evil, parameters={evil: evil})
    finding = replace(finding, removed=replace(removed, joint=f"not {evil}"))
    diagnosis = replace(
        causes(bad_names(bad), *sims),
        reason=evil,
        findings=(finding,),
        unexplained=(d.Unexplained(evil, evil, 0.1, evil), d.Unexplained(evil, "spring", 0.1, evil)),
        remaining=(d.Remaining(evil, 9.0, 4.0, 0.2, 0.1, 0.19, evil),),
        not_excited=((evil, evil),),
        within_tolerance=(d.WithinTolerance(evil, evil, evil, 0.1),),
        ranking=(d.Ranked(evil, evil, 0.4, {evil: evil}),),
        next_experiment=evil,
        residuals=(view,),
        notes=(evil,),
    )
    step = replace(STEPS[0], stage=evil, action=evil, text=evil)
    page = Page(report.render(traced(diagnosis, (step,)), replace(arm2, name=evil), bad, *sims))
    assert page.open == [] and page.tags.count("script") == 1  # the page's own
    assert page.text.count("<script>alert('1')</script>") > 15
    assert not any(c in page.text for c in "\u202e\x1b")
    assert len(page.links) > 10


def bad_names(measured: recording.Recording) -> recording.Recording:
    """The same samples under the usual names."""
    columns = {(c, JOINTS[i // 5]): v for i, ((c, _), v) in enumerate(measured.columns.items())}
    return recording.make(measured.time, columns)


@pytest.mark.parametrize("package", ["matplotlib", "jinja2"])
def test_a_missing_package_is_named_with_the_extra(package, arm2, measured, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"{package}.*flexjoint\[report\]"):
        report.write(refused(), arm2, measured, tmp_path / "r.html")
    assert list(tmp_path.iterdir()) == []


def test_write_leaves_one_file_or_none(arm2, measured, tmp_path):
    out = tmp_path / "new" / "r.html"
    report.write(refused(), arm2, measured, out)
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert list(out.parent.iterdir()) == [out]
    with pytest.raises(FlexJointError, match="cannot write"):
        report.write(refused(), arm2, measured, out / "inside_a_file.html")


@pytest.mark.parametrize("longest", [10.0, 1000.0, 0.0125, 99_999.0])
def test_no_label_is_cut_at_an_edge(monkeypatch: pytest.MonkeyPatch, longest: float) -> None:
    """The last number of an axis stands at its end, half beyond it."""
    drawn: list[Figure] = []
    image = plots._image

    def kept(figure: Figure, alt: str, tight: bool = False) -> plots.Image:
        drawn.append(figure)
        return image(figure, alt, tight)

    monkeypatch.setattr(plots, "_image", kept)
    time = np.linspace(0.0, longest, 200)
    values = longest * np.sin(np.arange(200.0))
    plots.traces(time, values, values, None, "q", "elbow", False, "")
    plots.curves("q [rad]", "", full=(time, values))
    for figure in drawn:
        width, height = figure.canvas.get_width_height()
        (axes,) = figure.axes
        boxes = [
            tick.label1.get_window_extent()
            for axis in (axes.xaxis, axes.yaxis)
            for tick in axis.get_major_ticks()
            if min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
        ]
        assert len(boxes) > 4
        for box in boxes:
            assert box.x0 >= 0.0 and box.x1 <= width and box.y0 >= 0.0 and box.y1 <= height
