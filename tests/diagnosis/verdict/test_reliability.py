"""How far names are believed: by what they leave, and by whether the simulation follows with them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planting import FULL, ROBOTS, Planted, plant
from support.diagnose_cases import Case, as_recording, findings_of, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.refinement import refined
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.result import Removed
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.reliability import followed, left_by, reliability, where_held
from flexjoint.effects import Planned, effect


def test_a_name_is_believed_by_what_it_leaves() -> None:
    """The cause itself leaves the noise; one that follows a part of the error leaves the rest."""
    friction = Planted("motor_coulomb_friction", "turn", {"level": 0.4})
    case = Case("turret_exact", "rich", 3)
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.with_causes(friction))))
    true = fit(problem, [effect("motor_coulomb_friction", "turn", level=0.4)])
    other = fit(true.problem, [effect("motor_viscous_friction", "turn", coefficient=0.4)])
    (left, share), (other_left, other_share) = (left_by(one, 0) for one in (true, other))

    assert left < 30.0
    assert other_left > 1000.0
    assert share < 1e-3 < other_share
    assert reliability(true, left, share) > 0.5
    assert reliability(other, other_left, other_share) < 0.2
    assert reliability(other, other_left, share) > reliability(other, other_left, other_share)
    assert reliability(other, left, other_share) > reliability(other, other_left, other_share)
    implausible = replace(true, problem=true.problem.at(NoiseLevel(true.problem.level.inflation, 2.0)))
    assert reliability(implausible, left, share) < reliability(true, left, share)
    two, three = (replace(true, effects=count * true.effects) for count in (2, 3))
    assert reliability(two, left, share) == reliability(true, left, share)
    assert reliability(three, left, share) < reliability(two, left, share)  # one without a name is likelier


def test_a_friction_lost_in_its_springs_noise_answers_for_what_its_link_shows() -> None:
    """Two levels named as one: noisy angles hide it from the motor's balance by itself, in which the name
    leaves 1.5 times the noise, and was believed with 0.95; in what motor and link show together it leaves
    2900 times."""
    two = Planted("asymmetric_friction", "swing", {"level_positive": 1.2, "level_negative": 0.2})
    noisy = {"q": 2e-3, "theta": 2e-3, "dq": 5e-3, "dtheta": 5e-3, "tau_t": 0.05}
    sensors = replace(FULL, noise=noisy, noisy_feedback=False)
    recorded = plant(ROBOTS / "lever_exact.yaml", [two], "rich", 8.0, 3, sensors)
    problem = Problem(balances_of(nominal("lever_exact"), as_recording(recorded)))
    one = fit(problem, [effect("motor_coulomb_friction", "swing", level=0.7)])
    left, share = left_by(one, 0)

    assert left > 300.0
    assert reliability(one, left, share) < 0.2


def believed(case: Case, planted: Planted, told: Planned, before: tuple[float, float]) -> tuple[float, float]:
    """Probability and reliability of a finding once its numbers are refined."""
    robot, recording = nominal(case.robot), as_recording(case.with_causes(planted))
    best = at_own_level(fit(Problem(balances_of(robot, recording)), [told]))
    probability, reliability = before
    doubted = [replace(f, probability=probability, reliability=reliability) for f in findings_of(best)]
    (found,) = followed(best, *refined.refine(best, doubted))
    return found.probability, found.reliability


FRICTION = Planted("motor_coulomb_friction", "swing", {"level": 1.5})


@pytest.mark.parametrize("before", [(0.1, 0.2), (0.3, 0.3), (0.9, 0.95)])
def test_a_cause_with_which_the_simulation_follows_is_believed(before: tuple[float, float]) -> None:
    """Of the motor's side alone, whatever it leaves in the balances; its ties share what it is believed."""
    told = effect("motor_coulomb_friction", "swing", level=1.0)
    probability, reliability = believed(Case("lever", "rich", 61, "motor_only"), FRICTION, told, before)

    assert reliability == max(0.5, before[1])
    assert probability == pytest.approx(before[0] / before[1] * reliability)


@pytest.mark.parametrize("sensors", ["motor_only", "full"])
def test_what_stands_in_for_a_cause_is_not_believed_more(sensors: str) -> None:
    told = effect("motor_viscous_friction", "swing", coefficient=0.5)

    assert believed(Case("lever", "rich", 61, sensors), FRICTION, told, (0.1, 0.2)) == (0.1, 0.2)


def test_what_is_left_of_positions_that_are_all_measured_counts() -> None:
    told = effect("motor_coulomb_friction", "swing", level=1.0)

    assert believed(Case("lever", "rich", 61), FRICTION, told, (0.1, 0.2)) == (0.1, 0.2)


def test_a_name_is_believed_as_far_as_unseen_data_hold_its_torque() -> None:
    limits, cause = USUAL.verdict, Removed("slide", "motor", 4.0, 4.0, 0.0, "q")

    def believed(before: float, held: float, std: float = 0.0) -> float:
        return where_held(before, replace(cause, held=held, held_std=std), limits)

    assert believed(0.9, 1.0) == believed(0.9, 1.2) == 0.9
    # the error is as large with the cause as without
    assert believed(0.99, 0.5) == pytest.approx(0.5, abs=0.05)
    assert believed(0.9, 0.5) < 0.5
    assert believed(0.9, 0.2) < believed(0.9, 0.5) < believed(0.9, 0.8) < 0.9
    # what noise may do is nothing against it
    assert believed(0.9, 0.7, 0.35) == 0.9
