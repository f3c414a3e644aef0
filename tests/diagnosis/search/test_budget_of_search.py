"""A search that runs out of time takes the set as it is, and says what it left out."""

from __future__ import annotations

from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.core.running.budget import UNLIMITED, Budget
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.selection import LEFT_OUT, select


def test_a_search_ends_when_its_time_is_over() -> None:
    friction = Planted("motor_coulomb_friction", "turn", {"level": 0.4})
    recording = as_recording(Case("turret_exact", "rich", 3).with_causes(friction))
    problem = Problem(balances_of(nominal("turret_exact"), recording))
    candidates = [c for c in enumerate_candidates(problem) if c.effect.name.endswith("friction")]

    none = select(
        problem, candidates, lambda _share, _what: None, budget=Budget(1.0, iter([0.0, *[2.0] * 99]).__next__)
    )
    every = select(problem, candidates, lambda _share, _what: None, budget=UNLIMITED)

    assert none.best.effects == () and none.left_out == (LEFT_OUT,)
    assert [e.effect.name for e in every.best.effects] == ["motor_coulomb_friction"] and every.left_out == ()
