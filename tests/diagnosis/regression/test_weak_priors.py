"""What is known of a number before any data: weakly, where the data say nothing of it."""

from __future__ import annotations

import math

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Slot, fit, normal_equations, weak_prior
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, effect

WORN = Planted("breakaway_friction", "swing", {"level": 2.0, "distance": 0.5})  # N m, rad


def _worn(level: float) -> Planned:
    return effect(WORN.effect, WORN.joint, level=level, distance=0.01)


@pytest.fixture(scope="module")
def problem() -> Problem:
    recorded = as_recording(Case("lever", "rich", 4).with_causes(WORN))
    return Problem(balances_of(nominal("lever"), recorded))


def test_a_friction_is_hardly_larger_than_all_torque_of_its_joint(problem: Problem) -> None:
    (torque,) = problem.torque_scale
    usual, huge = (fit(problem, [_worn(k * torque)], iterations=0) for k in (0.1, 10.0))

    # beyond what the data say of them (to first order about the same numbers)
    for one, prior in ((usual, 0.1**2), (huge, 10.0**2)):
        slope = normal_equations(problem, one.tangents, one.y, one.slots, one.effects)[1]
        data = problem.normal(one.tangents, one.y)[1]
        level = next(k for k, slot in enumerate(one.slots) if slot.param.name == "level")
        value = one.effects[0].values["level"]
        assert (slope - data)[level] * value == pytest.approx(prior)


def test_the_prior_moves_no_number_that_the_data_show(problem: Problem) -> None:
    fitted = fit(problem, [effect(WORN.effect, WORN.joint, level=1.0, distance=0.3)])

    assert fitted.effects[0].values["level"] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "param"), [("cable_spring", "rest"), ("end_stop", "position"), ("rough_spot", "position")]
)
def test_a_position_of_a_joint_lies_near_its_zero(name: str, param: str) -> None:
    planned = effect(name, "swing", **{param: 12.5})
    (number,) = (p for p in planned.effect.params if p.name == param)

    value, slope = weak_prior(Slot(0, number, 0), [planned], USUAL.regression, 10.0)

    deviation = USUAL.regression.angle_deviation

    assert (value, slope) == pytest.approx((12.5 / deviation, 1.0 / deviation))


def test_a_constant_torque_is_no_spring_at_rest_far_away() -> None:
    """Its stiffness and its rest would trade places along a line, up to a bound, and neither is known."""
    case = Case("lever", "rich", 4).with_causes(Planted("torque_offset", "swing", {"offset": 0.8}))
    problem = Problem(balances_of(nominal("lever"), as_recording(case)))
    spring = fit(problem, [effect("cable_spring", "swing", stiffness=0.1, rest=8.0)])
    offset = fit(problem, [effect("torque_offset", "swing", offset=0.5)])

    assert abs(spring.effects[0].values["rest"]) < 4.0 * math.pi
    assert offset.energy < spring.energy


@pytest.mark.parametrize(("name", "param"), [("torque_saturation", "limit"), ("spring_preload", "torque")])
def test_other_torques_have_no_such_prior(name: str, param: str) -> None:
    """A limit does nothing where it is large; an encoder offset, which equals a preload, has none."""
    planned = effect(name, "swing", **{param: 500.0})
    slot = Slot(0, planned.effect.params[0], 0)

    assert weak_prior(slot, [planned], USUAL.regression, 10.0) == (0.0, 0.0)
