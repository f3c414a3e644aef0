"""How much of a cause's own torque data hold that the fit did not see."""

from __future__ import annotations

from functools import cache

import pytest
from support.robots.coupled_robots import coupled, swinging

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Removed
from flexjoint.diagnosis.verdict.unseen import torques
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.simulate import simulate

LEVEL = 2.0  # N m


def rubbing(level: float) -> Planned:
    return Planned.of("motor_coulomb_friction", "yaw", {"level": level})


@cache
def problem() -> Problem:
    """A rigid arm whose first joint rubs, which the nominal model does not know."""
    robot = coupled(None, rigid=True)
    model = FlexibleJointModel(robot, [rubbing(LEVEL)])
    noise = {"theta": 2e-5, "tau_m": 0.01}
    run = simulate(model, swinging(robot, 12.0), sample_rate=500.0, noise=noise)
    return Problem(balances_of(robot, run.measured))


def of(cause: Planned) -> Removed:
    view = torques._uncorrected(problem(), [cause], True)
    return torques.removed(torques.in_views(view, [cause]), 0)


def test_of_the_right_law_all_is_held() -> None:
    found = of(rubbing(LEVEL))
    assert found.joint == "yaw"
    assert found.held == pytest.approx(1.0, abs=0.03)
    assert found.held_std < 0.03


@pytest.mark.parametrize("times", [2.0, 4.0, 0.5])
def test_of_a_size_that_is_off_its_share(times: float) -> None:
    assert of(rubbing(times * LEVEL)).held == pytest.approx(1.0 / times, rel=0.1)


def test_where_half_is_held_the_error_is_as_large_with_the_cause_as_without() -> None:
    found = of(rubbing(2.0 * LEVEL))
    assert found.left == pytest.approx(found.without, rel=0.1)


def test_of_a_law_that_is_not_there_little_is_held() -> None:
    """A gear's ripple has nothing of this friction."""
    other = Planned.of("cogging", "yaw", {"amplitude": 0.5 * LEVEL, "cycles": 37.0, "phase": 0.3})
    found = of(other)
    assert found.held < 0.2
    assert found.left > found.without


def test_a_cause_that_hardly_acts_on_unseen_data_is_not_held_against_them() -> None:
    """An end stop at the end of the range, which this motion touches once."""
    case = problem()
    q = case.readings.theta[0]
    stop = Planned.of("end_stop", "yaw", {"position": float(q.max()) - 1e-4, "stiffness": 50.0})
    view = torques._uncorrected(case, [rubbing(LEVEL), stop], True)
    assert torques.removed(torques.in_views(view, [rubbing(LEVEL), stop]), 1).held is None
