"""The study's part of machines that no rule has seen: its seeds, what counts, and a trial of it."""

from __future__ import annotations

import re
from typing import Any

import pytest
from planting.catalogue import DRY_MOTOR, WITH_STATE
from planting.sizes import MET_EFFECTS
from study import fresh
from study.cases import COUNTS, FRESH_KINDS, FRESH_ROBOTS, FRESH_SEEDS, TRIALS, USUAL, StudyCase, make
from study.page import markdown
from study.run import diagnosed, ranges
from study.summary import Rate
from support.thorough import exhaustive, thorough

LAST = COUNTS["fresh"]


def record(number: int, causes: int, *findings: dict[str, Any], **more: Any) -> dict[str, Any]:
    joints = ["joint_0", "joint_1", "joint_2"][:causes]
    level = {"level": 2.0}
    truth = [
        {"effect": "motor_coulomb_friction", "joint": joint, "parameters": level, "since": None}
        for joint in joints
    ]
    told = {
        "part": "fresh", "number": number, "verdict": "causes" if findings else "healthy", "truth": truth,
        "findings": list(findings), "excluded": [], "joints": 3, "excess": 9.0, "least_excess": 3.0,
        "sensors": "full", "inexact": 0.02, "rate": 250.0, "excitation": "rich", "diagnosis": 3.0,
        "version": "now",
    }  # fmt: skip
    return {**told, **more}


def finding(joint: str | None, probability: float = 0.95, effect: str = "motor_coulomb_friction") -> dict:
    parameters = {"level": {"value": [2.0], "std": [0.01]}}
    told = {"effect": effect, "joint": joint, "probability": probability}
    return {**told, "parameters": parameters, "since": None, "ties": []}


def figures(held: list[dict[str, Any]]) -> dict[str, tuple[int, int]]:
    return {what: (rate.hits, rate.cases) for what, rate, _ in fresh.measured(held)}


def test_its_seeds_are_used_by_nothing_else() -> None:
    for number in range(LAST, LAST + TRIALS):
        case = make("fresh", number)
        assert case == make("fresh", number)
        robot = re.fullmatch(r"drawn_(\d+)_of[1-7](|_exact|_loose)", case.case.robot)
        assert robot is not None and int(robot[1]) == FRESH_ROBOTS + number
        assert FRESH_SEEDS <= case.case.seed < 2 * FRESH_SEEDS
    for part in ("single", "drawn", "dirty"):
        assert make(part, 4).case.seed < FRESH_SEEDS
    with pytest.raises(ValueError, match=f"0 to {LAST + TRIALS - 1}"):
        make("fresh", LAST + TRIALS)


def test_trials_are_neither_run_nor_counted() -> None:
    assert "fresh" not in USUAL
    assert {n for r in ranges(("fresh",)) for n in r.numbers} == set(range(LAST))
    held = [record(LAST, 1, finding("joint_0")), record(3, 1)]
    assert figures(held)["single causes, excess above 1.1: exact or tied"] == (0, 1)


def _kind(case: StudyCase) -> str:
    return "struck" if case.excluded else fresh.BY_COUNT[len(case.case.effects)]


@thorough
def test_every_kind_is_drawn_and_can_be_told_apart() -> None:
    cases = [make("fresh", number) for number in range(60)]
    assert {_kind(case) for case in cases} == set(FRESH_KINDS)
    assert {int(re.search(r"_of(\d)", case.case.robot)[1]) for case in cases} == set(range(1, 8))
    for case in cases:
        if _kind(case) == "struck":
            assert case.sensors == "full" and case.excluded == (case.case.effects[0].effect,)
        if len(case.case.effects) > 1:
            assert not {p.effect for p in case.case.effects} & set(MET_EFFECTS)
        for joint in {p.joint for p in case.case.effects}:
            own = {p.effect for p in case.case.effects if p.joint == joint}
            assert len(own & set(WITH_STATE)) < 2 and len(own & set(DRY_MOTOR)) < 2


def test_the_goals_are_counted() -> None:
    both = (finding("joint_0"), finding("joint_1"))
    held = [
        record(0, 1, finding("joint_0")),
        record(1, 1, finding("joint_1")),
        record(2, 1, excess=1.05),
        record(3, 2, *both),
        record(4, 2, both[0]),
        record(5, 2, both[0], least_excess=1.01),  # the other is not there to be named
        record(6, 3, *both, finding("joint_2")),
        record(7, 0),
        record(8, 0, finding("joint_0", 0.3)),
        record(9, 1, finding("joint_0", 0.97, "torque_gain"), excluded=["motor_coulomb_friction"]),
        record(10, 1, finding("joint_0", 0.5, "torque_gain"), excluded=["motor_coulomb_friction"]),
    ]
    assert figures(held) == {
        "single causes, excess above 1.1: exact": (1, 2),
        "single causes, excess above 1.1: exact or tied": (1, 2),
        "two causes, excess above 1.1: exact or tied": (1, 3),
        "two causes, each excess above 1.1 beside the other: exact or tied": (1, 2),
        "three causes, excess above 1.1: exact or tied": (1, 1),
        "three causes, each excess above 1.1 beside the others: exact or tied": (1, 1),
        "healthy machines alarmed": (1, 2),
        "true effect struck: confident wrong name": (1, 2),
    }


def test_stated_probabilities_are_held_against_wilson_intervals() -> None:
    low, high = Rate(0, 10).wilson
    assert low == 0.0 and high == pytest.approx(1.96**2 / (10 + 1.96**2), rel=1e-4)  # his equation at k = 0
    sure = [record(n, 1, finding("joint_1", 0.95)) for n in range(10)]
    modest = [record(n, 1, finding("joint_0", 0.3)) for n in range(10, 30)]
    right = [record(n, 1, finding("joint_0", 0.85)) for n in range(30, 40)]
    told = fresh.section([*sure, *modest, *right])
    assert re.search(r"\| 0.9 to 0.99 \| 10 \| 0.950 \| 0/10 .* \| too sure \|", told)
    assert re.search(r"\| 0.2 to 0.4 \| 20 \| 0.300 \| 20/20 .* \| too modest \|", told)
    assert re.search(r"\| 0.8 to 0.9 \| 10 \| 0.850 \| 10/10 .* \| inside \|", told)


def test_the_page_says_that_no_rule_comes_from_it() -> None:
    held = [{**record(3, 1, finding("joint_0")), "part": "single", "robot": "lever", "least_excess": None}]
    without = markdown(held)
    assert fresh.WORDS + fresh.NOT_RUN in without and "must never lead to a rule" in without
    page = markdown([*held, record(0, 1, finding("joint_0"))])
    assert fresh.NOT_RUN not in page and "Cases: 1 of 1000." in page
    # no other figure counts it
    others = set(without.splitlines()) - set(fresh.NOT_RUN.splitlines())
    assert others <= set(page.splitlines())


@pytest.mark.parametrize(
    "number",
    [
        LAST + 3,
        *(pytest.param(LAST + k, marks=thorough) for k in (7, 9)),
        *(pytest.param(LAST + k, marks=exhaustive) for k in (1, 2)),
    ],
)
def test_a_trial_is_diagnosed(number: int) -> None:
    case = make("fresh", number)
    found = diagnosed(case)
    assert found["verdict"] in ("causes", "unexplained", "healthy")
    assert ("least_excess" in found) == (len(case.case.effects) > 1)
    assert fresh.kind(found) == _kind(case)
