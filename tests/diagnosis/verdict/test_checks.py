"""The checks that refuse or replace a cause, and the one loop that asks them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.diagnose_cases import Case as Machine
from support.diagnose_cases import as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.result.wording import cause
from flexjoint.diagnosis.search import criteria
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.checks import EVERY, Check, Objection, cancelling, nested
from flexjoint.diagnosis.verdict.checks.cancelling import CancelsWithNumbers
from flexjoint.diagnosis.verdict.checks.nested import BesideItsSpecialCase
from flexjoint.diagnosis.verdict.checks.standing import FrictionAtRest
from flexjoint.diagnosis.verdict.checks.uncertain import UncertainSize
from flexjoint.diagnosis.verdict.review import notes, reviewed
from flexjoint.effects import Planned, effect

OFFSET = effect("torque_offset", "elbow", offset=1.0)
GAP = effect("backlash", "elbow", gap=1e-3)
LAG = effect("torque_delay", "elbow", delay=1e-3)


def holding(*effects: Planned) -> Any:
    """A selection, as far as the loop looks at it."""
    return SimpleNamespace(best=SimpleNamespace(effects=effects))


class Without(Check[Case]):
    """Objects to one effect, and knows what is to take its place."""

    name, stage, reason = "improbable", "findings", "For a test."

    def __init__(self, effect: Planned, instead: Planned | None = None, once: bool = False) -> None:
        self.effect, self.other, self.asked = effect, instead, 0
        self.once = once  # type: ignore[misc]

    def limit(self, settings: Settings) -> float:
        return settings.verdict.probable

    def objections(self, case: Case) -> tuple[Objection, ...]:
        self.asked += 1
        effects = case.selection.best.effects
        if self.effect not in effects:
            return ()
        left = [e for e in effects if e is not self.effect] + ([self.other] if self.other else [])
        return (Objection(self.effect, 0.05, "for a test", instead=holding(*left)),)


def test_every_check_says_what_it_is() -> None:
    assert len({check.name for check in EVERY}) == len(EVERY)
    for check in EVERY:
        assert check.reason.endswith(".") and check.reason[0].isupper(), check.name
        assert check.limit(USUAL) > 0.0, check.name


def test_no_friction_is_named_at_a_joint_that_never_moves() -> None:
    rubbing = [effect("motor_coulomb_friction", joint, level=1.0) for joint in ("shoulder", "elbow")]
    theta = np.stack([np.sin(np.arange(100.0)), np.full(100, 0.3)])
    readings = SimpleNamespace(theta=theta, q=np.full((2, 100), np.nan))
    problem = SimpleNamespace(readings=readings, robot=SimpleNamespace(joint_names=("shoulder", "elbow")))
    best = SimpleNamespace(effects=(*rubbing, OFFSET), problem=problem, settings=USUAL)
    case: Any = SimpleNamespace(selection=SimpleNamespace(best=best))
    (objection,) = FrictionAtRest().objections(case)
    assert objection.effect is rubbing[1] and "elbow never moves" in objection.why


@pytest.mark.parametrize(("adds", "objects"), [(0.05, True), (0.2, False)])
def test_a_law_beside_its_special_case_must_add_more_than_small_errors(
    adds: float, objects: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 10 N m 0.05 are left, of which noise makes 0.03: small errors may make 2.5 times the other 0.04."""
    laws = [
        effect("motor_coulomb_friction", "elbow", level=4.6),
        effect("dahl_friction", "elbow", level=1.0, scale=5e-4),
        effect("dahl_friction", "wrist", level=1.0, scale=5e-4),  # alone on its joint
    ]
    left = [Remaining(j, 10.0, 5.0, 0.05, 0.03, 0.0, "t") for j in ("elbow", "wrist")]
    monkeypatch.setattr(nested, "lowered", lambda _best, _others, _joint: adds)
    best = SimpleNamespace(effects=tuple(laws), settings=USUAL)
    case: Any = SimpleNamespace(selection=SimpleNamespace(best=best), remaining=left)

    found = [o.effect for o in BesideItsSpecialCase().objections(case)]
    assert found == ([laws[1]] if objects else [])


