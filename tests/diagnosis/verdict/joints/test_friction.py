"""Ordinary friction of joints that a set leaves wrong, judged by data that no fit saw."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.core.running.budget import Budget
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.joints.by_itself import joint_by_joint
from flexjoint.diagnosis.verdict.joints.friction import FRICTION
from flexjoint.effects import Planned, effect

ORDINARY = ("motor_coulomb_friction", "motor_viscous_friction")


def found_nothing(*causes: Planted, start: tuple[Planned, ...] = ()) -> tuple[Selection, list[Candidate]]:
    """A planted machine of which a search named only `start`, at the noise level that this leaves."""
    case = Case("crane", "rich", 17)
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.with_causes(*causes))))
    nothing = at_own_level(fit(problem, []))
    best = at_own_level(fit(problem, start)) if start else nothing
    return Selection(best, nothing, (), (), tuple(() for _ in start)), enumerate_candidates(problem)


def completed(selection: Selection, candidates: list[Candidate], workers: int = 1) -> Selection:
    return joint_by_joint(selection, candidates, FRICTION, workers, Budget(), lambda _share, _what: None)


def test_friction_of_a_light_joint_is_found_beside_what_a_heavy_one_leaves() -> None:
    """A cable without a name at the base leaves ten times the torque of the other joint's friction."""
    base, other = nominal("crane").joint_names[:2]
    causes = (
        Planted("cable_spring", base, {"stiffness": 25.0, "rest": 0.4}),
        Planted("motor_coulomb_friction", other, {"level": 0.8}),
    )
    selection, candidates = found_nothing(*causes)
    candidates = [c for c in candidates if c.effect.name != "cable_spring"]

    after = completed(selection, candidates)

    (found,) = [e for e in after.best.effects if e.joint == other]
    assert found.effect.name == "motor_coulomb_friction"
    assert found.values["level"] == pytest.approx(0.8, rel=0.1)
    (step,) = [step for step in after.trace if step.joint == other]
    assert (step.stage, step.action, step.check) == ("friction", "added", "background")


@pytest.mark.parametrize("tolerances", [2.0, 5.0])
def test_claimed_friction_that_is_off_by_more_than_a_tolerance_explains_is_a_cause(tolerances: float) -> None:
    """Deviations of the nominal numbers may explain all of it, and then nothing is left that would tell."""
    robot = nominal("crane")
    joint = robot.joint(robot.joint_names[1])
    more = tolerances * robot.tolerance.damping * joint.drive.D_m
    selection, candidates = found_nothing(
        Planted("motor_viscous_friction", joint.name, {"coefficient": more})
    )

    named = [e for e in completed(selection, candidates).best.effects if e.joint == joint.name]

    assert [e.effect.name for e in named] == ["motor_viscous_friction"] * (
        tolerances > USUAL.verdict.believed
    )
    assert all(e.values["coefficient"] == pytest.approx(more, rel=0.1) for e in named)


def test_no_friction_is_added_to_a_healthy_machine() -> None:
    selection, candidates = found_nothing()

    assert completed(selection, candidates) is selection


def test_a_law_that_stood_in_for_friction_gives_way_to_it() -> None:
    joint = nominal("crane").joint_names[0]
    causes = (
        Planted("motor_coulomb_friction", joint, {"level": 20.0}),
        Planted("motor_viscous_friction", joint, {"coefficient": 25.0}),
    )
    stand_in = effect("drive_efficiency", joint, loss_driving=0.3, loss_backdriving=0.3)
    selection, candidates = found_nothing(*causes, start=(stand_in,))

    after = completed(selection, candidates)

    assert sorted(e.effect.name for e in after.best.effects if e.joint == joint) == sorted(ORDINARY)
    assert len(after.rivals) == len(after.best.effects)


def test_any_number_of_processes_finds_the_same() -> None:
    joint = nominal("crane").joint_names[1]
    selection, candidates = found_nothing(Planted("motor_coulomb_friction", joint, {"level": 0.8}))

    one, two = (completed(replace(selection), candidates, workers) for workers in (1, 2))

    assert one.best.effects == two.best.effects != ()
    assert [step.text for step in one.trace] == [step.text for step in two.trace]


def test_a_budget_that_is_spent_ends_it() -> None:
    joint = nominal("crane").joint_names[1]
    selection, candidates = found_nothing(Planted("motor_coulomb_friction", joint, {"level": 0.8}))

    after = joint_by_joint(selection, candidates, FRICTION, 1, Budget(0.0), lambda _share, _what: None)

    assert after.best.effects == ()
