"""The views in which what is left of a joint is measured: numbers corrected or not, along links or motors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.verdict.unseen.torques import (
    View,
    away,
    in_views,
    remaining,
    removed,
    spoils,
    uncorrected,
    unseen,
)
from flexjoint.effects import Planned, effect
from flexjoint.recording.table import Recording

COULOMB = Planted("motor_coulomb_friction", "shoulder", {"level": 15.0})
FOUND = effect("motor_coulomb_friction", "shoulder", level=15.0)


def recorded(*causes: Planted) -> Recording:
    return as_recording(Case("crane", "rich", 23).with_causes(*causes))


def vibrating(recording: Recording) -> Recording:
    """The shoulder's link encoder reads 3 mrad of a vibration that is not there."""
    off = 3e-3 * np.sin(2.0 * np.pi * 12.0 * recording.time)
    key = ("q", "shoulder")
    return replace(recording, columns={**recording.columns, key: recording.columns[key] + off})


def problem_of(recording: Recording) -> Problem:
    return Problem(balances_of(nominal("crane"), recording))


def as_they_are(problem: Problem, *effects: Planned) -> View:
    """Effects beside the nominal numbers, none of them fitted."""
    left = uncorrected(problem, effects)
    without = tuple(uncorrected(problem, [e for e in effects if e is not one]) for one in effects)
    return View(problem, away(problem), uncorrected(problem, []), left, without)


def test_what_a_link_encoder_is_off_by_is_no_torque_that_is_left() -> None:
    problem = problem_of(vibrating(recorded(COULOMB)))
    along_links = as_they_are(problem, FOUND)

    found = in_views(along_links, [FOUND])

    (left,) = [one for one in remaining(found) if one.joint == "shoulder"]
    assert len(found.views) == 3
    assert found.of_joint["shoulder"] is found.views[-1]
    assert left.after < 0.3 * along_links.left("shoulder")
    assert left.before > 14.0


def test_friction_is_measured_along_the_motor_where_the_link_encoder_is_off() -> None:
    problem = problem_of(vibrating(recorded(COULOMB)))

    one = removed(in_views(as_they_are(problem, FOUND), [FOUND]), 0)

    assert (one.joint, one.balance) == ("shoulder", "motor")
    size = np.sqrt(one.without**2 - one.left**2)
    assert size == pytest.approx(15.0, rel=0.1)  # of sliding almost all the time


def test_a_spring_is_never_measured_along_the_motor() -> None:
    """There the link follows through the model's own spring."""
    problem = problem_of(vibrating(recorded()))
    softer = effect("spring_stiffness", "shoulder", scale=0.5)
    seen = in_views(as_they_are(problem, softer), [softer])

    assert seen.of_cause(0, "shoulder") in seen.views[:2]


def test_a_joint_whose_encoders_agree_has_no_view_along_its_motor() -> None:
    problem = problem_of(recorded(COULOMB))

    assert len(in_views(as_they_are(problem, FOUND), [FOUND]).views) == 2


def test_numbers_are_corrected_only_where_that_leaves_less() -> None:
    """A healthy machine's deviations are within tolerance; a wild correction is left out."""
    problem = problem_of(recorded(COULOMB))
    wild = replace(as_they_are(problem, FOUND), after=uncorrected(problem, [FOUND]) * 5.0)

    seen = in_views(wild, [FOUND])

    assert all(view is seen.views[1] for view in seen.of_joint.values())


def test_half_the_torque_spoils_a_model_and_a_friction_that_is_there_does_not() -> None:
    problem = problem_of(recorded(COULOMB))
    weak = effect("torque_gain", "shoulder", gain=-0.5)

    assert spoils(in_views(as_they_are(problem, weak), [weak]), 0)
    assert not spoils(in_views(as_they_are(problem, FOUND), [FOUND]), 0)


def test_a_fitted_set_is_seen_in_all_views() -> None:
    problem = problem_of(recorded(COULOMB))
    best, nothing = (at_own_level(fit(problem, some)) for some in ([FOUND], []))

    found = unseen(best, nothing)

    assert [len(view.without) for view in found.views] == [1] * len(found.views)
    (left,) = [one for one in remaining(found) if one.joint == "shoulder"]
    assert left.after < 1.5 * left.noise
