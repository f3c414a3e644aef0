"""Learned laws: planted ones of no catalogue are learned and make an unseen simulation better; a healthy
machine, and one that a cause explains, teach nothing; and nothing of a diagnosis changes."""

import json
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import exhaustive, thorough

import flexjoint as fj
from flexjoint.core.errors import FlexJointError, RecordingError, UnknownNameError
from flexjoint.core.running.budget import Budget
from flexjoint.diagnosis.followup.learning.advice import LOOK
from flexjoint.diagnosis.followup.learning.judge import gained
from flexjoint.diagnosis.followup.learning.simulation import held
from flexjoint.diagnosis.followup.learning.splines import penalty
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.result.known import known_of
from flexjoint.diagnosis.result.schema import schema
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import catalogue
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

CASE = Case("lever", "rich", 3)
JOINT = "swing"
# of tests/planting/machine/outside.py, with an integrator, steps and events of its own
PLANTED = {
    "hose": Planted("kinked_hose", JOINT, {"torque": 6.0, "angle": 0.2, "width": 0.1}),
    "spring": Planted("soft_centre", JOINT, {"stiffness": 200.0, "width": 0.01}),
    "friction": Planted("motor_coulomb_friction", JOINT, {"level": 3.0}),
    "ripple": Planted("load_cogging", JOINT, {"share": 0.3, "cycles": 1.0, "phase": 0.0}),
}
HOSE, SPRING, FRICTION, RIPPLE = PLANTED


@cache
def learned(*causes: str) -> tuple[Robot, Recording, Diagnosis, Diagnosis]:
    recorded = CASE.with_causes(*(PLANTED[name] for name in causes))
    robot, recording = nominal(CASE.robot), as_recording(recorded, CASE.name)
    found = fj.diagnose(robot, recording)
    return robot, recording, found, fj.learn(robot, recording, found)


def unseen_error(robot: Robot, cause: str) -> float:
    """Root mean square of the NRMSE of all channels on another motion of the machine."""
    fresh = as_recording(replace(CASE, seed=CASE.seed + 1000).with_causes(PLANTED[cause]), "fresh")
    return float(np.sqrt(np.mean(np.square(list(fj.compare(robot, fresh).nrmse.values())))))


@thorough
@pytest.mark.parametrize(
    ("planted", "effect", "signal", "less"),
    [(HOSE, "learned_link_torque", "q", 20.0), (SPRING, "learned_deflection", "phi", 5.0)],
)
def test_a_law_of_no_catalogue_is_learned(planted: str, effect: str, signal: str, less: float) -> None:
    robot, _, found, more = learned(planted)
    assert more.learned is not None
    law = more.learned.laws[0]
    assert (law.effect, law.joint, law.signal) == (effect, JOINT, signal)
    assert law.share > 0.8 and law.removed.left < 0.25 * law.removed.without
    assert 2.0 <= law.freedom <= 12.0
    gain = more.learned.simulation
    assert gain is not None
    assert all(gain.after["nrmse"][name] < gain.before["nrmse"][name] for name in gain.before["nrmse"])
    before, after = (unseen_error(d.extend(robot), planted) for d in (found, more))
    assert after < before / less


@exhaustive
def test_a_law_of_two_signals_is_learned_where_none_of_one_holds() -> None:
    """The motor's torque constant changes with its angle: a product of the command and a law of theta."""
    robot, recording, found, more = learned(RIPPLE)
    assert more.learned is not None
    (law,) = more.learned.laws
    assert (law.effect, law.joint, {law.signal, law.other}) == ("learned_surface", JOINT, {"theta", "tau_m"})
    assert law.share > 0.8 and 4.0 <= law.freedom <= 36.0
    before, after = (unseen_error(d.extend(robot), RIPPLE) for d in (found, more))
    assert after < before / 5.0
    assert len(law.sections) == 3 and law.sections[1].value == pytest.approx(law.value)
    text = str(more).replace("\n", " ")
    assert "follows motor position theta and motor torque command tau_m" in text

    from flexjoint import report

    assert "with two standard errors as a band" in report.render(more, robot, recording)
    jsonschema = pytest.importorskip("jsonschema")
    content = json.loads(json.dumps(to_json(more)))
    jsonschema.validate(content, schema("diagnosis"), cls=jsonschema.Draft202012Validator)
    assert content["learned"]["laws"][0]["other"] == law.other


