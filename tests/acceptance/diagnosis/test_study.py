"""The study counts what it says it counts, goes on where it was stopped, and its fixed sample holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from planting import BEYOND, CATALOGUE, ROBOTS, Planted, read_robot
from planting.catalogue import TWO_JOINTS
from study import run as study_run
from study import summary
from study.cases import COUNTS, SENSORS, USUAL, make
from study.page import markdown, misses
from study.run import Range, diagnosed, least_excess, ranges, records, write_range
from study.score import detectable, each_detectable, outcome, struck_outcome
from study.summary import Rate
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import sample, thorough

# a fixed sample of the cases of `make study`: what every change must keep
NAMED = (
    ("single", 37),
    ("single", 91),  # a friction, the link's angle unknown: its zone leaves what a gap would explain
    ("single", 148),
    ("single", 185),
    ("single", 186),  # a gap that opens late, whose date does not count at the level of what it leaves open
    ("single", 238),  # a load that comes late, and would be another one had it always been there
    ("single", 333),
    ("double", 0),
    ("double", 1),  # a gap that a cable keeps closed: an offset, and the gap is told of
    ("double", 31),  # a gain beside an offset that explains ten thousand times as much
    ("double", 56),  # a friction with two levels, at rest between two ways
    ("double", 62),  # an offset that a preload explains as well but for single moments
    ("double", 107),  # a law that gives way to a plainer one, beside which a cause was dropped
    ("double", 89),  # a gap that by itself is wide enough for the offset beside it
    ("several", 6),
    ("several", 17),  # a delay of all sensors of one joint, which is one of its torque in any recording
    ("several", 27),  # two levels of a friction, not one and a constant torque
    ("several", 15),  # a friction at rest whose springs are known up to unknown offsets
    ("beyond", 12),  # Dahl's friction from some time on, whose state begins then
    ("beyond", 36),  # a torque sensor's noise, moved in time by chance to where it costs least
    ("beyond", 40),  # a ripple of which the motion makes hardly more than one period
    ("beyond", 44),  # a ripple that a slow motion makes slow
    ("beyond", 100),
    ("beyond", 112),
    ("beyond", 128),
)
HEALTHY = (0, 1, 2, 3, 748)  # of the last one the first second would tell of a delay that sets in
STRUCK = (74,)


# --- judging one case -------------------------------------------------------------------------------------
def finding(effect: str, joint: str | None = "swing", value: float = 2.0, **more: Any) -> dict[str, Any]:
    parameters = {"level": {"value": [value], "std": [0.01]}}
    return {
        "effect": effect, "joint": joint, "probability": 0.99, "parameters": parameters, "since": None,
        "ties": [], **more,
    }  # fmt: skip


def record(*findings: dict[str, Any], verdict: str = "causes", **more: Any) -> dict[str, Any]:
    truth = {
        "effect": "motor_coulomb_friction", "joint": "swing", "parameters": {"level": 2.0}, "since": None
    }  # fmt: skip
    return {"verdict": verdict, "findings": list(findings), "truth": [truth], "joints": 1, **more}


COULOMB = finding("motor_coulomb_friction")
OTHER = finding("torque_gain")


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (record(COULOMB), "exact"),
        (record(finding("motor_coulomb_friction", value=2.1)), "exact"),
        (record(finding("motor_coulomb_friction", value=2.3)), "inaccurate"),
        (record(finding("motor_coulomb_friction", since=3.0)), "inaccurate"),
        (record(finding("torque_gain", ties=[["motor_coulomb_friction", "swing"]])), "tied"),
        (record(COULOMB, OTHER), "partial"),
        (record(COULOMB, verdict="unexplained"), "partial"),
        (record(OTHER), "wrong"),
        (record(finding("motor_coulomb_friction", "elbow")), "wrong"),
        (record(OTHER, verdict="unexplained"), "unexplained"),
        (record(verdict="healthy"), "healthy"),
        (record(verdict="refused"), "refused"),
        (record(verdict="crash"), "failed"),
    ],
)
def test_a_case_is_judged(found: dict[str, Any], expected: str) -> None:
    assert outcome(found) == expected


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (record(verdict="unexplained"), "unexplained"),
        (record(OTHER), "wrong"),
        (record(finding("torque_gain", probability=0.5)), "unsure"),
        (record(OTHER, verdict="unexplained"), "unexplained"),
        (record(verdict="healthy"), "healthy"),
    ],
)
def test_a_struck_case_is_judged(found: dict[str, Any], expected: str) -> None:
    assert struck_outcome(found) == expected


def test_equivalents_are_no_wrong_names() -> None:
    twist = {"effect": "spring_preload", "joint": "swing", "parameters": {"torque": 2.0}, "since": None}
    case = {**record(finding("link_encoder_offset")), "truth": [twist]}
    assert struck_outcome(case) == "equivalent"
    assert outcome(case) == "partial"  # with the true effect in the catalogue it had to be listed


def test_a_double_is_there_to_be_named_when_both_causes_are() -> None:
    """A damping within its tolerance, beside a friction, leaves nothing of its own to find."""
    friction = Planted("motor_coulomb_friction", "turn", {"level": 0.4})
    case = Case("turret", "rich", 3)
    least = []
    for other in ({"scale": 0.01}, {"scale": 3.0}):
        causes = (friction, Planted("spring_damping", "turn", other))
        recording = as_recording(case.with_causes(*causes))
        least.append(least_excess(nominal(case.robot), recording, causes))

    assert least[0] == pytest.approx(1.0, abs=0.01)
    assert not each_detectable({"least_excess": least[0]})
    assert each_detectable({"least_excess": least[1]})


# --- counting ---------------------------------------------------------------------------------------------
def test_intervals_are_the_exact_binomial_ones() -> None:
    low, high = Rate(0, 300).interval
    assert low == 0.0 and high == pytest.approx(1 - 0.025 ** (1 / 300))  # P(0 of 300) = (1 - p)^300
    low, high = Rate(1, 2).interval
    assert (low, high) == pytest.approx((1 - 0.975**0.5, 0.975**0.5))  # P(at least 1 of 2) = 1 - (1 - p)^2


def test_probabilities_are_held_against_the_truth() -> None:
    cases = [record(COULOMB), record(OTHER), record(finding("torque_gain", probability=0.1))]
    (*_, last) = summary.reliability(cases)
    assert (last[2], last[4].hits) == (2, 1)
    assert summary.brier(cases) == pytest.approx((0.01**2 + 0.99**2 + 0.1**2) / 3)


def test_errors_are_measured_in_standard_errors() -> None:
    case = record(finding("motor_coulomb_friction", value=2.02))
    assert summary.scaled_errors([case]) == pytest.approx([2.0])
    assert summary.relative_errors([case]) == pytest.approx([0.01])


# --- cases ------------------------------------------------------------------------------------------------
def test_cases_are_drawn_from_their_number_alone() -> None:
    for part in USUAL:
        assert make(part, 7) == make(part, 7) != make(part, 6)
    with pytest.raises(ValueError, match="unknown part"):
        make("triple", 0)
    with pytest.raises(ValueError, match="0 to 999"):
        make("healthy", 1000)


def test_the_plan_covers_what_the_study_claims() -> None:
    assert COUNTS["single"] + COUNTS["double"] >= 500 and COUNTS["healthy"] >= 1000
    step_effects = [
        list(CATALOGUE).index(e) for e in ("torque_saturation", "end_stop")
    ]  # planted to be sized
    quick = [n for n in range(COUNTS["single"]) if n // 12 not in step_effects]
    cases = [make("single", n) for n in quick]
    assert {c.case.effects[0].effect for c in cases} == set(CATALOGUE) - {"torque_saturation", "end_stop"}
    assert {c.sensors for c in cases} == set(SENSORS)
    robots = {c.case.robot.removesuffix("_exact") for c in cases}
    assert robots == {"lever", "turret", "crane", "scara", "gimbal", "reach"}
    assert {c.case.excitation for c in cases} == {"rich", "slow", "steps"}
    assert {c.case.inexact for c in cases} == {0.0, 0.02}
    sizes = [c.size for c in cases]
    assert min(sizes) < 0.03 and max(sizes) > 0.95
    assert all(set(c.excluded) == {c.case.effects[0].effect} for c in (make("struck", n) for n in range(8)))


def test_effects_that_came_later_have_a_part_of_their_own() -> None:
    assert COUNTS["beyond"] == 12 * len(BEYOND)
    sized = ("torque_speed_limit", "rough_spot")  # planted to be sized
    numbers = [n for n in range(COUNTS["beyond"]) if list(BEYOND)[n // 12] not in sized]
    cases = [make("beyond", n) for n in numbers]
    assert [c.case.effects[0].effect for c in cases] == [list(BEYOND)[n // 12] for n in numbers]
    assert min(c.size for c in cases) < 0.03 and max(c.size for c in cases) > 0.9
    for case in cases:
        (planted,) = case.case.effects
        if planted.effect in ("current_lag", "joint_coupling"):
            assert case.sensors not in ("torque from current", "link side only")
        if planted.effect in TWO_JOINTS:
            assert len(read_robot(ROBOTS / f"{case.case.robot}.yaml").joints) > 1


def test_any_robot_is_drawn_with_all_that_is_its_own() -> None:
    cases = [make("drawn", n) for n in range(24)]
    assert all((c.number % 4 == 0) == (not c.case.effects) for c in cases)
    assert {c.case.robot.split("_")[1] for c in cases} == {str(n) for n in range(24)}
    assert {c.case.inexact for c in cases} == {0.0, 0.02, 0.05}
    assert len({c.case.sensors.resolution for c in cases}) > 4 and len({c.case.rate for c in cases}) > 3
    for case in cases:
        loaded = study_run._nominal(case)
        assert case.case.inexact == pytest.approx(loaded.file.tolerance.stiffness, abs=2e-3)


def test_the_page_shows_them_and_leaves_the_other_figures_alone() -> None:
    def planted(part: str, *found: dict[str, Any]) -> dict[str, Any]:
        told = {
            "part": part, "number": 3, "excess": 9.0, "sensors": "full", "inexact": 0.0, "robot": "lever",
            "excitation": "rich", "rate": 500.0, "diagnosis": 1.0, "version": "now",
        }  # fmt: skip
        return {**record(*found), **told}

    drag = {"effect": "quadratic_drag", "joint": "swing", "parameters": {"coefficient": 2.0}, "since": None}
    parameters = {"coefficient": {"value": [2.01], "std": [0.01]}}
    named = planted("beyond", finding("quadratic_drag", parameters=parameters))
    missed = planted("beyond", OTHER)
    later = [{**r, "truth": [drag], "diagnosis": 7.0} for r in (named, missed)]
    left = {**planted("drawn"), "verdict": "healthy", "truth": []}
    later += [{**left, "number": n, "verdict": v} for n, v in enumerate(("healthy", "unexplained"))]
    before, after = markdown([planted("single", COULOMB)]), markdown([planted("single", COULOMB), *later])

    assert "| beyond causes with excess above 1.1: exact or tied | 1/2 = 50.0 %" in after
    assert "| quadratic_drag | 2 | 1 |" in after and "torque_gain 1 |" in after
    assert "| healthy machines drawn at random alarmed | 1/2 = 50.0 %" in after
    # every line of the other parts stays, but the one that counts the cases
    assert {line for line in before.splitlines() if "Cases:" not in line} <= set(after.splitlines())


# --- running ----------------------------------------------------------------------------------------------
def test_shards_are_disjoint_and_complete() -> None:
    every = list(ranges(tuple(COUNTS)))
    numbers = [(r.part, n) for r in every for n in r.numbers]
    assert len(numbers) == len(set(numbers)) == sum(COUNTS.values())
    assert len({r.file for r in every}) == len(every)


def test_a_stopped_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[int] = []

    def stub(case: Any) -> dict[str, Any]:
        done.append(case.number)
        return {**record(COULOMB), "part": case.part, "number": case.number, "excess": 2.0, "diagnosis": 1.0}

    class InThisProcess:
        def __init__(self, *_: Any, max_tasks_per_child: int) -> None: ...
        def __enter__(self) -> InThisProcess:
            return self

        def __exit__(self, *_: Any) -> None: ...
        def submit(self, function: Any, *arguments: Any) -> Any:
            from concurrent.futures import Future

            future: Future[float] = Future()
            future.set_result(function(*arguments))
            return future

    monkeypatch.setattr(study_run, "diagnosed", stub)
    monkeypatch.setattr(study_run, "ProcessPoolExecutor", InThisProcess)
    write_range(tmp_path, Range("double", range(10)))
    study_run.run(tmp_path, parts=("double",), shard=(1, 2))
    assert sorted(done) == [n for n in range(COUNTS["double"]) if n // 10 % 2 == 0]  # the first range once
    study_run.run(tmp_path, parts=("double",), shard=(2, 2))
    assert [r["number"] for r in records(tmp_path)] == list(range(COUNTS["double"]))

    other = json.dumps({**records(tmp_path)[0], "version": "another"})
    (tmp_path / "double-9.jsonl").write_text(other)
    with pytest.raises(ValueError, match="use another folder"):
        study_run.run(tmp_path, parts=("double",))


def test_a_finding_stands_for_one_of_two_causes() -> None:
    """A tilted base is tied with either of two offsets that were named: with the one that is left."""
    tilt = ["base_tilt", None]
    first = finding("spring_preload", ties=[["motor_encoder_offset", "swing"], tilt])
    second = finding("link_encoder_offset", ties=[tilt])
    both = record(first, second)
    truth = dict(both["truth"][0], parameters={"offset": 2.0})
    causes = [dict(truth, effect="motor_encoder_offset"), dict(truth, effect="base_tilt", joint=None)]

    assert outcome({**both, "truth": causes, "joints": 2}) == "tied"
    assert outcome({**both, "truth": causes[:1], "joints": 2}) == "partial"


# --- the sample -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("part", "number"), sample(NAMED, one_in=48, several=True, thorough_in=3))
def test_planted_causes_are_named(part: str, number: int) -> None:
    found = diagnosed(make(part, number))
    assert detectable(found)
    assert outcome(found) in ("exact", "tied"), misses([found])


@pytest.mark.parametrize("number", sample(HEALTHY, one_in=8))
def test_healthy_machines_are_left_alone(number: int) -> None:
    found = diagnosed(make("healthy", number))
    assert not summary.alarmed(found), misses([found])


@thorough
@pytest.mark.parametrize("number", STRUCK)
def test_a_struck_cause_gets_no_confident_wrong_name(number: int) -> None:
    found = diagnosed(make("struck", number))
    assert struck_outcome(found) != "wrong", misses([found])
    page = markdown([{**found, "version": "now"}, {**found, "part": "healthy", "version": "then"}])
    assert found["truth"][0]["effect"] in page and "struck" in page
    assert "code now (1 struck); then (1 healthy)" in page
