"""A law in the place of one that the robot file lists: one cause, measured against the listed law."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal, summary

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.known import planned_of
from flexjoint.diagnosis.result.values import to_json
from flexjoint.diagnosis.result.wording import parameters
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level, degenerate, makes_room
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Search, Selection, exchange, prune
from flexjoint.diagnosis.search.trials import added_to
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.verdict import cases as stages
from flexjoint.diagnosis.verdict import edits
from flexjoint.diagnosis.verdict.checks import Check, Objection
from flexjoint.diagnosis.verdict.checks.uncertain import UncertainSize
from flexjoint.diagnosis.verdict.instead import given_up_for, without
from flexjoint.diagnosis.verdict.review import reviewed
from flexjoint.effects import effect
from flexjoint.robot.robot import Robot

LEVEL, SCALE = 6.0, 0.05
COULOMB = effect("motor_coulomb_friction", "swing", level=LEVEL, nominal=True)


def claiming() -> Robot:
    return nominal("lever").extended([COULOMB])


@cache
def presliding() -> Diagnosis:
    case = Case("lever", "rich", 91)
    dahl = Planted("dahl_friction", "swing", {"level": LEVEL, "scale": SCALE})
    return diagnose(claiming(), as_recording(case.with_causes(dahl), case.name))


def test_presliding_friction_where_the_file_claims_coulomb_friction_is_one_cause() -> None:
    (found,) = (f for f in presliding().findings if f.probability > 0.5)
    assert found.effect == "dahl_friction", summary(presliding())
    assert found.parameters["level"].value == pytest.approx(LEVEL, rel=0.05)
    assert found.instead_of is not None and found.instead_of.effect == "motor_coulomb_friction"
    assert "in the place of motor Coulomb friction (6 → " in parameters(found)
    assert found.removed is not None  # against the claim, not against a joint without friction
    before = next(one.before for one in presliding().remaining if one.joint == "swing")
    assert found.removed.without == pytest.approx(before, rel=0.1)


def test_the_extended_model_and_the_json_hold_both() -> None:
    robot = claiming()
    extended = presliding().extend(robot)
    totals = {e.effect.name: e.values["level"] for e in extended.effects}
    assert totals["dahl_friction"] + totals["motor_coulomb_friction"] == pytest.approx(LEVEL, rel=0.05)
    entry = json.loads(json.dumps(to_json(presliding())))["findings"][0]
    read = {e.effect.name: e.values["level"] for e in planned_of(robot, entry)}
    assert read == pytest.approx(totals)


def test_what_makes_room_for_what() -> None:
    dahl = effect("dahl_friction", "swing", level=5.0, scale=SCALE)
    less, more = (replace(COULOMB, values={"level": level}, nominal=False) for level in (1.0, 7.0))
    elsewhere = replace(less, joint="other")
    assert given_up_for(dahl, [dahl, less], [COULOMB]) is less
    assert given_up_for(dahl, [dahl, more], [COULOMB]) is None  # more friction is a cause of its own
    assert given_up_for(dahl, [dahl, less], []) is None  # nothing was claimed
    assert given_up_for(dahl, [dahl, elsewhere], [COULOMB]) is None
    assert given_up_for(less, [dahl, less], [COULOMB]) is None
    for one in (dahl, less):
        assert without(one, [dahl, less, elsewhere], [COULOMB]) == [elsewhere]
    assert without(more, [dahl, more], [COULOMB]) == [dahl]
    stribeck = effect("stribeck_friction", "swing", level=0.0, static_extra=1.0, velocity=0.1)
    both = [dahl, less, stribeck]
    assert without(dahl, both, [COULOMB]) == [stribeck]  # which has no such friction of its own
    assert without(stribeck, both, [COULOMB]) == [dahl, less]
    assert without(less, both, [COULOMB]) == [stribeck]


def test_what_makes_room_stays_as_long_as_the_law_does() -> None:
    """Beside the claim the law is another one: twice the friction, of which a tolerance hides half."""
    case = Case("lever", "rich", 91)
    dahl = Planted("dahl_friction", "swing", {"level": LEVEL, "scale": SCALE})
    problem = Problem(balances_of(claiming(), as_recording(case.with_causes(dahl), case.name)))
    gone = replace(COULOMB, values={"level": 0.0}, nominal=False)
    law = effect("dahl_friction", "swing", level=LEVEL, scale=SCALE)
    nothing = at_own_level(fit(problem, []))
    best = at_own_level(fit(nothing.problem, [gone, law]))
    assert [makes_room(e, best) for e in best.effects] == [True, False]
    with worker_pool([], 1) as pool:
        search = Search(Scanner(enumerate_candidates(problem)), pool)

        left = prune(best, pool)
        found, rivals = exchange(search, best, best.effects)

    assert left is best
    assert found is best
    assert not rivals[0]
    case_of = stages.Case(Selection(best, nothing, (), (), rivals), ())
    assert not any(one.effect.key == gone.key for one in UncertainSize().objections(case_of))


def test_a_claim_and_an_effect_of_its_numbers_are_two_things() -> None:
    """Whose place is taken is no longer a number that may be off."""
    recording = as_recording(Case("lever", "rich", 94).with_causes(), "healthy")
    problem = Problem(balances_of(claiming(), recording)).about([])
    (k,) = (k for k, number in enumerate(problem.nuisance) if number.of)
    assert np.any(problem.J[k])
    assert not np.any(problem.about([replace(COULOMB, nominal=False)]).J[k])


class NoDahl(Check[stages.Case]):
    name, stage, reason = "no Dahl", "balances", "It is not wanted."

    def limit(self, settings: Settings) -> float:
        return 0.0

    def objections(self, case: stages.Case) -> tuple[Objection, ...]:
        found = [e for e in case.selection.best.effects if e.effect.name == "dahl_friction"]
        return tuple(Objection(e, 1.0, "it is not wanted") for e in found)


@pytest.mark.parametrize("certain", [1.7, 9.0])
def test_what_made_room_for_a_law_goes_with_it_unless_it_is_off_by_itself(
    certain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A check takes out the law; how many standard errors the claim is off by then is given."""
    level = 0.5 * LEVEL
    case, really = Case("lever", "rich", 93), Planted("motor_coulomb_friction", "swing", {"level": level})
    problem = Problem(balances_of(claiming(), as_recording(case.with_causes(really), case.name)))
    gone = replace(COULOMB, values={"level": 0.0}, nominal=False)
    law = effect("dahl_friction", "swing", level=level, scale=1e-3)
    nothing = at_own_level(fit(problem, []))
    best = at_own_level(fit(nothing.problem, [gone, law]))
    monkeypatch.setattr(edits, "known_sizes", lambda *_: (np.array([certain]), np.array([4.0])))
    left = reviewed(stages.Case(Selection(best, nothing, (), (), ((), ())), ()), (NoDahl(),))
    told = [(step.effect, step.check) for step in left.trace]
    if certain < 4.0:
        assert not left.selection.best.effects
        assert told == [("dahl_friction", "no Dahl"), ("motor_coulomb_friction", "makes room")]
    else:
        (off,) = left.selection.best.effects
        assert off.key == COULOMB.key and off.values["level"] == pytest.approx(level, rel=0.02)
        assert told == [("dahl_friction", "no Dahl")]