@thorough
def test_the_curve_is_the_planted_law_within_its_band() -> None:
    """Up to a constant, which the unknown zero of a torque has as well."""
    _, _, _, more = learned(HOSE)
    assert more.learned is not None
    law = more.learned.laws[0]
    at, value, std = (np.array(x) for x in (law.at, law.value, law.std))
    true = -6.0 * np.tanh((at - 0.2) / 0.1)
    # a spline of nine pieces over this range leaves a tenth of a step that is as wide as a piece
    away = value - true - np.mean(value - true)
    assert np.sqrt(np.mean(away**2)) < 0.1 * 6.0
    assert np.mean(np.abs(value - true) <= 2.0 * std) > 0.9


def moving(seed: int, *causes: str) -> Recording:
    """Another motion of the machine."""
    case = replace(CASE, seed=seed)
    return as_recording(case.with_causes(*(PLANTED[name] for name in causes)), f"{case.name}-{seed}")


@thorough
def test_a_law_of_several_recordings_holds_on_one_that_none_of_them_is() -> None:
    robot, recording, found, _ = learned(HOSE)
    both = fj.learn(robot, [recording, moving(2003, HOSE)], found)
    assert both.learned is not None
    law = both.learned.laws[0]
    assert (law.effect, law.joint, law.signal) == ("learned_link_torque", JOINT, "q")
    gain = both.learned.simulation  # on stretches of either that its law did not see
    assert gain is not None and gain.after["nrmse"][f"q.{JOINT}"] < 0.3 * gain.before["nrmse"][f"q.{JOINT}"]
    before, after = (unseen_error(d.extend(robot), HOSE) for d in (found, both))
    assert after < before / 20.0


@thorough
def test_a_law_that_only_one_of_two_recordings_shows_is_not_kept() -> None:
    robot, recording, found, _ = learned(HOSE)
    result = fj.learn(robot, [recording, moving(2003)], found).learned
    assert result is not None and result.laws == ()


def test_what_it_resembles_and_what_to_look_at_is_said() -> None:
    _, _, _, more = learned(HOSE)
    assert more.learned is not None
    law = more.learned.laws[0]
    correlations = [one.correlation for one in law.alike]
    assert correlations == sorted(correlations, reverse=True) and 0.0 <= correlations[-1] <= 1.0
    assert {one.effect for one in law.alike} <= {n for n, e in catalogue().items() if e.is_cause}
    assert "cable_spring" in {one.effect for one in law.alike[:4]}
    text = str(more)
    assert "Laws without a name" in text and "They are no causes" in text
    assert "Look at what pulls at the link by its pose" in text.replace("\n", " ")


@thorough
@pytest.mark.parametrize("causes", [(), (FRICTION,)], ids=["healthy", "explained"])
def test_nothing_is_learned_where_nothing_is_left(causes: tuple[str, ...]) -> None:
    robot, _, found, more = learned(*causes)
    assert more.learned is not None and more.learned.laws == ()
    assert more.extend(robot) == found.extend(robot)


@pytest.mark.parametrize(
    "causes",
    [
        pytest.param((), id="healthy"),
        pytest.param((FRICTION,), id="explained", marks=thorough),
        pytest.param((HOSE,), id="left"),
    ],
)
def test_a_diagnosis_is_not_changed(causes: tuple[str, ...]) -> None:
    _, _, found, more = learned(*causes)
    for one in fields(Diagnosis):
        if one.name != "learned":
            assert getattr(more, one.name) is getattr(found, one.name)
    assert {k: v for k, v in to_json(more).items() if k != "learned"} == {
        k: v for k, v in to_json(found).items() if k != "learned"
    }


def test_no_search_looks_for_a_learned_law() -> None:
    _, _, found, _ = learned(HOSE)
    names = {r.effect for r in found.ranking} | {f.effect for f in found.findings}
    assert names and not any(name.startswith("learned") for name in names)


def test_an_extended_robot_carries_it_from_and_to_its_file(tmp_path: Path) -> None:
    from flexjoint.robot.robot import write

    robot, recording, _, more = learned(HOSE)
    extended = more.extend(robot)
    write(extended, tmp_path / "extended.yaml")
    again = fj.load_robot(tmp_path / "extended.yaml")
    one, other = (dict(fj.compare(r, recording).nrmse) for r in (extended, again))
    assert one == pytest.approx(other, rel=1e-9)
    # it is part of the model that a check compares with, and no number of it is checked
    known = known_of(robot, again)
    assert known.causes == () and [e.effect.name for e in known.robot.effects] == ["learned_link_torque"]