@pytest.mark.parametrize(
    ("probabilities", "times", "objected"),
    [
        ((0.001, 0.9), (4.6, 0.1), [0]),  # far worse with it, beside the numbers as they are
        ((0.001, 0.9), (1.2, 0.1), []),  # hardly worse: numbers may be off within their tolerances
        ((0.9, 0.001), (4.6, 0.1), []),  # it is likely all the same
        ((0.001, 0.002), (2.0, 4.6), [1]),  # the worst one first: without it the other may be right
    ],
)
def test_what_cancels_with_nominal_numbers_is_not_left_in_the_set(
    probabilities: tuple[float, float],
    times: tuple[float, float],
    objected: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A page would tell of a machine that its model explains worse after the diagnosis than before."""
    effects = (effect("asymmetric_friction", "elbow", level_positive=1.0, level_negative=2.0), OFFSET)
    monkeypatch.setattr(cancelling, "spoiling", lambda _data, k: times[k])
    named = [SimpleNamespace(planned=e, probability=p) for e, p in zip(effects, probabilities, strict=True)]
    best = SimpleNamespace(effects=effects, settings=USUAL)
    case: Any = SimpleNamespace(selection=SimpleNamespace(best=best), named=named, unseen=None)

    assert [effects.index(o.effect) for o in CancelsWithNumbers().objections(case)] == objected


def test_a_set_that_was_changed_is_asked_again_from_the_first_check_on() -> None:
    """The second check brings back what the first one objects to."""
    first, second = Without(OFFSET), Without(GAP, instead=OFFSET)
    case = reviewed(Case(holding(GAP, LAG), ()), (first, second))
    assert case.selection.best.effects == (LAG,)
    assert [(s.action, s.effect, s.by) for s in case.trace] == [
        ("replaced", "backlash", ("torque_offset", "elbow")),
        ("dropped", "torque_offset", None),
    ]
    assert (first.asked, second.asked) == (3, 2)


def test_a_check_that_is_done_once_is_not_asked_again() -> None:
    back_and_forth = (Without(GAP, instead=OFFSET, once=True), Without(OFFSET, instead=GAP, once=True))
    case = reviewed(Case(holding(GAP), ()), back_and_forth)
    assert case.selection.best.effects == (GAP,) and len(case.trace) == 2


def test_an_empty_set_is_asked_nothing() -> None:
    check = Without(GAP)
    reviewed(Case(holding(), ()), (check,))
    assert check.asked == 0


def test_notes_say_what_the_checks_did() -> None:
    case = reviewed(Case(holding(OFFSET, GAP), ()), (Without(OFFSET, instead=LAG), Without(GAP)))
    assert notes(case.trace) == (
        f"{cause(*LAG.key)} is reported instead of {cause(*OFFSET.key)}: for a test",
        f"{cause(*GAP.key)} is not reported: for a test",
    )


def test_a_problem_is_frozen() -> None:
    """Another noise level is another problem, and the first one is as it was."""
    problem = Problem(balances_of(nominal("lever"), as_recording(Machine("lever", "rich", 5).with_causes())))
    before = problem.gram.copy()
    other = problem.at(NoiseLevel(2.0 * problem.level.inflation))
    assert np.array_equal(problem.gram, before) and not np.array_equal(other.gram, before)
    for one in (problem, other, problem.only(problem.time > 1.0)):
        with pytest.raises(AttributeError, match="frozen"):
            one.level = other.level


def test_a_cause_of_more_numbers_must_be_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a ripple, amplitude, cycles and phase are chosen from very many: at five standard errors it is one
    of those that noise makes. A friction of one number is not."""
    machine = Machine("lever", "rich", 3)
    problem = Problem(balances_of(nominal("lever"), as_recording(machine.with_causes())))
    ripple = effect("cogging", "swing", amplitude=0.1, cycles=11.0, phase=0.3)
    rubbing = effect("motor_coulomb_friction", "swing", level=0.1)
    best = fit(problem, [ripple, rubbing], iterations=0)
    case: Any = SimpleNamespace(selection=SimpleNamespace(best=best))

    objected = []
    for sizes in (3.0, 5.0, 8.0):
        errors = [{"amplitude": [0.1 / sizes]}, {"level": [0.1 / sizes]}]
        monkeypatch.setattr(criteria, "standard_errors", lambda _best, errors=errors: errors)
        objected.append([o.effect.effect.name for o in UncertainSize().objections(case)])

    assert objected == [["cogging"], ["cogging"], []]
