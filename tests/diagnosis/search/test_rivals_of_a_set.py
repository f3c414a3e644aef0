"""Rivals of the causes of a set that changes: fitted beside what it has become, once they are looked at."""

from __future__ import annotations

from functools import cache

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level, score
from flexjoint.diagnosis.search.rivals import Rivals
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.edits import given_way, without
from flexjoint.effects import Planned, effect

COULOMB = effect("motor_coulomb_friction", "shoulder", level=5.0)
VISCOUS = effect("motor_viscous_friction", "shoulder", coefficient=1.0)
LINK = effect("link_coulomb_friction", "shoulder", level=5.0)
OFFSET = effect("torque_offset", "shoulder", offset=0.5)
ELBOW = effect("motor_coulomb_friction", "elbow", level=4.0)


@cache
def problem() -> Problem:
    case = Case("crane", "rich", 77)
    causes = [Planted(e.effect.name, str(e.joint), dict(e.values)) for e in (COULOMB, VISCOUS, ELBOW)]
    robot = nominal("crane")
    recording = as_recording(case.with_causes(*causes), case.name)
    return Problem(balances_of(robot, recording, USUAL))


@cache
def selection() -> Selection:
    """Three causes; the first of them has two rivals, and the third one."""
    nothing = at_own_level(fit(problem(), []))
    best = at_own_level(fit(nothing.problem, [COULOMB, VISCOUS, ELBOW]))
    _, viscous, elbow = best.effects
    first = tuple(fit(best.problem, [viscous, elbow, one]) for one in (LINK, OFFSET))
    third = (fit(best.problem, [*best.effects[:2], effect("link_coulomb_friction", "elbow", level=4.0)]),)
    return Selection(best, nothing, (), (), (first, (), third))


def looked_at(rivals: object) -> bool:
    return "fits" in vars(rivals)


def test_no_rival_is_fitted_while_the_set_changes() -> None:
    _, viscous, elbow = selection().best.effects

    left = without(without(selection(), viscous), elbow)

    assert [len(rivals) for rivals in left.rivals] == [2]
    assert not any(map(looked_at, left.rivals))


def test_a_rival_stands_beside_what_the_set_has_become() -> None:
    _, viscous, elbow = selection().best.effects

    left = without(selection(), elbow)

    assert {e.key for e in left.best.effects} == {COULOMB.key, viscous.key}
    for rival, added in zip(
        sorted(left.rivals[0], key=lambda f: f.effects[-1].key), (LINK, OFFSET), strict=True
    ):
        assert rival.effects[-1].key == added.key
        assert {e.key for e in rival.effects} == {viscous.key, added.key}
        # as good as with every number fitted anew
        anew = fit(left.best.problem, rival.effects)
        assert rival.energy <= anew.energy + 1e-3 * abs(anew.energy) + 1.0


def test_the_best_rival_comes_first() -> None:
    rivals = without(selection(), selection().best.effects[2]).rivals[0]

    assert [score(f) for f in rivals] == sorted(score(f) for f in rivals)
    assert rivals[:1] == tuple(rivals)[:1]


def test_what_other_joints_have_is_not_fitted_again() -> None:
    coulomb, viscous, elbow = selection().best.effects

    left = without(selection(), viscous)
    (rival,) = left.rivals[1]

    held = next(e for e in left.best.effects if e.key == coulomb.key)
    assert next(e for e in rival.effects if e.key == coulomb.key).values == held.values
    assert rival.effects[-1].joint == elbow.joint


def test_a_rival_that_takes_a_place_is_no_rival_any_more() -> None:
    link = selection().rivals[0][0]

    named = given_way(selection(), 0, link, at_own_level(link))

    assert [e.key for e in named.best.effects][-1] == LINK.key
    assert [f.effects[-1].key for f in named.rivals[-1]] == [OFFSET.key]
    for rivals in named.rivals:
        assert LINK.key not in {f.effects[-1].key for f in rivals}


@pytest.mark.parametrize("lost", [VISCOUS, ELBOW], ids=["of its joint", "of another joint"])
def test_what_a_rival_makes_unnecessary_stays_away(lost: Planned) -> None:
    """A wider law in the place of one of two causes of its joint, both of which it contains."""
    best = selection().best
    wide = effect("stribeck_friction", "shoulder", static_extra=1.0, velocity=0.3)
    rivals = Rivals.of(best, COULOMB.key, [[best.effects[2], wide]])  # without viscous friction
    gone = next(e for e in best.effects if e.key == lost.key)
    left = fit(best.problem, [e for e in best.effects if e is not gone])

    (found,) = rivals.beside(left)

    assert VISCOUS.key not in {e.key for e in found.effects}
    assert (ELBOW.key in {e.key for e in found.effects}) == (lost is not ELBOW)
