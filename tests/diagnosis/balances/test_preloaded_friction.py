"""Dry friction that is small beside the torque that its joint carries."""

from __future__ import annotations

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import effect


@pytest.mark.parametrize(("joint", "level"), [("elbow", 1.0), ("shoulder", 3.0)])
def test_a_stiffness_off_within_its_tolerance_does_not_hide_what_friction_holds(
    joint: str, level: float
) -> None:
    """The spring carries a preload by gravity, of which the nominal stiffness makes an error as large as the
    friction: what pulls at the motor is told by the torque sensor."""
    planted = Planted("motor_coulomb_friction", joint, {"level": level})
    recording = as_recording(Case("crane", "slow", 31, inexact=0.05).with_causes(planted))
    problem = Problem(balances_of(nominal("crane"), recording))

    energy = problem.energy(problem.residual([effect("motor_coulomb_friction", joint, level=level)]))

    assert energy < 1.5 * problem.noise_energy  # without the sensor 7 and 54
