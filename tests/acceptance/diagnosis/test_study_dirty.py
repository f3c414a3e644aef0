"""Dirty machines in the study: what counts as a right name, the goals, and a case of each kind."""

from __future__ import annotations

from typing import Any

import pytest
from study import dirty
from study.cases import COUNTS, DIRTY, SEALED, USUAL, make
from study.dirty import goals, large_causes, measured, names
from study.page import markdown, misses
from study.run import diagnosed, ranges
from support.thorough import thorough


def finding(effect: str, probability: float, joint: str = "swing", **more: Any) -> dict[str, Any]:
    value = {"value": [2.0], "std": [0.01]}
    parameters = {"level": value, "amplitude": value}
    told = {"parameters": parameters, "since": None, "ties": [], "gain": 0.9}
    return {"effect": effect, "joint": joint, "probability": probability, **told, **more}


def planted(effect: str, large: bool = True) -> dict[str, Any]:
    told = {
        "parameters": {"level": 2.0, "amplitude": 2.0},
        "since": None,
        "share": 0.2,
        "large": large,
        "family": "catalogue",
    }
    return {"effect": effect, "joint": "swing", **told}


def record(part: str, *findings: dict[str, Any], number: int = 3, **more: Any) -> dict[str, Any]:
    off = [
        {"effect": "motor_inertia", "joint": "swing", "change": 0.02, "scale": 0.1},
        {"effect": "spring_stiffness", "joint": "swing", "change": 5.0, "scale": -0.02},
    ]
    told = {
        "part": part, "number": number, "verdict": "causes", "findings": list(findings), "joints": 1,
        "truth": [], "unknown": [], "background": [], "off": off, "robot": "dirty_lever_flexible_5",
        "robot_family": "small flexible", "background_family": "gear", "sensors": "all", "rate": 250.0,
        "seconds": 10.0, "diagnosis": 4.0, "version": "now", "excess": 9.0, "excitation": "rich",
        "inexact": 0.0, "size": 1.0, "explained": 1.0, "unexplained": [],
    }  # fmt: skip
    return {**told, **more}


SWAPPED = {"amplitude": {"value": [-2.0], "std": [0.01]}}  # of another sign: it stands in for something
COULOMB = planted("motor_coulomb_friction")
RIGID = {"off": []}


@pytest.mark.parametrize(
    ("found", "more", "stands_for"),
    [
        (finding("motor_coulomb_friction", 0.9), {}, "cause"),
        (finding("torque_gain", 0.9, ties=[["motor_coulomb_friction", "swing"]]), {}, "cause"),
        (finding("link_coulomb_friction", 0.9), {}, "nothing"),
        (finding("link_coulomb_friction", 0.9), RIGID, "cause"),
        (finding("motor_coulomb_friction", 0.9, joint="elbow"), {"joints": 2}, "nothing"),
        (finding("cogging", 0.9), {"background": [planted("cogging", large=False)]}, "background"),
        (finding("cogging", 0.9, parameters=SWAPPED), {"background": [planted("cogging")]}, "nothing"),
        (finding("motor_inertia", 0.9, parameters={"scale": {"value": [0.08], "std": [0.01]}}), {}, "number"),
        (finding("motor_inertia", 0.9, parameters={"scale": {"value": [0.3], "std": [0.01]}}), {}, "nothing"),
        (
            finding("motor_inertia", 0.9, parameters={"scale": {"value": [-0.1], "std": [0.01]}}),
            {},
            "nothing",
        ),
    ],
)
def test_names_stand_for_what_is_there(found: dict, more: dict, stands_for: str) -> None:
    (name,) = names([record("dirty", found, **{"truth": [COULOMB], **more})])
    assert name.stands_for == stands_for


def test_the_four_goals_are_counted() -> None:
    wrong = finding("torque_gain", 0.97)
    small = planted("cogging", large=False)
    held = [
        record("dirty", finding("motor_coulomb_friction", 0.85), wrong, truth=[COULOMB]),
        record(
            "dirty", finding("motor_coulomb_friction", 0.7), truth=[COULOMB, planted("payload", large=False)]
        ),
        record("background", finding("cogging", 0.96), background=[small]),
        record("background", finding("torque_gain", 0.6, gain=0.1), background=[small]),
        record("unknown", finding("torque_gain", 0.55)),
        record("unknown", finding("torque_gain", 0.45)),
    ]
    assert len(large_causes(held)) == 2  # the payload does not stand out
    found = {key: (rate.hits, rate.cases) for key, rate in measured(held).items()}
    expected = {"causes": (1, 2), "sure": (1, 1), "surer": (1, 2), "background": (1, 2), "unknown": (1, 2)}
    assert found == expected
    told = goals(held)
    assert "development: 2 dirty, 2 background, 2 unknown" in told and "sealed" not in told
    assert "verdicts of unknown: causes 2" in told
    assert "1 on 2 machines, of them 0 wrong, 1 small errors" in told
    assert [dirty.missed(r) for r in held] == [True, True, True, False, True, False]


def test_sealed_numbers_are_apart() -> None:
    assert not set(USUAL) & set(DIRTY) and all(COUNTS[part] >= 2 * SEALED for part in DIRTY)
    numbers = {s: [n for r in ranges(("dirty",), 7, s) for n in r.numbers] for s in (False, True)}
    assert max(numbers[False]) < SEALED <= min(numbers[True]) and len(numbers[True]) > 20
    assert len({r.file for s in (False, True) for r in ranges(("dirty", "single"), 1, s)}) == len(
        {r.file for r in ranges(("dirty", "single"), 1)}
    )
    held = [record("unknown", number=SEALED)]
    assert goals(held).startswith("sealed: 0 dirty, 0 background, 1 unknown")
    assert "no dirty machines" in goals([])


def test_the_page_has_a_section_of_them() -> None:
    held = [record("dirty", finding("torque_gain", 0.9), truth=[COULOMB]), record("background")]
    page = markdown(held)
    assert "## Dirty machines" in page and "| motor_coulomb_friction | 1 | 0 | 0 |" in page
    assert "torque_gain 1" in page and "small flexible" in page
    assert "dirty-0003" in misses(held) and "background-0003" not in misses(held)


@pytest.mark.parametrize(
    ("part", "number"),
    [("background", 1), pytest.param("dirty", 4, marks=thorough), pytest.param("unknown", 7, marks=thorough)],
)
def test_a_machine_of_each_kind_is_diagnosed(part: str, number: int) -> None:
    found = diagnosed(make(part, number))
    assert found["verdict"] in ("causes", "healthy", "unexplained")
    assert len(found["background"]) >= 4 and found["robot_family"] and found["background_family"]
    assert bool(found["unknown"]) == (part == "unknown") and bool(found["truth"]) == (part == "dirty")
    assert "## Dirty machines" in markdown([{**found, "version": "now"}])
