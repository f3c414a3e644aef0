"""What is known of a number before any data: weakly, where the data say nothing of it."""

from __future__ import annotations

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


@pytest.mark.parametrize(("name", "param"), [("torque_saturation", "limit"), ("spring_preload", "torque")])
def test_other_torques_have_no_such_prior(name: str, param: str) -> None:
    """A limit does nothing where it is large; an encoder offset, which equals a preload, has none."""
    planned = effect(name, "swing", **{param: 500.0})
    slot = Slot(0, planned.effect.params[0], 0)

    assert weak_prior(slot, [planned], USUAL.regression, 10.0) == (0.0, 0.0)
