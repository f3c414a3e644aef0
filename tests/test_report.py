"""The HTML page of a diagnosis: what it says, that it stands alone, and that hostile names stay text."""

from __future__ import annotations

import base64
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import matplotlib as mpl
import pytest
from fake_diagnosis import (
    JOINTS,
    Simulated,
    arm,
    causes,
    delay,
    friction,
    healthy,
    refused,
    signals,
    simulation,
    unexplained,
    views,
)

from flexjoint import diagnosis as d
from flexjoint import recording, report, robot
from flexjoint.effect import Effect, Planned, catalogue, plan
from flexjoint.errors import FlexJointError, MissingExtraError
from flexjoint.report import plots, sentences, wording


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
        if tag in ("td", "th"):
            self.text += " "

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
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
        "because the model lacks motor Coulomb friction at elbow (level 0.401 ± 0.003 N m)",
        "On data that the fit did not see, adding these 2 causes to the model removes 90% of the error",
        "cannot tell motor Coulomb friction at elbow from Stribeck friction at elbow or asymmetric friction"
        " at elbow: the motion never rests",
        "Motor Coulomb friction at elbow",
        "Dry friction on the motor shaft",
        "97%",
        "Sensor delay at shoulder",
        "0.00512 ± 0.00012 s",
        "t = 7.5 s",
        "A refit of the nominal numbers would absorb most of this cause",
        "elbow, spring balance: 4.3% of its error, depends most on motor position theta",
        "End stop: whole robot",
        "Cable spring: elbow",
        "payload at elbow: 0.008 kg",
        "Hold the elbow still for 2 s between moves",
        "Encoder offsets were estimated on the first 0.5 s.",
        "motor viscous friction at elbow",
        "64.2 before, 1.04 after",
        "monday.csv",
        "stiffness 2.0%, damping 10%",
    ):
        assert said in text, said


def test_the_other_verdicts_say_what_they_are(pages):
    healthy_text = Page(pages["healthy"]).text
    assert "Healthy" in healthy_text and "agrees with the recording within the noise" in healthy_text
    assert "with the named causes" not in healthy_text
    lost = Page(pages["unexplained"]).text
    assert "no effect of the catalogue accounts for it: 93% of the motor balance's error is left" in lost
    assert "depends most on motor velocity dtheta" in lost and "Turn the elbow slowly both ways" in lost
    none = Page(pages["refused"]).text
    assert "cannot carry a verdict: the recording holds no motor torque." in none
    assert "What to do: Record tau_m beside theta and q." in none


def test_partial_findings_of_an_unexplained_error_are_named(arm2, measured, before, after):
    partial = replace(unexplained(measured, before), findings=(delay(),))
    assert (
        "A part is explained by sensor delay at shoulder (9.0%)"
        in sentences.verdict(partial, partial.comparison)[1]
    )


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
    assert "On the data of the fit itself, adding these 2 causes to the model removes 90%" in text


def test_a_change_of_a_nominal_effect_is_called_one(measured, before, after):
    planned = plan("motor_viscous_friction", "elbow", {"coefficient": 1.0}, nominal=True)
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
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
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
    finding = replace(friction(evil, why=evil), note=evil, kind=evil, parameters={evil: evil})
    diagnosis = replace(
        causes(bad_names(bad), *sims),
        reason=evil,
        findings=(finding,),
        unexplained=(d.Unexplained(evil, evil, 0.1, evil),),
        not_excited=((evil, evil),),
        within_tolerance=(d.WithinTolerance(evil, evil, 0.1),),
        ranking=(d.Ranked(evil, evil, 0.4, {evil: evil}),),
        next_experiment=evil,
        residuals=(view,),
        notes=(evil,),
    )
    page = Page(report.render(diagnosis, replace(arm2, name=evil), bad, *sims))
    assert page.open == [] and "script" not in page.tags
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
