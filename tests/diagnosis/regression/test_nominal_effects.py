"""Effects that the robot file claims, whose numbers are known to a tolerance only."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import (
    converged_deviations,
    deviation_effects,
    every_deviation,
)
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import effect

TRUE, CLAIMED = 1.0, 0.7  # N m
RUBS = Planted("motor_coulomb_friction", "swing", {"level": TRUE})
PULLS = Planted("torque_offset", "swing", {"offset": TRUE})


def problem(cause: Planted, inexact: float = 0.02, **claimed: float) -> Problem:
    """A recording of a cause that the robot file claims with another number, and of a machine that is off by
    a share of its nominal numbers."""
    robot = nominal("lever").extended([effect(cause.effect, "swing", nominal=True, **claimed)])
    recorded = as_recording(Case("lever", "rich", 4, inexact=inexact).with_causes(cause))
    return Problem(balances_of(robot, recorded))


@pytest.fixture(scope="module")
def rubs() -> Problem:
    return problem(RUBS, level=CLAIMED)


def number(problem: Problem) -> int:
    return next(k for k, n in enumerate(problem.nuisance) if n.of == "level")


def test_a_claimed_number_within_its_tolerance_takes_the_place_of_the_claim() -> None:
    """What is left is counted beside the likely numbers, those of claimed effects among them."""
    pulls = problem(PULLS, offset=CLAIMED)
    y = pulls.residual([])
    likely = deviation_effects(pulls, converged_deviations(pulls, [], y))
    (offset,) = (e for e in likely if e.key == (PULLS.effect, PULLS.joint))

    assert offset.values["offset"] == pytest.approx(TRUE, rel=0.03)
    left = pulls.residual(likely)
    assert left @ left < 0.05 * (y @ y)


def test_ordinary_friction_that_is_claimed_counts_as_it_is_claimed(rubs: Problem) -> None:
    """Where it is off by more than a background it is named, whatever its tolerance: what is left says so."""
    y = rubs.residual([])
    deviations = converged_deviations(rubs, [], y)
    assert abs(deviations[number(rubs)]) > 0.5  # so far within its tolerance
    assert any(e.key == (RUBS.effect, RUBS.joint) for e in every_deviation(rubs, deviations))
    likely = deviation_effects(rubs, deviations)

    assert not any(e.key == (RUBS.effect, RUBS.joint) for e in likely)
    right = effect("motor_coulomb_friction", "swing", level=TRUE)
    left, best = rubs.residual(likely), rubs.residual([*likely, right])
    assert best @ best < 0.1 * (left @ left)


# what a law changes decides on which recording it is evaluated, as it is or denoised: a level of friction
# changes torques only, but a drive's numbers, a gain, and a law of the deflection also how noise enters
OTHERWISE = [
    ("motor_coulomb_friction", "level", TRUE, CLAIMED),
    ("motor_viscous_friction", "coefficient", 3.0, 1.0),
    ("motor_inertia", "scale", 0.6, 0.2),
    ("torque_gain", "gain", 0.3, 0.1),
    ("hardening_spring", "cubic", 2e7, 8e6),
]


@pytest.mark.parametrize(("name", "parameter", "true", "claimed"), OTHERWISE, ids=[o[0] for o in OTHERWISE])
def test_the_number_of_an_effect_in_the_place_of_a_claim_is_its_own(
    name: str, parameter: str, true: float, claimed: float
) -> None:
    """The claim is no longer at work, and its tolerance takes nothing of what the effect explains."""
    planted = Planted(name, "swing", {parameter: true})
    claims = problem(planted, inexact=0.0, **{parameter: claimed})
    fitted = fit(claims, [effect(name, "swing", **{parameter: claimed})])
    at = next(k for k, n in enumerate(claims.nuisance) if n.of == parameter)

    assert fitted.effects[0].values[parameter] == pytest.approx(true, rel=0.03)
    right = problem(planted, inexact=0.0, **{parameter: true})
    assert fitted.energy < 1.1 * fit(right, []).energy
    assert fitted.problem.deviations(fitted.y)[at] == pytest.approx(0.0, abs=1e-6)
    assert np.all(fitted.problem.J[at] == 0.0)