def test_a_law_that_gives_way_is_tried_in_the_place_of_the_listed_one() -> None:
    """Beside a claimed Coulomb friction as it is, little of the law would be seen."""
    case = Case("lever", "rich", 92)
    dahl = Planted("dahl_friction", "swing", {"level": LEVEL, "scale": 0.01})
    problem = Problem(balances_of(claiming(), as_recording(case.with_causes(dahl), case.name), USUAL))
    bare = at_own_level(fit(problem, []))
    candidates = [c for c in enumerate_candidates(problem) if c.effect.name == "dahl_friction"]
    (scored,) = Scanner(candidates).scan(bare)
    added = added_to(bare, scored)
    assert added is not None
    levels = {e.effect.name: e.values["level"] for e in added.effects}
    assert set(levels) == {"motor_coulomb_friction", "dahl_friction"}
    assert added.effects[-1].effect.name == "dahl_friction"  # the cause that was tried
    assert levels["dahl_friction"] == pytest.approx(LEVEL, rel=0.05)
    assert levels["motor_coulomb_friction"] < 0.05 * LEVEL


def test_a_listed_friction_that_is_gone_is_a_change_and_one_as_listed_is_none() -> None:
    problem = Problem(
        balances_of(claiming(), as_recording(Case("lever", "rich", 92).with_causes(), "x"), USUAL)
    )
    gone, same = (replace(COULOMB, values={"level": level}, nominal=False) for level in (0.0, LEVEL))
    assert not degenerate(problem, gone) and degenerate(problem, same)
