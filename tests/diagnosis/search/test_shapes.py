"""Where the shape of a law is looked for, and what becomes of one that ran away from there."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.trials import sought_again
from flexjoint.effects import Signals, catalogue, effect

CREEP = Planted("spring_creep", "swing", {"stiffness": 10.0, "time_constant": 4.0})


@pytest.fixture(scope="module")
def creeping() -> Problem:
    return Problem(balances_of(nominal("lever"), as_recording(Case("lever", "rich", 5).with_causes(CREEP))))


def test_a_breakaway_is_looked_for_over_the_path_of_a_joint() -> None:
    """Fifty swings of 0.04 rad, 4 rad of path: what wears off over half of it is far beyond one swing."""
    t = np.linspace(0.0, 10.0, 5001)
    places = catalogue()["breakaway_friction"].starts(Signals(t=t, theta=0.02 * np.sin(10.0 * np.pi * t)))

    distances = [place["distance"] for place in places]
    assert min(distances) < 1e-3 and 1.0 < max(distances) < 4.0


def test_of_a_joint_at_rest_nothing_is_out_of_range() -> None:
    places = catalogue()["breakaway_friction"].starts(Signals(t=np.arange(5.0), theta=np.ones(5)))

    assert places == ({"distance": 1e-6},)  # the least that there is


def test_a_shape_that_ran_away_is_sought_again(creeping: Problem) -> None:
    away = fit(creeping, [effect("spring_creep", "swing", stiffness=10.0, time_constant=1e4)], iterations=0)
    lost = away.effects[0]

    with worker_pool([creeping.shared()], 1) as one:
        again = sought_again(away, lost, one)

    assert again.energy < away.energy - 100.0
    assert again.effects[0].values["time_constant"] == pytest.approx(4.0, rel=0.1)


def test_a_fit_finds_back_from_a_scale_at_its_bound(creeping: Problem) -> None:
    found = fit(creeping, [effect("spring_creep", "swing", stiffness=10.0, time_constant=1e4)])
    assert found.effects[0].values["time_constant"] == pytest.approx(4.0, rel=0.1)


def test_a_shape_where_it_was_looked_for_is_left_alone(creeping: Problem) -> None:
    there = fit(creeping, [effect("spring_creep", "swing", stiffness=10.0, time_constant=1.0)])

    with worker_pool([creeping.shared()], 1) as one:
        assert sought_again(there, there.effects[0], one) is there
