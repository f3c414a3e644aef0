"""What comes and goes: the spans that gain most, and the times of a load that is picked and placed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import score
from flexjoint.diagnosis.search.dating import _spans, switched
from flexjoint.effects import effect

PRICE = 3.0


@pytest.mark.parametrize("seed", range(20))
def test_no_other_spans_gain_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gains = np.repeat(rng.normal(0.0, 1.0, 4), 3) + rng.normal(0.0, 0.5, 12)
    shortest = 2

    def gain(on: np.ndarray) -> float:
        return float(np.sum(gains[on]) - PRICE * np.sum(on[1:] != on[:-1]))

    def spans(on: np.ndarray) -> list[int]:
        edges = np.flatnonzero(on[1:] != on[:-1]) + 1
        return np.diff([0, *edges, len(on)]).tolist()

    every = [np.array(on) for on in itertools.product([False, True], repeat=len(gains))]
    best = max(gain(on) for on in every if min(spans(on)) >= shortest)
    found = _spans(gains, PRICE, shortest)
    assert min(spans(found)) >= shortest and gain(found) == pytest.approx(best)


def test_a_load_that_is_picked_and_placed_is_dated_by_its_own_fit() -> None:
    """From a load that was taken to be there all the time, of half its mass."""
    load = Planted("payload", "swing", {"mass": 2.0, "position": [0.0, 0.0, -0.4]}, 3.0, (5.0, 8.0))
    case = Case("lever", "rich", 74)
    problem = Problem(balances_of(nominal("lever"), as_recording(case.with_causes(load), case.name)))
    begun = fit(problem, [effect("payload", "swing", mass=1.0, position=(0.0, 0.0, -0.3))])
    found = switched(begun)

    assert found.effects[0].changes == pytest.approx((3.0, 5.0, 8.0), abs=0.05)
    assert found.effects[0].values["mass"] == pytest.approx(2.0, rel=0.05)
    assert score(found) < score(begun)
    assert switched(found).effects[0].identity == found.effects[0].identity


def test_what_stays_on_a_joint_is_not_switched() -> None:
    """A friction does not come and go, however much that would gain."""
    case = Case("turret", "rich", 3)
    late = Planted("motor_coulomb_friction", "turn", {"level": 0.4}, since=5.9)
    problem = Problem(balances_of(nominal("turret"), as_recording(case.with_causes(late))))
    begun = fit(problem, [effect("motor_coulomb_friction", "turn", level=0.2)])
    assert switched(begun) is begun
