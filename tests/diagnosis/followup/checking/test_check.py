"""Whether a machine is as it was: no alarm for another recording of it, an alarm for a change."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from planting import Planted, plant
from support.cli_runs import complaint, run
from support.diagnose_cases import ROBOTS, SENSORS, as_recording, findings_of, nominal
from support.thorough import exhaustive, thorough

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.followup.checking import numbers
from flexjoint.diagnosis.followup.checking.check import check, refitted
from flexjoint.diagnosis.followup.checking.left import _more, left_by
from flexjoint.diagnosis.followup.checking.values import Check, CheckedCause, CheckedNumber
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis, Remaining
from flexjoint.diagnosis.result.known import Known
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording, read
from flexjoint.recording.table import write as write_recording
from flexjoint.robot.robot import load, shipped_robots

FRICTION, GAP, MORE_FRICTION, WIDER, DRAG = "friction", "gap", "more friction", "wider gap", "drag"
CAUSES = {
    FRICTION: Planted("motor_coulomb_friction", "swing", {"level": 1.0}),
    GAP: Planted("backlash", "swing", {"gap": 0.01}),
    MORE_FRICTION: Planted("motor_coulomb_friction", "swing", {"level": 1.3}),
    WIDER: Planted("backlash", "swing", {"gap": 0.012}),
    DRAG: Planted("link_viscous_friction", "swing", {"coefficient": 2.0}),
}
MACHINE = 7  # seed of the real machine's deviations from the nominal one


@cache
def recorded(seed: int, *causes: str) -> Recording:
    """12 s of one lever, whose nominal numbers are off within their tolerances, along a motion of its own."""
    one = plant(
        ROBOTS / "lever.yaml", [CAUSES[name] for name in causes], "rich", 12.0, seed,
        SENSORS["full"], inexact=0.02, plant_seed=MACHINE,
    )  # fmt: skip
    return as_recording(one, f"lever-{seed}")


def fitted(*causes: str) -> Diagnosis:
    """What a diagnosis says that found these causes, without its search."""
    table, planted = recorded(1, *causes), [CAUSES[name] for name in causes]
    problem = Problem(balances_of(nominal("lever"), table))
    effects = [Planned.of(c.effect, c.joint, c.parameters) for c in planted]
    best = refitted(problem, Known(nominal("lever"), tuple(effects), frozenset(), {}, ""))
    level = float(np.mean(best.problem.level.inflation))
    return Diagnosis(
        "causes" if causes else "healthy", "fitted", findings_of(best), remaining=left_by(best),
        energy=(level, level), robot="lever",
    )  # fmt: skip


@cache
def known() -> Diagnosis:
    return fitted(FRICTION, GAP)


@cache
def healthy() -> Diagnosis:
    return fitted()


def checked(seed: int, *causes: str) -> Check:
    return check(nominal("lever"), recorded(seed, *causes), known())


def states(found: Check) -> dict[str, str]:
    return {cause.effect: cause.state for joint in found.joints for cause in joint.causes}


# ------------------------------------------------------------------ as before
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_another_recording_of_the_same_machine_is_as_before(seed: int) -> None:
    found = checked(seed, FRICTION, GAP)
    assert found.verdict == "as_before", str(found)
    assert states(found) == {"motor_coulomb_friction": "there", "backlash": "there"}


@pytest.mark.parametrize("seed", [2, 3])
def test_a_healthy_machine_stays_as_it_was(seed: int) -> None:
    assert not healthy().findings
    found = check(nominal("lever"), recorded(seed), healthy())
    assert found.verdict == "as_before" and "as before" in str(found)


def test_of_a_fast_recording_a_part_is_looked_at_and_said() -> None:
    limits = replace(USUAL, check=replace(USUAL.check, samples_a_second=250.0))
    found = check(nominal("lever"), recorded(2, FRICTION, GAP), known(), settings=limits)
    seconds = found.span[1] - found.span[0]
    assert seconds == pytest.approx(6.0, abs=0.1)  # half of 12 s: 250 of 500 samples a second
    assert any("too large for a check" in note for note in found.notes) and "Looked at" in str(found)


@exhaustive
def test_what_diagnose_says_is_as_before_on_its_own_machine() -> None:
    """The whole way: search, refinement on the simulation, JSON, check."""
    found = diagnose(nominal("lever"), recorded(1, FRICTION, GAP))
    assert {f.effect for f in found.findings} == {"motor_coulomb_friction", "backlash"}
    assert check(nominal("lever"), recorded(2, FRICTION, GAP), found).verdict == "as_before"
    assert check(nominal("lever"), recorded(2, FRICTION, WIDER), found).verdict == "changed"


# ------------------------------------------------------------------ changed
@pytest.mark.parametrize(
    ("now", "effect", "state"),
    [
        ((MORE_FRICTION, GAP), "motor_coulomb_friction", "moved"),
        ((FRICTION, WIDER), "backlash", "moved"),
        ((FRICTION,), "backlash", "gone"),
    ],
    ids=["more friction", "a wider gap", "a gap that was repaired"],
)
def test_what_moved_is_named(now: tuple[str, ...], effect: str, state: str) -> None:
    found = checked(4, *now)
    assert found.verdict == "changed"
    assert states(found)[effect] == state, str(found)


def test_a_new_cause_shows_in_what_is_left() -> None:
    assert checked(3, FRICTION, GAP, DRAG).changed[0].grown
    on_healthy = check(nominal("lever"), recorded(3, DRAG), healthy())
    assert on_healthy.verdict == "changed" and on_healthy.changed[0].grown


# ------------------------------------------------------------------ a real machine
@thorough
def test_what_a_robust_search_found_is_checked_in_its_own_balances() -> None:
    """In the usual ones its friction vanished, and another recording of the same day looked like a change."""
    folder = shipped_robots()["kr300"].parent
    robot, recording = load("kr300"), read(folder / "recordings" / "rec_B.parquet")
    diagnosis = folder / "diagnosed" / "rec_A.json"
    same = check(robot, recording, diagnosis)
    assert same.verdict == "as_before", str(same)
    (third,) = (joint for joint in same.joints if joint.joint == "joint_3")
    assert {cause.effect: cause.state for cause in third.causes}["breakaway_friction"] == "there"
    speed = np.gradient(recording.get("theta", "joint_3"), recording.time)
    key = ("tau_motor", "joint_3")
    braked = recording.columns[key] + 300.0 * np.tanh(speed / 0.01)  # a tenth of its torque (RMS)
    worn = check(robot, replace(recording, columns={**recording.columns, key: braked}), diagnosis)
    assert [joint.joint for joint in worn.changed] == ["joint_3"]


# ------------------------------------------------------------------ against what
def test_an_extended_robot_alone_will_do(tmp_path: Path) -> None:
    path = tmp_path / "extended.yaml"
    extended = known().extend(nominal("lever"))
    extended.write(path)
    alone = check(extended, recorded(2, FRICTION, GAP))
    assert alone.verdict == "as_before", str(alone)
    by_path = check(nominal("lever"), recorded(2, FRICTION, GAP), path)
    assert states(by_path) == states(alone)
    assert check(nominal("lever"), recorded(4, FRICTION, WIDER), path).verdict == "changed"
    bare = check(nominal("lever"), recorded(2))  # no causes: what is left is judged by itself
    assert bare.verdict == "as_before" and not states(bare)


def test_an_unlikely_cause_is_fitted_and_not_tested() -> None:
    doubtful = replace(known(), findings=tuple(replace(f, probability=0.2) for f in known().findings))
    found = check(nominal("lever"), recorded(4, FRICTION, WIDER), doubtful)
    assert set(states(found).values()) == {"not tested"}


def test_as_many_chances_are_counted_as_there_are_numbers() -> None:
    """A distance that is beyond chance for one number is not for one of many."""
    one = CheckedNumber("level", 1.0, 0.1, 1.5, 0.1, "N m", 4.6)
    assert numbers._chance(one, 8.0) < 0.01 < 20 * numbers._chance(one, 8.0)


# ------------------------------------------------------------------ unusable
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (3.0, "check: expected a diagnosis, an extended robot or the path of one, got a float"),
        (Diagnosis("refused", "the data cannot be right"), "refused its recording"),
    ],
)
def test_what_is_no_earlier_state_is_refused(wrong: object, said: str) -> None:
    with pytest.raises(FlexJointError, match=said):
        check(nominal("lever"), recorded(2), wrong)  # type: ignore[arg-type]


def test_wrong_data_are_no_change_of_the_machine() -> None:
    good = recorded(2, FRICTION, GAP)
    turned = {k: -v if k == ("tau_m", "swing") else v for k, v in good.columns.items()}
    with pytest.raises(RecordingError, match="the data cannot be right"):
        check(nominal("lever"), replace(good, columns=turned), known())
    with pytest.raises(RecordingError, match=r"cannot be checked: only .* of usable data"):
        check(nominal("lever"), good.between(0.0, 0.8), known())


# ------------------------------------------------------------------ command line
def test_the_exit_code_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, diagnosis = ROBOTS / "lever.yaml", tmp_path / "diagnosis.json"
    known().write(diagnosis)
    same, worn = tmp_path / "same.parquet", tmp_path / "worn.parquet"
    write_recording(recorded(2, FRICTION, GAP), same)
    write_recording(recorded(4, FRICTION, WIDER), worn)
    out = tmp_path / "check.json"
    words = ("--against", diagnosis, "--robot", robot)
    assert run("check", same, *words, "--json", out) == 0
    assert json.loads(out.read_text())["verdict"] == "as_before"
    shown = capsys.readouterr().out
    assert "as before" in shown and "swing" in shown
    assert run("check", worn, *words, "--json", out, "--quiet") == 1
    content = json.loads(out.read_text())
    (joint,) = content["joints"]
    assert content["verdict"] == "changed" and joint["state"] == "changed"
    gap = next(c for c in joint["causes"] if c["effect"] == "backlash")["parameters"]["gap"]
    assert gap["moved"] and gap["now"] == pytest.approx(0.012, abs=5.0 * gap["now_std"])
    assert capsys.readouterr().out == ""
    said = complaint(capsys, "check", same, "--against", diagnosis)
    assert "does not hold its robot" in said
    said = complaint(capsys, "check", same, "--robot", robot, "--against", tmp_path / "no.json")
    assert "cannot be read" in said


def test_words_of_a_cause() -> None:
    moved = CheckedNumber("gap", 0.01, 0.0002, 0.015, 0.0003, "rad", 14.0, moved=True)
    cause = CheckedCause("backlash", "elbow", "moved", (moved,))
    assert str(cause) == "backlash moved (gap 0.0150 ± 0.0003 rad, was 0.0100 ± 0.0002)"


def test_a_shape_that_was_left_before_is_no_change() -> None:
    was = Remaining("turn", torque=3.0, before=0.136, after=0.136, noise=0.134, structured=0.075, against="q")
    wider = replace(was, structured=0.11)  # within what recordings of one machine differ by
    new = replace(was, structured=0.16)

    said = [_more(now, was, 0.005, USUAL) for now in (was, wider, new)]
    assert said == ["", "", "what is left has a shape of q that was not there"]
    assert _more(was, replace(was, structured=0.0), 0.005, USUAL) == said[-1]
