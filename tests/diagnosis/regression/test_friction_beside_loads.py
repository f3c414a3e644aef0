"""Dry friction of a rigid arm holds the load of its links at rest, a payload's too: what a change of it does
is taken beside that payload, and so is what any change on its joint does."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Slot, _column, fit, slots_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search import criteria
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.robot.robot import load

MOTOR = SensorSet(channels=("theta", "tau_motor"))
FRICTION = {"shoulder": 9.0, "elbow": 5.0}  # N m: more than the payload's weight, which it holds at rest
PLANTED = [
    Planted("payload", "elbow", {"mass": 0.7, "position": [0.02, 0.0, -0.4]}),
    *(Planted("motor_coulomb_friction", joint, {"level": level}) for joint, level in FRICTION.items()),
]
ASSUMED = [
    effect("payload", "elbow", mass=0.7, position=(0.02, 0.0, -0.4)),
    *(effect("motor_coulomb_friction", joint, level=level) for joint, level in FRICTION.items()),
]


@cache
def problem(damping: float = 0.0) -> Problem:
    """The crane with rigid joints and that nominal damping, 20 s of motion with stops."""
    data = yaml.safe_load((ROBOTS / "crane.yaml").read_text())
    for joint in data["joints"].values():
        joint |= {
            "stiffness": float("inf"),
            "damping": 0.0,
            "motor_damping": damping,
            "kp": 900.0,
            "kd": 40.0,
        }
    with TemporaryDirectory() as folder:
        shutil.copyfile(ROBOTS / "crane.urdf", Path(folder) / "crane.urdf")
        path = Path(folder) / "crane_rigid.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        recorded = as_recording(plant(path, PLANTED, "rich", 20.0, 3, MOTOR, rate=250.0))
        return Problem(balances_of(load(path), recorded))


def of_level(effects: list[Planned], joint: str) -> Slot:
    return next(
        slot for slot in slots_of(effects) if effects[slot.effect].key == ("motor_coulomb_friction", joint)
    )


@pytest.mark.parametrize("joint", list(FRICTION))
def test_the_derivative_by_a_level_is_that_of_the_whole_residual(joint: str) -> None:
    here, effects = problem(), list(ASSUMED)
    slot = of_level(effects, joint)
    step = 1e-3 * slot.get(effects)
    moved = list(effects)
    slot.put(moved, slot.get(effects) + step)

    by_level = _column(here, effects, slot)
    whole = (here.residual(moved) - here.residual(effects)) / step

    assert np.linalg.norm(whole) > 100.0
    # without the payload the friction would hold another torque at rest
    assert np.linalg.norm(by_level - whole) < 1e-6 * np.linalg.norm(whole)


@pytest.mark.parametrize("joint", list(FRICTION))
def test_a_scan_sees_what_friction_explains_beside_a_payload(joint: str) -> None:
    best = fit(problem(), ASSUMED)
    others = [e for e in best.effects if e.key != ("motor_coulomb_friction", joint)]
    without = fit(best.problem, others, held=others)
    law = Candidate(catalogue()["motor_coulomb_friction"], joint)

    (scored,) = Scanner([law]).scan(without)

    # numbers of the others may make up for some of it, which the scan allows for
    free = fit(best.problem, others)
    assert scored.removes > 0.75 * (free.energy - best.energy)
    assert scored.planned().values["level"] == pytest.approx(FRICTION[joint], rel=0.25)


def test_a_damping_that_the_model_has_not_is_no_nominal_number() -> None:
    """A share of nothing is nothing: such a number explains nothing, and a friction is not a change of it."""
    viscous = effect("motor_viscous_friction", "elbow", coefficient=2.0)

    assert criteria.own_number(problem(), viscous) is None
    assert criteria.own_number(problem(3.0), viscous) is not None


def test_friction_of_two_joints_is_no_shaft_that_both_share() -> None:
    here = problem()
    payload = ASSUMED[0]
    shared = effect("coupled_friction", "elbow", level=5.0, coefficient=0.1, speed="sum")
    trial = fit(here, [payload, shared])

    assert criteria.stands_in(trial, trial.effects[-1])
    assert not criteria.supported(trial, fit(here, [payload]), trial.effects[-1])
    # beside the friction of both it stands for nothing else
    every = fit(here, [*ASSUMED, effect("motor_viscous_friction", "elbow", coefficient=0.1),
                       effect("motor_viscous_friction", "shoulder", coefficient=0.1), shared])  # fmt: skip
    assert not criteria.stands_in(every, every.effects[-1])


def test_of_two_numbers_one_at_its_bound_leaves_the_other_its_best() -> None:
    """Static friction that would be negative is none, and the level is then Coulomb friction's."""
    here = problem()
    wide, narrow = (
        Scanner([c for c in enumerate_candidates(here) if c.key == (name, "elbow")]).scan(fit(here, []))[0]
        for name in ("stribeck_friction", "motor_coulomb_friction")
    )
    assert wide.removes >= narrow.removes * (1.0 - 1e-3)
    assert wide.planned().values["static_extra"] >= 0.0
