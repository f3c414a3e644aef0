"""One cause of several joints: a clock that is late, a torque constant of motors of one type."""

from __future__ import annotations

from functools import cache

import pytest
from planting import Planted, plant, robot_file
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.thorough import thorough

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import prices, repeated
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import with_common
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, effect
from flexjoint.robot.robot import load

NAME = "dirty_drawn_12_of6_rigid_5"  # six rigid joints
JOINTS = tuple(f"joint_{k}" for k in range(6))
SENSORS = SensorSet(channels=("theta", "tau_m"))


@cache
def sets(*gains: float) -> list[Fit]:
    """Sets with one cause of several joints, of an arm whose torque gains are these, joint by joint."""
    causes = [
        Planted("torque_gain", j, {"gain": gain}) for j, gain in zip(JOINTS, gains, strict=False) if gain
    ]
    recorded = plant(robot_file(NAME), causes, "rich", 12.0, 7, SENSORS, rate=250.0)
    problem = Problem(balances_of(load(robot_file(NAME)), as_recording(recorded)))
    bare = fit(problem, [])
    candidates = enumerate_candidates(problem)
    with worker_pool([], 1) as pool:
        return with_common(bare, Scanner(candidates).scan(bare), pool)


def gained(found: Fit) -> dict[str | None, float]:
    return {e.joint: e.values["gain"] for e in found.effects if e.effect.name == "torque_gain"}


def test_motors_of_one_type_have_one_gain() -> None:
    found = min(sets(-0.2, -0.2, -0.2), key=lambda f: f.energy)
    sizes = gained(found)
    # the first joint carries no weight: what it lacks of torque is within the tolerance of its inertia
    assert set(sizes) == set(JOINTS[1:3])
    assert list(sizes.values()) == pytest.approx([-0.2] * 2, abs=0.03)


@thorough
def test_different_gains_are_not_one_cause() -> None:
    assert not [f for f in sets(-0.3, 0.4, -0.1) if gained(f)]


@thorough
def test_a_joint_of_another_size_is_left_out() -> None:
    found = min(sets(0.0, -0.2, -0.2, 0.5), key=lambda f: f.energy)
    assert set(gained(found)) == set(JOINTS[1:3])


@thorough
def test_a_machine_without_any_has_none() -> None:
    assert sets() == []


def lags(*seconds: float) -> list[Planned]:
    return [effect("current_lag", j, time_constant=s) for j, s in zip(JOINTS, seconds, strict=False)]


def test_a_cause_that_several_joints_share_is_counted_once() -> None:
    limits = USUAL.search
    assert repeated(lags(0.010, 0.009, 0.011), limits) == {1: 0, 2: 0}
    # far from it, another law, or a friction, which every joint has by itself: causes of their own
    assert repeated(lags(0.010, 0.004), limits) == {}
    others = [effect("torque_delay", JOINTS[1], delay=0.01), effect("motor_coulomb_friction", JOINTS[2])]
    assert repeated([*lags(0.010), *others, effect("motor_coulomb_friction", JOINTS[3])], limits) == {}


def test_on_further_joints_it_costs_a_further_number() -> None:
    bare = sets(-0.2, -0.2, -0.2)[0]
    three = fit(bare.problem, [effect("torque_gain", j, gain=-0.2) for j in JOINTS[:3]], iterations=0)
    limits = USUAL.search
    assert prices(three) == [limits.price, limits.price_number, limits.price_number]
