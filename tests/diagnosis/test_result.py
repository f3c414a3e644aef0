"""A diagnosis and a comparison print themselves, write themselves, and extend a robot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import fake_diagnosis

import flexjoint as fj
from flexjoint.core.errors import FlexJointError, RobotError, UnknownNameError
from flexjoint.core.text import Line, Table, as_html, plain
from flexjoint.diagnosis.result import Finding, Removed, sentences, to_json

BACKLASH = Finding(
    "backlash", "elbow", 0.9, {}, None, 0.4, "mechanical", fj.effect("backlash", "elbow", gap=2e-3)
)
DRAG = fj.effect("motor_viscous_friction", "elbow", coefficient=0.5)
UNLIKELY = Finding("motor_viscous_friction", "elbow", 0.3, {}, None, 0.1, "mechanical", DRAG)
TWO = fj.Diagnosis("causes", "known", (BACKLASH, UNLIKELY), robot="arm2")


# --- in words --------------------------------------------------------------------------------
def test_a_diagnosis_prints_the_summary() -> None:
    text = str(replace(fake_diagnosis.two_causes(), robot="arm2"))
    head, *rest = text.splitlines()
    assert head == "Causes named: arm2" and max(map(len, rest)) <= 100
    words = " ".join(text.split())
    for said in ("motor Coulomb friction level 0.401 ± 0.003 N m 97 %", "Next experiment"):
        assert said in words
    assert repr(TWO).startswith("Diagnosis(verdict='causes'")  # which stays what a debugger needs


def test_what_is_told_first_is_what_removes_most_torque_error() -> None:
    """A friction at a quiet joint gains more, in that joint's noise, than a load that is far larger."""
    friction, load = (
        replace(BACKLASH, effect=name, gain=gain, removed=Removed("elbow", "motor", without, 0.01, 0.0, "q"))
        for name, gain, without in (("link_viscous_friction", 0.8, 0.03), ("payload", 0.1, 3.84))
    )
    found = replace(TWO, findings=(friction, load, UNLIKELY))
    assert [f.effect for f in sentences.likely(found)] == ["payload", "link_viscous_friction"]
    assert [f["effect"] for f in to_json(found)["findings"]] == [f.effect for f in found.findings]


def test_a_notebook_gets_tables_and_no_markup_of_names() -> None:
    page = replace(fake_diagnosis.two_causes(), robot="<b>arm</b>")._repr_html_()
    assert "&lt;b&gt;arm&lt;/b&gt;" in page and "<b>" not in page
    assert page.count("<table>") == page.count("</table>") == 3


def test_a_table_is_aligned_and_its_cells_may_hold_lines() -> None:
    table = Table((("name", False), ("size", True)), (("a\nb", "1"), ("long name", "1000")))
    assert plain([table]) == ("name       size\n---------  ----\na             1\nb\nlong name  1000")
    assert "a<br>b" in as_html([table])
    assert plain([Line("word " * 40)]).count("\n") == 1
    assert "\n" not in plain([Line("word " * 40, whole=True)])


def test_a_comparison_prints_its_errors_the_largest_first() -> None:
    result = fj.Comparison(
        {"q.slide": 1e-3, "q.turn": 2e-3, "tau_t.turn": 0.5},
        {"q.slide": 0.01, "q.turn": 0.2},
        0.5,
        12,
        np.zeros(0),
        {},
        robot="arm",
        recording="monday.csv",
        prismatic=frozenset({"slide"}),
    )
    text = str(result).splitlines()
    assert text[0] == "arm against monday.csv: 12 windows of 0.5 s, each from the measured state"
    assert [line.split() for line in text[3:]] == [
        ["q.turn", "0.002", "rad", "0.2"],
        ["q.slide", "0.001", "m", "0.01"],
        ["tau_t.turn", "0.5", "N", "m", "not", "moving"],
    ]
    assert "<td" in result._repr_html_()


# --- as files --------------------------------------------------------------------------------
def test_results_write_themselves_as_json(tmp_path: Path) -> None:
    fake_diagnosis.two_causes().write(tmp_path / "deep" / "d.json")
    assert json.loads((tmp_path / "deep" / "d.json").read_text())["verdict"] == "causes"
    compared = fj.Comparison({"q.a": 1.0}, {"q.a": float("nan")}, 0.5, 1, np.zeros(0), {})
    compared.write(str(tmp_path / "c.json"))
    assert json.loads((tmp_path / "c.json").read_text())["nrmse"] == {"q.a": None}
    for result in (fake_diagnosis.two_causes(), compared):
        with pytest.raises(FlexJointError, match=r"expected a name that ends in .json, got .txt"):
            result.write(tmp_path / "d.txt")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.json", "deep"]


def test_a_recording_writes_itself(tmp_path: Path) -> None:
    recording = fake_diagnosis.signals(seconds=1.0)
    recording.write(tmp_path / "r.parquet")
    read = fj.read_recording(tmp_path / "r.parquet")
    np.testing.assert_array_equal(read.get("q", "elbow"), recording.get("q", "elbow"))


# --- the extended robot --------------------------------------------------------------------------------
def test_unlikely_causes_do_not_enter_the_robot_unless_asked_for(arm: fj.Robot) -> None:
    assert [str(e) for e in TWO.extend(arm).effects] == ["backlash on elbow"]
    assert len(TWO.extend(arm, least=0.0).effects) == 2
    assert TWO.extend(arm, least=0.95).effects == arm.effects == ()


def test_a_shared_cause_enters_on_every_joint(arm: fj.Robot) -> None:
    members = tuple(fj.effect("torque_gain", joint, gain=0.1) for joint in fake_diagnosis.JOINTS)
    shared = Finding("torque_gain", None, 0.9, {}, None, 0.4, "parameter", members[0], members=members)
    extended = fj.Diagnosis("causes", "known", (shared,)).extend(arm)
    assert [e.joint for e in extended.effects] == list(fake_diagnosis.JOINTS)


def test_another_robot_cannot_be_extended(arm: fj.Robot) -> None:
    other = fj.load_robot("rrbot")
    with pytest.raises(UnknownNameError, match="unknown joint 'elbow'"):
        TWO.extend(other)
    with pytest.raises(RobotError, match=r"extend: expected a robot first, got a pin.Model"):
        TWO.extend(arm.model)  # type: ignore[arg-type]
