"""Two causes of one joint that only together explain it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.pairs import joint_pairs
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.trials import at_noise
from flexjoint.robot.robot import load

NOMINAL = 6.0  # N m, Coulomb friction that the model lists


def robot_of(folder: Path, *listed: float) -> Path:
    """The lever of the planting with a rigid joint, whose model lists friction of these levels [N m]."""
    data = yaml.safe_load((ROBOTS / "lever.yaml").read_text())
    data["joints"]["swing"] |= {"stiffness": float("inf"), "damping": 0.0, "kp": 600.0, "kd": 30.0}
    data["tolerance"] = {"inertial": 0.02, "stiffness": 0.02, "damping": 0.1, "torque": 0.01}
    data["effects"] = [
        {"effect": "motor_coulomb_friction", "joint": "swing", "level": level, "nominal": True}
        for level in listed
    ]
    shutil.copyfile(ROBOTS / "lever.urdf", folder / "lever.urdf")
    path = folder / f"lever_{len(listed)}.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def sets(folder: Path, causes: list[Planted]) -> list[Fit]:
    """The pairs of a machine with these causes and no friction else."""
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(robot_of(folder), causes, "rich", 20.0, 5, sensors, rate=250.0)
    problem = Problem(balances_of(load(robot_of(folder, NOMINAL)), as_recording(recorded)))
    best = at_own_level(fit(problem, []))
    bare = at_noise(best)
    assert bare is not None
    candidates = enumerate_candidates(problem)
    with worker_pool([], 1) as pool:
        scanned = Scanner(candidates).scan(bare)
        return joint_pairs(best, bare, scanned, ["swing"], candidates, pool)


def test_a_friction_that_falls_below_the_nominal_one(tmp_path: Path) -> None:
    """As the joint warms up: less friction than nominal, and more that fades. Each alone halves the error."""
    planted = {
        "motor_coulomb_friction": {"level": 3.6},
        "friction_drift": {"level": 2.4, "time_constant": 6.0},
    }
    found = sets(tmp_path, [Planted(name, "swing", values) for name, values in planted.items()])

    assert found
    best = min(found, key=lambda f: f.energy)
    numbers = {e.effect.name: {k: float(v) for k, v in e.values.items()} for e in best.effects}
    assert set(numbers) == set(planted)
    for name, values in planted.items():
        assert numbers[name] == pytest.approx(values, rel=0.01)  # standard errors are near 0.3 %


def test_one_cause_is_no_pair(tmp_path: Path) -> None:
    assert sets(tmp_path, [Planted("motor_coulomb_friction", "swing", {"level": 3.6})]) == []
