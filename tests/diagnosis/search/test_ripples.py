"""Where the search for a periodic law starts: cycles of what is left of a joint's balances."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planting import FULL, Planted, plant, robot_file
from support.diagnose_cases import as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.ripples import ripples
from flexjoint.diagnosis.search.scan import Scanner

JOINT = "elbow"
# the motor's encoder is so much the worse that the deflection shows nothing of what the link's does
SENSORS = replace(
    FULL, noise={"theta": 5e-3, "q": 2e-5, "dtheta": 0.05, "dq": 2e-3, "tau_t": 0.05}, resolution=0.0
)


def problem(*planted: Planted) -> Problem:
    made = plant(robot_file("crane"), list(planted), "rich", 12.0, 7, SENSORS, rate=500.0)
    return Problem(balances_of(nominal("crane"), as_recording(made)))


@pytest.mark.parametrize("cycles", [17.0, 40.0])
def test_a_ripple_of_an_encoder_beside_a_noisy_one_is_found(cycles: float) -> None:
    values = {"amplitude": 3e-4, "cycles": cycles, "phase": 0.8, "channel": "q"}
    case = problem(Planted("encoder_ripple", JOINT, values))
    best = Scanner(enumerate_candidates(case, frozenset())).scan(fit(case, []))[0]
    assert best.candidate.key == ("encoder_ripple", JOINT)
    found = fit(case, [best.planned()]).effects[0].values
    assert found["channel"] == "q"
    assert found["cycles"] == pytest.approx(cycles, abs=0.5)


def test_a_rhythm_in_time_is_found_in_turns() -> None:
    values = {"amplitude": 0.3, "frequency": 3.7, "phase": 0.2}
    case = problem(Planted("periodic_disturbance", JOINT, values))
    found = ripples(case, JOINT, "t", [])
    assert min(abs(omega - 2.0 * 3.14159 * 3.7) for omega in found) < 0.5  # rad/s


def test_they_follow_from_the_effects_beside_them_alone() -> None:
    case = problem(Planted("cogging", JOINT, {"amplitude": 0.4, "cycles": 21.0, "phase": 0.1}))
    raised = case.at(case.plausible_level(case.residual([])))
    assert ripples(case, JOINT, "theta", []) == ripples(raised, JOINT, "theta", [])
