"""Rivals of a cause: which are tried in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from planting import Planted, plant, robot_file
from support.diagnose_cases import QUIET, Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search import selection
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Search, _needed, _ordinary_too, _rubs_all_over, exchange
from flexjoint.effects import catalogue, effect
from flexjoint.robot.robot import load

COULOMB = Planted("motor_coulomb_friction", "joint_0", {"level": 0.00113})


def test_the_truth_is_tried_in_the_place_of_a_law_that_does_the_same() -> None:
    """The joint carries a load that hardly changes: friction in proportion to it is Coulomb friction. Of both
    a scan shows half of what they explain once they stick where they stick, and of a law with more numbers
    nearly all: it must not keep the simple law from being tried."""
    file = robot_file("drawn_200003_of1_exact")
    recorded = plant(file, [COULOMB], "steps", seconds=7.0, seed=5, sensors=QUIET["ragged"], rate=200.0)
    problem = Problem(balances_of(load(file), as_recording(recorded)))
    best = at_own_level(fit(problem, [effect("load_friction", "joint_0", coefficient=0.01)]))
    with worker_pool([], 1) as pool:
        search = Search(Scanner(enumerate_candidates(problem)), pool)

        found, rivals = exchange(search, best, best.effects)

    names = {f.effects[-1].effect.name for f in rivals[0]} | {found.effects[0].effect.name}
    assert "motor_coulomb_friction" in names


@thorough
def test_beside_what_took_a_place_further_causes_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """An offset stands for a cable until the cable takes its place; a ripple is seen only then."""
    cable = Planted("cable_spring", "turn", {"stiffness": 2.0, "rest": 0.3})
    ripple = Planted("cogging", "turn", {"amplitude": 0.05, "cycles": 20.0, "phase": 0.5})
    recorded = as_recording(Case("turret", "rich", 3, inexact=0.02).with_causes(cable, ripple))
    problem = Problem(balances_of(nominal("turret"), recorded))
    best_of, offset = selection._best_at_own_level, effect("torque_offset", "turn", offset=0.1)
    rounds = []

    def first_wrong(best: Fit, larger: Sequence[Fit]) -> Fit | None:
        rounds.append(len(rounds))
        return best_of(best, larger) if len(rounds) > 1 else at_own_level(fit(problem, [offset]))

    monkeypatch.setattr(selection, "_best_at_own_level", first_wrong)
    found = selection.select(problem, enumerate_candidates(problem), lambda _share, _what: None).best

    assert {e.effect.name for e in found.effects} == {"cable_spring", "cogging"}
    (cycles,) = (e.values["cycles"] for e in found.effects if e.effect.name == "cogging")
    assert cycles == pytest.approx(20.0, rel=0.01)


def test_a_set_in_a_local_minimum_is_fitted_again_before_a_cause_is_dropped() -> None:
    """A smaller set can leave no less than a larger one that is fitted well."""
    cable = Planted("cable_spring", "turn", {"stiffness": 2.0, "rest": 0.3})
    rubs = Planted("motor_coulomb_friction", "turn", {"level": 0.5})
    recorded = as_recording(Case("turret", "rich", 3, inexact=0.02).with_causes(cable, rubs))
    problem = Problem(balances_of(nominal("turret"), recorded))
    wrong = [
        effect("motor_coulomb_friction", "turn", level=2.0),
        effect("cable_spring", "turn", stiffness=2.0, rest=0.3),
    ]
    with worker_pool([], 1) as pool:
        found = selection.prune(fit(problem, wrong, held=wrong), pool)

    numbers = {e.effect.name: e.values for e in found.effects}
    assert numbers["motor_coulomb_friction"]["level"] == pytest.approx(0.5, rel=0.05)
    assert numbers["cable_spring"]["stiffness"] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_a_rival_is_asked_for_no_more_than_the_cause_shows(share: float) -> None:
    case = Case("lever", "rich", 5)
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.with_causes())))
    (scored, *_) = Scanner(enumerate_candidates(problem)).scan(fit(problem, []))
    own = replace(scored, removes=100.0)

    assert _needed(100.0 / share, [own], scored.candidate.key) == min(100.0, 100.0 / share)
    assert _needed(7.0, [], scored.candidate.key) == 7.0


@pytest.mark.parametrize(("rubbing", "all_over"), [(2, False), (3, True)])
def test_friction_of_most_joints_is_the_machines(rubbing: int, all_over: bool) -> None:
    """No other law takes its place on one joint, but one that contains it."""
    robot = nominal("gimbal")
    problem = Problem(balances_of(robot, as_recording(Case("gimbal", "rich", 3).with_causes())))
    rubs = [effect("motor_coulomb_friction", joint, level=0.5) for joint in robot.joint_names[:rubbing]]

    assert _rubs_all_over(fit(problem, rubs)) is all_over
    coulomb = rubs[0].effect
    assert _ordinary_too(catalogue()["stribeck_friction"], coulomb)
    assert _ordinary_too(catalogue()["motor_viscous_friction"], coulomb)
    assert not _ordinary_too(catalogue()["quadratic_drag"], coulomb)
