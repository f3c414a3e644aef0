"""A load on a single joint: its weight there is certain where its mass and its place are not."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import size_errors, standard_errors
from flexjoint.diagnosis.search.criteria import known_sizes
from flexjoint.effects import Planned, effect
from flexjoint.robot.robot import load

LOAD = effect("payload", "swing", mass=0.9, position=(0.05, 0.0, -0.35))
INERTIA = effect("motor_inertia", "swing", scale=0.1)
DRAG = effect("motor_viscous_friction", "swing", coefficient=2.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    yield tmp_path_factory.mktemp("lever")


def problem(folder: Path, *causes: Planned, motion: str = "rich") -> Problem:
    """That of the lever with a rigid joint, motor encoder and current, under some causes."""
    data = yaml.safe_load((ROBOTS / "lever.yaml").read_text())
    data["joints"]["swing"] |= {"stiffness": float("inf"), "damping": 0.0, "kp": 600.0, "kd": 30.0}
    data["tolerance"] = {"inertial": 0.01, "stiffness": 0.01, "damping": 0.05, "torque": 0.01}
    shutil.copyfile(ROBOTS / "lever.urdf", folder / "lever.urdf")
    path = folder / "lever_rigid.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    planted = [Planted(e.effect.name, e.joint, dict(e.values)) for e in causes]
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(path, planted, motion, 12.0, 5, sensors, rate=250.0)
    return Problem(balances_of(load(path), as_recording(recorded)))


def moment(f: Fit) -> np.ndarray:
    """(3,) first moments [kg m] of the load of a set."""
    own = next(e for e in f.effects if e.effect.name == "payload")
    return np.asarray(own.values["mass"] * np.array(own.values["position"]))


def test_a_load_is_as_certain_as_the_energy_that_it_explains(folder: Path) -> None:
    """The energy that a load explains with its place as it is, is quadratic in its mass: its root is the mass
    in standard errors beside that place. Those of the mass alone also tell of the place, which may be nearer
    or farther."""
    loaded = fit(problem(folder, LOAD, motion="slow"), [LOAD])
    explained = refit_without(loaded, loaded.effects[0]).energy - loaded.energy
    beside_place, alone = size_errors(loaded)[0]["mass"][0], standard_errors(loaded)[0]["mass"][0]
    mass = loaded.effects[0].values["mass"]
    # errors are never below what noise gives, and above where what is left is not white
    assert 0.4 * explained < (mass / beside_place) ** 2 < 1.05 * explained
    assert alone > 2.0 * beside_place
    certain, _ = known_sizes(loaded, 0.0)
    assert certain[0] == pytest.approx(mass / beside_place)


def test_errors_of_what_has_no_shape_are_the_same(folder: Path) -> None:
    fitted = fit(problem(folder, DRAG), [DRAG, INERTIA])
    for sizes, every in zip(size_errors(fitted), standard_errors(fitted), strict=True):
        for name, errors in sizes.items():
            assert errors == pytest.approx(every[name], rel=1e-9)


@pytest.mark.parametrize("mass", [0.9, 20.0, 60.0])
def test_a_set_is_fitted_again_from_a_load_that_is_far_off(folder: Path, mass: float) -> None:
    """Without the effect beside it a load must move far, by numbers whose product its weight is: along their
    first derivatives it goes to where the energy may be a thousand times as large, from where no fit comes
    back. A fit from there by the residuals alone is the reference; it may not have come to the minimum
    either."""
    here = problem(folder, LOAD)
    near = np.array(LOAD.values["position"]) * LOAD.values["mass"] / mass
    load_there = LOAD.with_values({"mass": mass, "position": tuple(near)})
    start = fit(here, [effect("torque_gain", "swing", gain=-0.4), load_there], iterations=0)
    without, alone = refit_without(start, start.effects[0]), fit(here, [load_there])
    assert without.energy < alone.energy + 1.0
    assert moment(without) == pytest.approx(moment(alone), abs=0.02)
