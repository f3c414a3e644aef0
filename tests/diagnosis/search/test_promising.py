"""Which candidates are fitted in full."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from support.robots.coupled_robots import coupled, swinging

from flexjoint.diagnosis.balances.balances import acts_within_a_joint, balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.scan import Scanner, Scored
from flexjoint.diagnosis.search.trials import promising
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.simulate import simulate

MOST = 1e4


@cache
def scanned() -> tuple[Fit, tuple[Scored, ...]]:
    """A rigid arm without any error, and what acts within each of its joints, as a scan lists it."""
    robot = coupled(None, rigid=True)
    noise = {"theta": 2e-5, "tau_m": 0.01}
    run = simulate(FlexibleJointModel(robot, []), swinging(robot, 4.0), sample_rate=500.0, noise=noise)
    problem = Problem(balances_of(robot, run.measured))
    bare = fit(problem, [])
    found = Scanner(enumerate_candidates(problem, frozenset())).scan(bare)
    return bare, tuple(s for s in found if acts_within_a_joint(s.candidate))


def ranked(share: float) -> list[Scored]:
    """One candidate of the last joint behind all those of the first, which explain much more."""
    first, *_, last = scanned()[0].problem.robot.joint_names
    many = [replace(s, removes=MOST) for s in scanned()[1] if s.candidate.joint == first]
    one = next(s for s in scanned()[1] if s.candidate.joint == last)
    return [*many, replace(one, removes=share * MOST)]


def test_each_joints_best_is_tried_however_many_explain_more_of_another() -> None:
    bare, limits = scanned()[0], scanned()[0].settings.search
    behind = ranked(2.0 * limits.promising)
    assert len(behind) > limits.polished + 1
    assert promising(bare, behind)[-1] is behind[-1]


def test_what_explains_far_less_is_not_tried() -> None:
    bare, limits = scanned()[0], scanned()[0].settings.search
    behind = ranked(0.5 * limits.promising)
    assert len(promising(bare, behind)) == limits.polished
    assert behind[-1] not in promising(bare, behind)
