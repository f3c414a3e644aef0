"""Rigid joints that bend: what that changes of the loads, and whether a recording tells it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from planting import PERFECT, ROBOTS, Planted, SensorSet, plant
from planting.robots import read_robot
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import MOTOR, TwinBalances, balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import degenerate
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.effects import Planned, effect
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

MOTOR_SIDE = ("theta", "dtheta", "tau_m", "tau_cmd")


def taken_as_rigid(robot: Robot, *joints: str) -> Robot:
    stiff = {name: replace(robot.joint(name).drive, K=math.inf, D=0.0) for name in joints}
    return replace(
        robot, joints=tuple(replace(j, drive=stiff[j.name]) if j.name in stiff else j for j in robot.joints)
    )


def motors_alone(
    *causes: Planted, robot: str = "lever", excitation: str = "rich", seed: int = 41
) -> Recording:
    recording = as_recording(Case(robot, excitation, seed).with_causes(*causes))
    return motor_side(recording)


def motor_side(recording: Recording) -> Recording:
    kept = {key: x for key, x in recording.columns.items() if key[0] in MOTOR_SIDE}
    return replace(recording, columns=kept)


@pytest.fixture(scope="module")
def balances() -> TwinBalances:
    return balances_of(taken_as_rigid(nominal("lever"), "swing"), motors_alone())


def true_spring(factor: float = 1.0) -> Planned:
    drive = nominal("lever").joint("swing").drive
    return effect("joint_compliance", "swing", compliance=factor / drive.K, relaxation=drive.D / drive.K)


def left(balances: TwinBalances, effects: list[Planned]) -> float:
    used = balances.motion.readings.valid
    (row,) = (r for r, row in enumerate(balances.rows) if row.balance == MOTOR)
    return float(np.std(balances.time_series(balances.residual(effects)[row])[used]))


def test_the_true_spring_leaves_least(balances: TwinBalances) -> None:
    """Of a planted machine, by another integrator: with sensors that make no noise what is left is the error
    of the first order in the deflection and of the filter's ends; with real ones it is their noise, of which
    the spring's own numbers, where the robot file has them, leave as much."""
    robot = nominal("lever")
    recorded = as_recording(plant(ROBOTS / "lever.yaml", [], "rich", 12.0, 41, PERFECT))
    exact = balances_of(taken_as_rigid(robot, "swing"), motor_side(recorded))
    at_truth, bare = left(exact, [true_spring()]), left(exact, [])
    assert at_truth < 0.005 * bare
    assert all(left(exact, [true_spring(factor)]) > 0.05 * bare for factor in (0.9, 1.1))
    known = left(balances_of(robot, motors_alone()), [])
    assert left(balances, [true_spring()]) < 1.1 * known < 0.2 * left(balances, [])


def test_hardly_any_compliance_changes_hardly_anything(balances: TwinBalances) -> None:
    """In proportion to it, to first order."""
    changes = [balances.denoised.change([], [true_spring(factor)]) for factor in (1e-4, 1e-3)]
    small, larger = (float(np.linalg.norm(change)) for change in changes)
    assert 0.0 < small == pytest.approx(0.1 * larger, rel=0.05)


def test_a_friction_found_beside_it_changes_what_its_motor_passes_on(balances: TwinBalances) -> None:
    """The memory of loads knows of it: a set evaluated after another one is as one evaluated alone."""
    spring, friction = true_spring(), effect("motor_viscous_friction", "swing", coefficient=3.0)
    balances.residual([spring])
    after = balances.residual([spring, friction])
    alone = balances_of(balances.motion.robot, balances.motion.readings.recording).residual(
        [spring, friction]
    )
    np.testing.assert_array_equal(after, alone)
    change = balances.change([spring], [spring, friction])
    np.testing.assert_allclose(change, after - balances.residual([spring]), atol=1e-9)


def test_only_a_motors_encoder_can_tell() -> None:
    """A link's encoder would see the link itself; and a joint with a spring has no compliance to find."""
    robot = nominal("lever")
    recording = as_recording(Case("lever", "rich", 41).with_causes())
    links = replace(recording, columns={k: x for k, x in recording.columns.items() if k[0] in ("q", "tau_m")})
    for model, recorded, told in (
        (taken_as_rigid(robot, "swing"), motors_alone(), True),
        (taken_as_rigid(robot, "swing"), links, False),
        (robot, motors_alone(), False),
    ):
        found = enumerate_candidates(Problem(balances_of(model, recorded)))
        assert ("joint_compliance" in {c.effect.name for c in found}) is told


def test_a_scan_starts_near_it(balances: TwinBalances) -> None:
    """From the sizes that the effect looks at, without knowing it: within a factor of two."""
    problem = Problem(balances)
    candidates = [c for c in enumerate_candidates(problem) if c.effect.for_rigid]
    (best, *_others) = Scanner(candidates).scan(fit(problem, []))
    found, true = best.planned().values["compliance"], true_spring().values["compliance"]
    assert best.since is None and 0.5 * true < found < 2.0 * true


@pytest.mark.parametrize("seed", [81, 85])
def test_nearly_no_compliance_is_judged_as_none(seed: int) -> None:
    """What bends lets no encoder noise through to the link: by the noise predicted of a rigid joint, one that
    hardly bends had fitted a rigid machine's noise better or worse by tens of units of energy."""
    path = ROBOTS / "lever.yaml"
    real = replace(read_robot(path), stiffness=np.array([math.inf]), damping=np.zeros(1))
    recorded = plant(
        path, [], "rich", 8.0, seed, SensorSet(channels=("theta", "tau_motor")), 250.0, real=real
    )
    problem = Problem(balances_of(taken_as_rigid(nominal("lever"), "swing"), as_recording(recorded)))
    bent = effect("joint_compliance", "swing", compliance=1e-6, relaxation=3e-3)
    without, beside = fit(problem, []), fit(problem, [bent], iterations=0)
    assert beside.energy == pytest.approx(without.energy, abs=2.0)


def test_a_joint_softer_than_any_means_nothing(balances: TwinBalances) -> None:
    """A link that weighs next to nothing resonates with any spring that is soft enough."""
    problem = Problem(balances)
    signals = problem.signals("swing")
    torque = float(np.sqrt(np.mean(np.square(signals.tau_m))))
    soft, softest = (effect("joint_compliance", "swing", compliance=bent / torque) for bent in (0.2, 0.4))
    most = soft.effect.largest(signals)["compliance"]

    assert degenerate(problem, softest) and not degenerate(problem, soft)
    light = replace(signals, tau_t=1e-6 * np.asarray(signals.tau_t))
    for here in (signals, light):
        assert all(start["compliance"] <= most for start in soft.effect.starts(here))
