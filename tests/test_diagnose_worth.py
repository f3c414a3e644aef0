"""What a cause must be to be named, and how far it is believed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnose_cases import Case, as_recording, found_in, nominal, summary
from planting import Planted

from flexjoint.diagnose import selection
from flexjoint.diagnose.balances import balances_of
from flexjoint.diagnose.fit import Fit, fit
from flexjoint.diagnose.reliability import LEAST, left_by, reliability
from flexjoint.diagnose.selection import date_onset
from flexjoint.diagnose.workspace import Workspace
from flexjoint.diagnose.worth import contradicted, explained
from flexjoint.effect import Planned, plan

CAUSES = (
    Planted("link_viscous_friction", "swing", {"coefficient": 1.3}),
    Planted("spring_damping", "swing", {"scale": 1.0}),
)
"""A damping twice the nominal one's, which the robot file claims to a tenth, beside a friction that explains
a hundred thousand times as much."""


def fitted(case: Case, *causes: Planted, assumed: tuple[Planned, ...]) -> Fit:
    workspace = Workspace(balances_of(nominal(case.robot), as_recording(case.with_causes(*causes))))
    return fit(workspace, assumed)


def test_a_nominal_number_far_off_beside_a_large_cause_is_named() -> None:
    result = found_in(Case("lever", "rich", 5, inexact=0.02), *CAUSES)
    named = {(f.effect, f.joint) for f in result.findings}

    assert named == {(c.effect, c.joint) for c in CAUSES}, summary(result)
    assert result.verdict == "causes", summary(result)


def test_what_the_change_of_a_nominal_number_explains_is_counted_with_that_number_held() -> None:
    """Its own deviation takes its place at a price of some hundred: what it explains is far more."""
    viscous = plan("link_viscous_friction", "swing", {"coefficient": 1.3})
    damping = plan("spring_damping", "swing", {"scale": 1.0})
    trial = fitted(Case("lever", "rich", 5, inexact=0.02), *CAUSES, assumed=(viscous, damping))
    without = fit(trial.workspace, trial.effects[:1])
    earned = without.energy - trial.energy

    assert 20.0 < earned < 500.0
    assert explained(trial, without, trial.effects[1]) > 10.0 * earned
    assert explained(trial, fit(trial.workspace, trial.effects[1:]), trial.effects[0]) > 1e5


COGGING = Planted("cogging", "turn", {"amplitude": 0.3, "cycles": 18.0, "phase": 0.7})


def test_a_cause_that_makes_another_balance_wrong_is_none() -> None:
    """A transmission error makes the motor's torque ripple as cogging does, and the link's, too."""
    spring = plan("transmission_error", "turn", {"amplitude": 2e-3, "cycles": 18.0, "phase": 0.7})
    cogging = plan("cogging", "turn", {"amplitude": 0.3, "cycles": 18.0, "phase": 0.7})
    case = Case("turret_exact", "slow", 3)
    nothing = fitted(case, COGGING, assumed=())
    wrong, right = (
        replace(nothing, effects=(one,), y=nothing.workspace.residual([one])) for one in (spring, cogging)
    )

    assert contradicted(wrong, nothing)
    assert not contradicted(right, nothing)


def test_a_struck_cause_is_not_replaced_with_confidence() -> None:
    result = found_in(Case("turret_exact", "slow", 3), COGGING, excluded=frozenset({"cogging"}))

    assert result.verdict == "unexplained", summary(result)
    assert all(f.probability < 0.5 for f in result.findings), summary(result)


def test_a_name_is_believed_by_what_it_leaves() -> None:
    """The cause itself leaves the noise; one that follows a part of the error leaves the rest."""
    friction = Planted("motor_coulomb_friction", "turn", {"level": 0.4})
    case = Case("turret_exact", "rich", 3)
    true = fitted(case, friction, assumed=(plan("motor_coulomb_friction", "turn", {"level": 0.4}),))
    other = fit(true.workspace, [plan("motor_viscous_friction", "turn", {"coefficient": 0.4})])
    left = [left_by(one, 0) for one in (true, other)]

    assert left[0] < 30.0
    assert left[1] > 1000.0
    assert reliability(true, left[0]) > 0.5
    assert reliability(other, left[1]) == LEAST
    strained = replace(true, workspace=true.workspace.at(true.workspace.temper, 2.0))
    assert reliability(strained, left[0]) < reliability(true, left[0])


def test_an_onset_is_found_in_a_few_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that are fitted anew at each onset can take turns for ever, as every fit gains a little."""
    late = Planted("motor_coulomb_friction", "turn", {"level": 0.4}, since=5.9)
    guess = plan("motor_coulomb_friction", "turn", {"level": 0.3}, since=6.6)
    begun = fitted(Case("turret", "rich", 3, inexact=0.02), late, assumed=(guess,))
    count = 0

    def counted(*given: object) -> Fit:
        nonlocal count
        count += 1
        return fit(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(selection, "fit", counted)
    dated = date_onset(begun)

    assert dated.effects[0].since == pytest.approx(5.9, abs=0.05)
    assert count <= 1 + len(selection.ONSET_STEPS)
