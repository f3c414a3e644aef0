"""Rivals that explain a recording as well as the cause that is named, and rivals that do not."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, found_in, nominal, summary
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.ties import special_cases, ties
from flexjoint.effects import effect


@pytest.fixture(scope="module")
def friction() -> Fit:
    rubs = Planted("motor_coulomb_friction", "turn", {"level": 0.4})
    recording = as_recording(Case("turret", "rich", 3).with_causes(rubs))
    problem = Problem(balances_of(nominal("turret"), recording))
    return fit(problem, [effect("motor_coulomb_friction", "turn", level=0.4)])


def rival_of(best: Fit, error: float, share: slice) -> Fit:
    """Another law in its place that is off by some deviations of the noise in a share of the recording."""
    problem = best.problem
    y = best.y.reshape(len(problem.balances.rows), -1).copy()
    y[0, share] += error
    other = effect("link_coulomb_friction", "turn", level=0.4)
    moved = replace(best, y=y.ravel(), effects=(other,))
    energy = best.energy + problem.energy(moved.y) - problem.energy(best.y)
    return replace(moved, judge=lambda: energy)


def test_a_rival_that_is_worse_at_one_moment_only_is_a_tie(friction: Fit) -> None:
    (cause,) = friction.effects
    count = friction.y.size // len(friction.problem.balances.rows)
    once = rival_of(friction, 8.0, slice(count // 2, count // 2 + 12))
    always = rival_of(friction, 1.0, slice(None, None, 2))
    negligible = USUAL.search.finer_method_error * (fit(friction.problem, []).energy - friction.energy)

    for rival in (once, always):  # both far from chance, both within the method's error
        assert 100.0 < rival.energy - friction.energy < negligible
    assert [tie.effect for tie in ties(friction, cause, [once])] == ["link_coulomb_friction"]
    assert not ties(friction, cause, [always])


def test_a_rival_that_leaves_more_than_the_methods_error_is_none(friction: Fit) -> None:
    (cause,) = friction.effects
    count = friction.y.size // len(friction.problem.balances.rows)
    worse = rival_of(friction, 400.0, slice(count // 2, count // 2 + 12))
    assert not ties(friction, cause, [worse])


@pytest.mark.parametrize(("extra", "told"), [(0.04, False), (0.4, True)])
def test_a_further_number_must_remove_more_than_the_small_errors_that_are_left(
    extra: float, told: bool
) -> None:
    """Friction that is higher at low speed, by little and by much, on a machine that leaves noise, and on
    one that leaves as much for reasons that nobody names."""
    rubs = Planted("stribeck_friction", "turn", {"level": 0.4, "static_extra": extra, "velocity": 0.4})
    problem = Problem(
        balances_of(nominal("turret"), as_recording(Case("turret", "rich", 3).with_causes(rubs)))
    )
    found = fit(problem, [effect(rubs.effect, "turn", **rubs.parameters)])
    torque, (cause,) = float(problem.torque_scale[0]), found.effects
    clean = Remaining("turn", torque, before=0.4, after=0.03, noise=0.03, structured=0.0, against="t")
    dirty = replace(clean, after=0.04)

    assert found.energy < 1.5 * problem.freedom  # noise, and what remains of friction at rest
    assert not special_cases(found, cause, clean)
    ties = [tie.effect for tie in special_cases(found, cause, dirty)]
    assert ties == ([] if told else ["motor_coulomb_friction"])


def test_on_one_joint_a_late_torque_is_late_readings() -> None:
    result = found_in(Case("lever", "rich", 5), Planted("torque_delay", "swing", {"delay": 0.004}))
    (finding,) = result.findings
    names = {finding.effect, *(tie.effect for tie in finding.indistinguishable)}

    assert {"torque_delay", "sensor_delay"} <= names, summary(result)


@thorough
@pytest.mark.parametrize(("seconds", "named"), [(0.02, "current_lag"), (0.0005, "torque_delay")])
def test_a_lag_is_named_a_delay_where_both_fit(seconds: float, named: str) -> None:
    """A lag differs from a dead time to second order in it."""
    case = Case("crane", "rich", 5)
    result = found_in(case, Planted("current_lag", "elbow", {"time_constant": seconds}))
    (finding,) = result.findings
    listed = "current_lag" in {tie.effect for tie in finding.indistinguishable}

    assert (finding.effect, listed) == (named, named == "torque_delay"), summary(result)
