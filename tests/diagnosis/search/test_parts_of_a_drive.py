"""Small friction is part of what the model of a drive lacks, all of which may be large."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planting import Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.robots.rigid_lever import rigid_lever

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import at_own_level, by_joint, material, torque_shares
from flexjoint.diagnosis.search.selection import has_room
from flexjoint.effects import Planned, effect
from flexjoint.robot import robot

DRY = effect("motor_coulomb_friction", "swing", level=3.0)
VISCOUS = effect("motor_viscous_friction", "swing", coefficient=0.1)
OFFSET = effect("torque_offset", "swing", offset=0.15)
CERTAIN = 1e3  # chi-square that an effect explains


def made(folder: Path, *dry: Planted) -> Problem:
    """A rigid lever whose model has no friction, with some, and a ripple that nobody names."""
    path = rigid_lever(folder, damping=0.0)
    planted = [
        *dry,
        Planted("motor_viscous_friction", "swing", {"coefficient": 0.1}),
        Planted("torque_offset", "swing", {"offset": 0.15}),
        Planted("cogging", "swing", {"amplitude": 1.0, "cycles": 23.0, "phase": 0.4}),
    ]
    recorded = plant(path, planted, "rich", 12.0, 5, SensorSet(channels=("theta", "tau_motor")), rate=250.0)
    return Problem(balances_of(robot.load(path), as_recording(recorded)))


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return made(tmp_path_factory.mktemp("rigid"), Planted("motor_coulomb_friction", "swing", {"level": 3.0}))


def small_one(problem: Problem, *effects: Planned) -> tuple[Fit, Planned]:
    """A fit, and its last effect, whose torque is below the robot's tolerance."""
    trial = at_own_level(fit(problem, effects))
    share = np.max(torque_shares(problem, trial.effects, len(effects) - 1))
    assert share < problem.robot.tolerance.torque
    return trial, trial.effects[-1]


def test_small_friction_matters_beside_large_friction_of_its_joint(problem: Problem) -> None:
    assert material(*small_one(problem, DRY, VISCOUS), CERTAIN)


def test_it_does_not_matter_where_it_is_not_certain(problem: Problem) -> None:
    assert not material(*small_one(problem, DRY, VISCOUS), 1.0)


def test_it_does_not_matter_by_itself(tmp_path: Path) -> None:
    assert not material(*small_one(made(tmp_path), VISCOUS), CERTAIN)


def test_what_is_no_part_of_the_drive_does_not_matter_more_beside_friction(problem: Problem) -> None:
    assert not material(*small_one(problem, DRY, OFFSET), CERTAIN)


def test_what_every_drive_has_takes_no_room_of_other_causes(problem: Problem) -> None:
    """An arm known by its description has three such causes a joint, and with them it was full: neither a
    table that leans nor a spring beside a joint was looked for."""
    most = problem.settings.search.most_effects
    bare = fit(problem, [])
    assert has_room(replace(bare, effects=(DRY, VISCOUS) * most))
    assert has_room(replace(bare, effects=(DRY, *(OFFSET,) * (most - 1))))
    assert not has_room(replace(bare, effects=(OFFSET,) * most))
    assert by_joint([DRY, VISCOUS, OFFSET]) == {"swing": 1}
