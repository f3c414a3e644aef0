"""A joint searched by itself, where what another one leaves hides its causes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import exhaustive, thorough

from flexjoint.core.running.budget import Budget
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.joints.by_itself import Question, clears, joint_by_joint
from flexjoint.diagnosis.verdict.joints.search import JOINT_SEARCH
from flexjoint.diagnosis.verdict.unseen.torques import unseen_problem
from flexjoint.effects import Planned, effect

BASE, OTHER = nominal("crane").joint_names[:2]
UNKNOWN = Planted("cable_spring", BASE, {"stiffness": 25.0, "rest": 0.4})  # struck from the candidates
HIDDEN = Planted("load_friction", OTHER, {"coefficient": 0.25})
LEFT = Remaining("elbow", torque=10.0, before=4.0, after=3.0, noise=0.01, structured=1.0, against="q")


def found_nothing(*causes: Planted) -> tuple[Selection, list[Candidate]]:
    """A planted machine of which a search named nothing, at the noise level that this leaves."""
    case = Case("crane", "rich", 29)
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.with_causes(*causes))))
    nothing = at_own_level(fit(problem, []))
    candidates = [c for c in enumerate_candidates(problem) if c.effect.name != "cable_spring"]
    return Selection(nothing, nothing, (), (), ()), candidates


def completed(selection: Selection, candidates: list[Candidate], workers: int = 1) -> Selection:
    return joint_by_joint(selection, candidates, JOINT_SEARCH, workers, Budget(), lambda _share, _what: None)


@pytest.fixture(scope="module")
def hidden() -> tuple[Selection, list[Candidate]]:
    return found_nothing(UNKNOWN, HIDDEN)


@thorough
def test_a_cause_beside_a_large_unknown_is_found(hidden: tuple[Selection, list[Candidate]]) -> None:
    after = completed(*hidden)

    (found,) = [e for e in after.best.effects if e.joint == OTHER]
    assert found.effect.name == "load_friction"
    assert found.values["coefficient"] == pytest.approx(0.25, rel=0.1)
    (step,) = [step for step in after.trace if step.joint == OTHER]
    assert (step.stage, step.action, step.check) == ("joint by joint", "added", "background")
    assert len(after.rivals) == len(after.best.effects)


@exhaustive
def test_two_processes_find_the_same_bits(hidden: tuple[Selection, list[Candidate]]) -> None:
    selection, candidates = hidden
    one, two = (completed(replace(selection), candidates, workers) for workers in (1, 2))

    assert [e.identity for e in one.best.effects] == [e.identity for e in two.best.effects]


def test_nothing_is_found_on_a_healthy_machine() -> None:
    selection, candidates = found_nothing()

    assert completed(selection, candidates) is selection


def test_another_joint_and_its_causes_are_not_touched() -> None:
    """A problem of one joint counts its balances only, beside the causes of others as they are."""
    selection, _ = found_nothing(UNKNOWN, HIDDEN)
    problem = selection.best.problem
    spring = effect("cable_spring", BASE, stiffness=25.0, rest=0.4)

    alone = problem.of_joint(OTHER, [spring])

    at = problem.robot.joint_names.index(OTHER)
    own = [row.joint == at for row in problem.balances.rows]
    assert alone.counted.tolist() == own
    weights = alone.weights.reshape(len(own), -1)
    assert [bool(row.any()) for row in weights] == own
    assert spring in alone.nominal
    named = at_own_level(fit(alone, [effect("load_friction", OTHER, coefficient=0.1)]))
    assert named.effects[0].values["coefficient"] == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize(
    ("before", "after", "clear"),
    [
        ((3.0, 2.0, 2.0), (0.5, 2.0, 2.0), True),  # its torque
        ((3.0, 2.0, 2.0), (3.0, 0.2, 2.0), True),  # one balance
        ((3.0, 2.0, 2.0), (2.95, 2.0, 2.0), False),  # less than a background
        ((3.0, 2.0, 2.0), (0.5, 2.5, 2.0), False),  # another one is worse
    ],
)
def test_what_clears_a_joint(before: tuple[float, ...], after: tuple[float, ...], clear: bool) -> None:
    assert clears(LEFT, before, after, USUAL) is clear


def test_half_the_torque_beside_numbers_that_are_all_off_is_refused() -> None:
    """Nominal numbers that a fit has moved do not reach the extended model."""
    selection, candidates = found_nothing()
    best = selection.best
    left = replace(LEFT, joint=OTHER)
    question = Question(best, unseen_problem(best.problem), tuple(candidates), left)
    weak: list[Planned] = [effect("torque_gain", OTHER, gain=-0.5)]
    measured = question.measured([])

    imagined = replace(measured, effects=tuple(weak), left=0.0, balances=(0.0,) * len(measured.balances))

    assert not question.clears(imagined)


class SearchedError(Exception):
    pass


def _searched(*_args: object, **_options: object) -> Selection:
    raise SearchedError


@pytest.mark.parametrize(("share", "searched"), [(0.3, False), (0.0, True)])
def test_a_push_on_the_link_is_no_cause_of_its_joint(
    monkeypatch: pytest.MonkeyPatch, share: float, searched: bool
) -> None:
    """What is left is then told as a push; a law of the joint could only imitate it."""
    push = Planted("pushes", OTHER, {"torque": share * 6.32, "times": (4.0,), "length": 1.0})
    friction = Planted("load_friction", OTHER, {"coefficient": 0.1})
    selection, candidates = found_nothing(push if share else friction)
    best = selection.best
    own = tuple(c for c in candidates if c.joint == OTHER)
    question = Question(best, unseen_problem(best.problem), own, replace(LEFT, joint=OTHER))
    monkeypatch.setattr("flexjoint.diagnosis.verdict.joints.search.select", _searched)

    if searched:
        with pytest.raises(SearchedError):
            JOINT_SEARCH.find(question)
    else:
        assert JOINT_SEARCH.find(question) is None
