"""A search that runs out of time takes the set as it is, and says what it left out."""

from __future__ import annotations

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.core.running.budget import UNLIMITED, Budget
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
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


@pytest.mark.parametrize("allowed", [5, 60])
def test_a_diagnosis_ends_at_the_first_question_after_its_time(allowed: int) -> None:
    """Its clock goes on by a second whenever it is asked: within a fit, a scan and a simulation, too. When
    the time is over each stage asks once or twice, and nothing begins a long step."""
    asked = [0]

    def clock() -> float:
        asked[0] += 1
        return float(asked[0])

    joint = nominal("crane").joint_names[1]
    friction = Planted("motor_coulomb_friction", joint, {"level": 0.8})
    recording = as_recording(Case("crane", "rich", 3).with_causes(friction))

    diagnosis = diagnose(nominal("crane"), recording, workers=1, budget=Budget(allowed, clock))

    assert asked[0] <= allowed + 15
    assert diagnosis.verdict == "unexplained" and not diagnosis.findings
    assert diagnosis.reason.endswith("the time allowed was over before a cause was found")
    assert diagnosis.not_excited == ()  # nothing was looked at to its end
    said = " ".join(diagnosis.notes)
    for what in ("during the search", "looked at by itself", "robust search", "held-out data"):
        assert what in said
