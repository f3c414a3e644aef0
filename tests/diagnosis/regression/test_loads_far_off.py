"""A load on a single joint, which feels its moments: from where its mass and its place are far off."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from planting import Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.robots.rigid_lever import rigid_lever

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, effect
from flexjoint.robot.robot import load

LOAD = effect("payload", "swing", mass=0.9, position=(0.05, 0.0, -0.35))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    yield tmp_path_factory.mktemp("lever")


def problem(folder: Path, *causes: Planned) -> Problem:
    """That of the lever with a rigid joint, motor encoder and current, under some causes."""
    path = rigid_lever(folder)
    planted = [Planted(e.effect.name, e.joint, dict(e.values)) for e in causes]
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(path, planted, "rich", 12.0, 5, sensors, rate=250.0)
    return Problem(balances_of(load(path), as_recording(recorded)))


def moment(f: Fit) -> np.ndarray:
    """(3,) first moments [kg m] of the load of a set."""
    own = next(e for e in f.effects if e.effect.name == "payload")
    return np.asarray(own.values["mass"] * np.array(own.values["position"]))


@pytest.mark.parametrize("mass", [0.9, 20.0, 60.0])
def test_a_set_is_fitted_again_from_a_load_that_is_far_off(folder: Path, mass: float) -> None:
    """Without the effect beside it a load must move far, by numbers whose product its weight is: along their
    first derivatives it goes to where the energy may be a thousand times as large, from where no fit comes
    back. From a heavy load near the axis it must come to a light one far from it."""
    here = problem(folder, LOAD)
    near = np.array(LOAD.values["position"]) * LOAD.values["mass"] / mass
    load_there = LOAD.with_values({"mass": mass, "position": tuple(near)})
    start = fit(here, [effect("torque_gain", "swing", gain=-0.4), load_there], iterations=0)
    without, right = refit_without(start, start.effects[0]), fit(here, [LOAD])
    assert without.energy < right.energy + 1.0
    assert moment(without) == pytest.approx(moment(right), abs=0.01)
    assert without.effects[0].values["mass"] == pytest.approx(right.effects[0].values["mass"], rel=0.05)


def test_a_load_that_is_none_becomes_one_that_is_missing(folder: Path) -> None:
    """From a load to a lack of one the mass passes zero, which it does not along its moments."""
    lacking = LOAD.with_values({"mass": -0.4})
    found = fit(problem(folder, lacking), [LOAD.with_values({"mass": 0.3})])
    assert moment(found) == pytest.approx(-0.4 * np.array(LOAD.values["position"]), abs=0.02)
