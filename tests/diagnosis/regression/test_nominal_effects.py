"""Effects that the robot file claims, whose numbers are known to a tolerance only."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import effect

LEVEL, CLAIMED = 1.0, 0.7  # N m
RUBS = Planted("motor_coulomb_friction", "swing", {"level": LEVEL})


@pytest.fixture(scope="module")
def problem() -> Problem:
    robot = nominal("lever").extended(
        [effect("motor_coulomb_friction", "swing", level=CLAIMED, nominal=True)]
    )
    recorded = as_recording(Case("lever", "rich", 4, inexact=0.02).with_causes(RUBS))
    return Problem(balances_of(robot, recorded))


def number(problem: Problem) -> int:
    return next(k for k, n in enumerate(problem.nuisance) if n.of == "level")


def test_a_claimed_number_within_its_tolerance_takes_the_place_of_the_claim(problem: Problem) -> None:
    """What is left is counted beside the likely numbers, those of claimed effects among them."""
    y = problem.residual([])
    likely = deviation_effects(problem, converged_deviations(problem, [], y))
    (friction,) = (e for e in likely if e.key == (RUBS.effect, RUBS.joint))

    assert friction.values["level"] == pytest.approx(LEVEL, rel=0.03)
    left = problem.residual(likely)
    assert left @ left < 0.05 * (y @ y)


def test_the_number_of_an_effect_in_the_place_of_a_claim_is_its_own(problem: Problem) -> None:
    """The claim is no longer at work, and its tolerance takes nothing of what the effect explains."""
    started = effect("motor_coulomb_friction", "swing", level=CLAIMED)
    fitted = fit(problem, [started])

    assert fitted.effects[0].values["level"] == pytest.approx(LEVEL, rel=0.01)
    assert fitted.problem.deviations(fitted.y)[number(problem)] == 0.0
    assert np.all(fitted.problem.J[number(problem)] == 0.0)
