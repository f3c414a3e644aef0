"""The study's ablation: what is left out, which cases are run again, and what the page counts."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from study import ablation
from study.ablation import SAMPLE, merit, page, pieces, sample, wrong_names
from study.cases import COUNTS, DIRTY, SEALED

from flexjoint.diagnosis import pipeline
from flexjoint.diagnosis.verdict import checks
from flexjoint.diagnosis.verdict.joints.friction import FRICTION
from flexjoint.diagnosis.verdict.joints.search import JOINT_SEARCH


def finding(effect: str, probability: float, joint: str = "swing") -> dict[str, Any]:
    parameters = {"level": {"value": [2.0], "std": [0.01]}}
    told = {"effect": effect, "joint": joint, "probability": probability, "parameters": parameters}
    return {**told, "since": None, "ties": []}


def record(*found: dict[str, Any], part: str = "single", causes: int = 1, **more: Any) -> dict[str, Any]:
    truth = [
        {"effect": "motor_coulomb_friction", "joint": "swing", "parameters": {"level": 2.0}, "since": None}
    ]
    told = {
        "part": part, "number": 3, "verdict": "causes" if found else "healthy", "findings": list(found),
        "truth": truth[:causes], "joints": 2, "excluded": [], "cpu": 2.0, "version": "now",
    }  # fmt: skip
    return {**told, **more}


COULOMB, GAIN = finding("motor_coulomb_friction", 0.9), finding("torque_gain", 0.6)


def test_every_check_is_left_out_by_itself() -> None:
    before = {name: getattr(checks, name) for name in ablation.LISTS}
    assert {check for held in before.values() for check in held} == set(checks.EVERY)
    for piece, check in zip(pieces(), checks.EVERY, strict=False):
        with piece.without():
            left = [one for name in ablation.LISTS for one in getattr(checks, name)]
        assert check not in left and len(left) == len(checks.EVERY) - 1
    assert {name: getattr(checks, name) for name in ablation.LISTS} == before


def test_a_stage_tells_when_it_changes_something(monkeypatch: pytest.MonkeyPatch) -> None:
    acted: list[str] = []
    monkeypatch.setattr(pipeline, "joint_by_joint", lambda selection, *_: selection or "found")
    piece = next(p for p in pieces() if p.name == "stage: ordinary friction")
    with piece.watched(lambda: acted.append("did")):
        assert pipeline.joint_by_joint("selection", (), FRICTION) == "selection" and not acted
        assert pipeline.joint_by_joint("", (), JOINT_SEARCH) == "found" and not acted
        assert pipeline.joint_by_joint("", (), FRICTION) == "found" and acted == ["did"]
    with piece.without():
        assert pipeline.joint_by_joint("", (), FRICTION) == ""
        assert pipeline.joint_by_joint("", (), JOINT_SEARCH) == "found"


def test_the_sample_is_fixed_and_of_every_part() -> None:
    chosen = sample()
    assert chosen == sample() and len(set(chosen)) == sum(SAMPLE.values())
    for part, share in SAMPLE.items():
        numbers = [number for own, number in chosen if own == part]
        assert len(numbers) == share and len({b - a for a, b in pairwise(numbers)}) <= 1
        assert max(numbers) < (SEALED if part in DIRTY else COUNTS[part])
    assert {number % 4 == 0 for part, number in chosen if part == "drawn"} == {True, False}  # healthy, others
    assert len(sample(20)) in range(18, 25) and {part for part, _ in sample(5)} == set(SAMPLE)
    assert "fresh" not in SAMPLE  # no rule may come from it


def test_wrong_names_are_those_that_are_believed() -> None:
    assert wrong_names(record(COULOMB, GAIN)) == 1
    assert wrong_names(record(COULOMB, finding("torque_gain", 0.4))) == 0
    assert wrong_names(record(GAIN, causes=0, part="healthy")) == 1
    struck = {"part": "struck", "excluded": ["motor_coulomb_friction"]}
    assert wrong_names(record(GAIN, **struck)) == 1
    twins = [{"effect": "spring_preload", "joint": "swing", "parameters": {"torque": 2.0}, "since": None}]
    assert wrong_names(record(finding("link_encoder_offset", 0.9), **struck, truth=twins)) == 0
    assert merit(record(COULOMB)) > merit(record(COULOMB, GAIN)) > merit(record(GAIN))


def test_the_page_compares_with_and_without() -> None:
    name = "check: worse simulation"
    helped = {"with": record(COULOMB), "without": {name: record(COULOMB, GAIN, cpu=3.0)}}
    harmed = {"with": record(number=4), "without": {name: record(COULOMB, number=4, cpu=1.0)}}
    alarm = record(finding("torque_gain", 0.3), part="healthy", causes=0)
    kept = {"with": record(part="healthy", causes=0), "without": {name: alarm}}
    idle = {"with": record(COULOMB, number=5), "without": {}}
    told = page([helped, harmed, kept, idle])
    assert "| nothing |  | 2 | 0 | 0 | 0 | 0 |" in told
    assert f"| {name} | 3 | 2 | 0 | 1 | 1 | 0 | 2 | 1 | 0 | 6, 6 |" in told
    assert f"{name}," not in told.split("make no case of the sample better")[1].split("\n")[0]
    assert f"| {name} | single 4 | motor_coulomb_friction/swing | healthy: nothing named |" in told


def test_results_of_other_code_are_not_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation, "make", lambda part, number: record(COULOMB, part=part, number=number))
    monkeypatch.setattr(ablation, "ablated", lambda made: {"with": made, "without": {}})
    monkeypatch.setattr(ablation, "version", lambda: "now")
    ablation.run(tmp_path, 5)
    assert len(ablation.results(tmp_path)) == len(sample(5))
    monkeypatch.setattr(ablation, "version", lambda: "then")
    with pytest.raises(ValueError, match="use another folder"):
        ablation.run(tmp_path, 5)