def test_the_json_keeps_to_its_schema() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    for causes in ((), (HOSE,)):
        content = json.loads(json.dumps(to_json(learned(*causes)[3])))
        jsonschema.validate(content, schema("diagnosis"), cls=jsonschema.Draft202012Validator)
    (law,) = content["learned"]["laws"][:1]
    assert len(law["parameters"]["torques"]) == 12 and law["parameters"]["signal"] == "q"
    assert len(law["curve"]["at"]) == len(law["curve"]["value"]) == len(law["curve"]["std"])
    assert to_json(learned()[2])["learned"] is None


def test_the_page_draws_it() -> None:
    from flexjoint import report

    robot, recording, _, more = learned(HOSE)
    html = report.render(more, robot, recording)
    assert "Laws without a name" in html and "with two standard errors as a band" in html
    assert "Laws without a name" not in report.render(learned(HOSE)[2], robot, recording)


@thorough
def test_it_refuses_what_it_cannot_use() -> None:
    robot, recording, found, _ = learned(HOSE)
    with pytest.raises(RecordingError, match="no recording given"):
        fj.learn(robot, [], found)
    with pytest.raises(FlexJointError, match="expected what diagnose returns"):
        fj.learn(robot, recording, {})  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="swing"):
        fj.learn(nominal("turret"), recording, replace(found, findings=learned(FRICTION)[2].findings))


def test_a_short_recording_teaches_nothing() -> None:
    robot, recording, found, _ = learned(HOSE)
    rows = recording.time < 3.0
    short = replace(
        recording, time=recording.time[rows], columns={k: v[rows] for k, v in recording.columns.items()}
    )
    result = fj.learn(robot, short, found).learned
    assert result is not None and result.laws == () and "4 s of motion" in result.notes[0]


def test_a_law_that_makes_the_simulation_worse_is_dropped() -> None:
    robot, recording, found, _ = learned(HOSE)
    settings = replace(USUAL, learn=replace(USUAL.learn, worse=0.0))  # of any law
    result = fj.learn(robot, recording, found, settings=settings).learned
    assert result is not None and result.laws == () and "not surely better" in result.notes[0]


def test_a_law_with_which_the_simulation_is_not_surely_better_is_dropped() -> None:
    robot, recording, found, _ = learned(HOSE)
    settings = replace(USUAL, learn=replace(USUAL.learn, sure_simulation=1e6))
    result = fj.learn(robot, recording, found, settings=settings).learned
    assert result is not None and result.laws == () and "not surely better" in result.notes[0]


def test_a_law_that_no_time_is_left_to_simulate_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, recording, found, _ = learned(HOSE)
    clock = [0.0]
    budget = Budget(1000.0, clock=lambda: clock[0])

    def late(*arguments: Any) -> Any:
        clock[0] = 1001.0
        return held(*arguments)

    monkeypatch.setattr("flexjoint.diagnosis.followup.learning.learn.held", late)
    result = fj.learn(robot, recording, found, budget=budget).learned
    assert result is not None and result.laws == () and result.simulation is None
    assert "before the simulation could confirm it" in result.notes[0]


def test_a_gain_counts_in_its_standard_errors_over_blocks() -> None:
    """Of many recordings of twelve blocks, whose errors with a law and without differ by chance."""
    rng = np.random.default_rng(4)
    before, after = (rng.chisquare(50, (4000, 12)) for _ in range(2))
    each = [gained(b, a) for b, a in zip(before, after, strict=True)]
    scatter = float(np.std([one.share for one in each]))
    assert np.sqrt(np.mean([one.std**2 for one in each])) == pytest.approx(scatter, rel=0.05)
    # Student's t of eleven degrees of freedom is beyond three in 0.6 % on one side
    assert np.mean([one.sure >= 3.0 for one in each]) == pytest.approx(0.006, abs=0.004)


def test_every_law_and_signal_has_an_advice() -> None:
    laws = [e for e in catalogue().values() if not e.is_cause]
    assert set(LOOK) == {(e.name, s) for e in laws if len(e.words) == 1 for s in e.words[0].choices}
    (surface,) = (e for e in laws if len(e.words) == 2)
    for word in surface.words:  # one of two signals has the advice of both
        assert all(("learned_torque", signal) in LOOK for signal in word.choices)


def test_lines_are_free_of_the_penalty() -> None:
    bent = penalty(12)
    k = np.arange(12.0)
    assert np.allclose(bent @ k, 0.0) and np.allclose(bent @ np.ones(12), 0.0)
    assert k**2 @ bent @ k**2 == pytest.approx(10 * 2.0**2)
