"""Laws that are not linear in the deflection, beside encoders as noisy as a large part of it."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import effect
from flexjoint.recording import table

STIFFER = Planted("hardening_spring", "swing", {"cubic": 2.1e7})  # 1.6 times as stiff where it bends most
PLAY = Planted("backlash", "swing", {"gap": 0.009})
# law, motion, noise of both encoders [rad], and the most energy a degree of freedom that it may leave: noise
# has 1, and the spring's noise where it is stiffer, or within the gap, is taken for that of the nominal one.
# With laws evaluated on the noisy deflection it was 21, 144 and 1.75.
CASES = [(STIFFER, "slow", 4e-4, 1.5), (STIFFER, "slow", 1e-3, 1.5), (PLAY, "rich", 1e-4, 1.5)]


def seen_by(noise: float, planted: Planted, excitation: str) -> Problem:
    recorded = as_recording(Case("lever", excitation, 3).with_causes(planted))
    columns, rng = dict(recorded.columns), np.random.default_rng(1)
    for channel in ("q", "theta"):
        angle = columns[channel, "swing"]
        columns[channel, "swing"] = angle + noise * rng.standard_normal(angle.size)
        del columns[f"d{channel}", "swing"]
    return Problem(balances_of(nominal("lever"), table.make(recorded.time, columns, "noisy")))


@pytest.mark.parametrize(("planted", "excitation", "noise", "most"), CASES)
def test_a_true_law_leaves_noise_and_no_more(
    planted: Planted, excitation: str, noise: float, most: float
) -> None:
    problem = seen_by(noise, planted, excitation)
    true = effect(planted.effect, planted.joint, **planted.parameters)
    assert problem.energy(problem.residual([true])) < most * problem.freedom


def test_a_fit_is_judged_as_it_is_fitted() -> None:
    """Nominal numbers far off are evaluated in full, where a law would see the noise again."""
    problem = seen_by(4e-4, STIFFER, "slow")
    found = fit(problem, [effect("hardening_spring", "swing", cubic=2.1e7)])
    assert found.energy < 1.5 * problem.freedom
