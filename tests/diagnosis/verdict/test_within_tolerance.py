"""Nominal numbers that are off by less than their tolerance: listed, and told of what is left."""

from __future__ import annotations

from pathlib import Path

import pytest
from planting import Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.robots.rigid_lever import rigid_lever

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.verdict.verdict import not_believed, within_tolerance
from flexjoint.robot.robot import load

CLAIMED = 6.0  # N m, Coulomb friction that the model lists, known to 10 %


@pytest.mark.parametrize("actual", [5.5, 6.4])
def test_friction_that_the_model_claims_is_listed_with_its_sign(tmp_path: Path, actual: float) -> None:
    listed = {"effect": "motor_coulomb_friction", "joint": "swing", "level": CLAIMED, "nominal": True}
    claiming = rigid_lever(tmp_path, [listed], "claiming")
    friction = Planted("motor_coulomb_friction", "swing", {"level": actual})
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(rigid_lever(tmp_path), [friction], "rich", 20.0, 5, sensors, rate=250.0)
    best = at_own_level(fit(Problem(balances_of(load(claiming), as_recording(recorded))), []))

    shown = {(w.effect, w.joint): w.value for w in within_tolerance(best)}

    # what damping and inertia, known to 10 and 2 %, take of it
    assert shown["motor_coulomb_friction", "swing"] == pytest.approx(actual - CLAIMED, abs=0.1)
    assert not not_believed(best)


def test_claimed_friction_that_is_far_off_is_no_absurdity(tmp_path: Path) -> None:
    """Friction may be any share of what a model claims: of no other number is that plausible."""
    listed = {"effect": "motor_coulomb_friction", "joint": "swing", "level": CLAIMED, "nominal": True}
    claiming = rigid_lever(tmp_path, [listed], "claiming")
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(rigid_lever(tmp_path), [], "rich", 20.0, 5, sensors, rate=250.0)
    best = fit(Problem(balances_of(load(claiming), as_recording(recorded))), [])

    assert best.furthest > best.settings.verdict.believed
    assert not any("coulomb" in note for note in not_believed(best))


@pytest.mark.parametrize("claimed", [0.4, 0.04])
def test_friction_is_not_less_than_none(tmp_path: Path, claimed: float) -> None:
    """A claim of friction that is not there: what the data say of it is not quite nothing, to either side."""
    listed = {"effect": "motor_coulomb_friction", "joint": "swing", "level": claimed, "nominal": True}
    claiming = rigid_lever(tmp_path, [listed], "claiming", known=0.6)
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(rigid_lever(tmp_path), [], "rich", 20.0, 5, sensors, rate=250.0)
    arm = load(claiming)
    best = at_own_level(fit(Problem(balances_of(arm, as_recording(recorded))), []))
    found = [w for w in within_tolerance(best) if w.effect == "motor_coulomb_friction"]
    assert [w.parameter for w in found] == ["level"]
    changed = found[0].applied(arm.effects)
    assert 0.0 <= changed.p.level < 0.1 * claimed
