"""A law must hold at every place of its signal: what a sudden stop needs must not swing beside it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, findings_of, nominal
from support.thorough import thorough

import flexjoint as fj
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.followup.learning.places import PLACES, worst_place
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.table import Recording

CASE, JOINT = Case("lever", "rich", 3), "swing"
POSITION = 0.32  # rad: a tenth of the motion lies beyond it
STOP = Planted("end_stop", JOINT, {"position": POSITION, "stiffness": 5000.0})


def _recorded(seed: int = CASE.seed) -> Recording:
    return as_recording(replace(CASE, seed=seed).with_causes(STOP), f"stop-{seed}")


@cache
def found(excluded: frozenset[str] = frozenset({"end_stop"})) -> Diagnosis:
    return fj.diagnose(nominal(CASE.robot), _recorded(), excluded=excluded)


@cache
def learned() -> Diagnosis:
    return fj.learn(nominal(CASE.robot), _recorded(), found())


def _error(diagnosis: Diagnosis, recording: Recording) -> float:
    nrmse = fj.compare(diagnosis.extend(nominal(CASE.robot)), recording).nrmse
    return float(np.sqrt(np.mean(np.square(list(nrmse.values())))))


# ------------------------------------------------------------------ places
def test_an_error_that_a_law_adds_at_one_place_is_not_hidden_by_what_it_removes_elsewhere() -> None:
    rng = np.random.default_rng(1)
    signal, noise = rng.uniform(-1.0, 1.0, 4000), rng.normal(0.0, 0.1, (2, 4000))
    stop = np.maximum(signal - 0.8, 0.0) * 100.0
    without = noise + np.array([np.zeros(4000), stop])
    quiet = np.array([0.1, 0.1])
    assert worst_place(signal, without, noise, quiet) == pytest.approx(1.0, abs=0.05)  # RMS of 400 samples
    swings = noise + np.array([np.zeros(4000), np.where((signal > 0.0) & (signal < 0.2), 0.5, 0.0)])
    assert np.sum(swings**2) < 0.1 * np.sum(without**2)
    assert worst_place(signal, without, swings, quiet) == pytest.approx(np.hypot(0.5, 0.1) / 0.1, rel=0.05)
    assert worst_place(signal, without, swings, 10.0 * quiet) < 1.0  # below the noise it is none


def test_fewer_samples_than_places_are_a_place_each() -> None:
    signal = np.arange(PLACES - 3.0)
    ones = np.ones((1, signal.size))
    assert worst_place(signal, ones, 2.0 * ones, np.array([0.1])) == pytest.approx(2.0)


# ------------------------------------------------------------------ a struck end stop
@thorough
def test_a_stop_is_learned_over_a_part_of_the_range() -> None:
    """A spline over the whole range leaves 1.5 and 9 times as much on these motions: 0.96 of the second's."""
    laws = learned().learned.laws  # type: ignore[union-attr]
    assert [(law.effect, law.signal) for law in laws] == [("learned_link_torque", "q")]
    q = _recorded().get("q", JOINT)
    assert laws[0].at[-1] - laws[0].at[0] < 0.3 * np.ptp(q)
    assert laws[0].at[0] < POSITION < laws[0].at[-1]
    for seed in (1003, 1004):
        assert _error(learned(), _recorded(seed)) < 0.2 * _error(found(), _recorded(seed))


@thorough
def test_a_law_that_is_worse_at_some_place_is_dropped() -> None:
    settings = replace(USUAL, learn=replace(USUAL.learn, worse_place=0.0))  # of any law
    result = fj.learn(nominal(CASE.robot), _recorded(), found(), settings=settings).learned
    assert result is not None and result.laws == ()


# ------------------------------------------------------------------ the extended robot
@thorough
def test_laws_come_in_beside_the_causes_beside_which_they_were_learned_alone() -> None:
    robot = nominal(CASE.robot)
    stop = fj.effect("end_stop", JOINT, position=POSITION, stiffness=5000.0)
    (finding,) = findings_of(fit(Problem(balances_of(robot, _recorded())), [stop]))
    unlikely = replace(learned(), findings=(replace(finding, probability=0.2),))

    def names(least: float) -> list[str]:
        return [e.effect.name for e in unlikely.extend(robot, least).effects if not e.nominal]

    assert names(0.5) == ["learned_link_torque"]
    assert names(0.0) == ["end_stop"]  # which explains the same error
