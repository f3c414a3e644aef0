"""The schemes: order of convergence, stability, dry friction that sticks, conserved quantities."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, waves

from flexjoint.core.errors import SimulationError, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes import DEFAULT, make_step
from flexjoint.simulation.trajectory import Trajectory

SMOOTH = {
    "nominal": [],
    "hardening_spring": [effect("hardening_spring", "knee", cubic=1e5)],
    "spring_creep": [effect("spring_creep", "knee", stiffness=100.0, time_constant=0.05)],
    "transmission_error": [effect("transmission_error", "hip", amplitude=2e-3, cycles=16.0)],
    "current_lag": [effect("current_lag", "hip", time_constant=0.02)],
    "joint_coupling": [effect("joint_coupling", "knee", share=0.3)],
    "periodic_disturbance": [effect("periodic_disturbance", "hip", amplitude=2.0, frequency=7.0)],
    "cogging": [effect("cogging", "hip", amplitude=2.0, cycles=20.0)],
    "quadratic_drag": [effect("quadratic_drag", "hip")],
    "link_viscous_friction": [effect("link_viscous_friction", "knee", coefficient=3.0)],
    "cable_spring": [effect("cable_spring", "hip", stiffness=20.0, rest=0.3)],
    "payload": [effect("payload", "knee", mass=1.0, position=(0.0, 0.1, 0.1))],
}
TORQUE = np.array([6.0, -3.0])


def final(model: FlexibleJointModel, x0: np.ndarray, h: float, scheme: str, seconds: float) -> np.ndarray:
    x, step = model.unpack(x0.copy()), make_step(model, h, scheme)
    for _ in range(round(seconds / h)):
        x = step(x, TORQUE)
    return model.pack(x)


def moving(model: FlexibleJointModel) -> np.ndarray:
    """A start at link speeds of 1 and -2 rad/s with the motors at rest."""
    x0 = model.pack(model.rest())
    x0[model.nq : model.nq + 2] = 1.0, -2.0
    return x0


def reference(model: FlexibleJointModel, x0: np.ndarray, seconds: float) -> np.ndarray:
    """Dormand-Prince 8(5,3) at 1e-11, far below the errors measured here; no dry friction: no width used."""
    solution = solve_ivp(
        lambda t, x: model.rhs(x, TORQUE, 1.0, t), (0.0, seconds), x0, "DOP853", rtol=1e-11, atol=1e-12
    )
    return solution.y[:, -1]


# ------------------------------------------------------------------ accuracy
@pytest.mark.parametrize("name", SMOOTH)
def test_the_default_scheme_is_of_order_2_with_smooth_effects(name: str) -> None:
    model = FlexibleJointModel(make(PLANAR), SMOOTH[name])
    x0 = moving(model)
    exact = reference(model, x0, 0.3)
    coarse, fine = (np.max(np.abs(final(model, x0, h, DEFAULT, 0.3) - exact)) for h in (5e-4, 2.5e-4))
    # 2 within what the next term of the error still does at these steps
    assert 1.85 < np.log2(coarse / fine) < 2.15
    assert fine < 2e-5  # the payload swings 3 rad in the meantime


def test_order_2_holds_on_one_link_and_for_a_rigid_joint() -> None:
    for changes in ({}, {"joint": {"stiffness": float("inf")}}):
        model = FlexibleJointModel(make(PENDULUM, changes), [])
        x0 = model.pack(model.rest(np.array([0.7])))
        x0[1] = 2.0
        errors = []
        exact = solve_ivp(
            lambda t, x, m=model: m.rhs(x, np.array([3.0]), 1.0, t),
            (0, 0.3),
            x0,
            "DOP853",
            rtol=1e-11,
            atol=1e-12,
        ).y[:, -1]
        for h in (1e-3, 5e-4):
            x, step = model.unpack(x0.copy()), make_step(model, h)
            for _ in range(round(0.3 / h)):
                x = step(x, np.array([3.0]))
            errors.append(np.max(np.abs(model.pack(x) - exact)))
        assert 1.9 < np.log2(errors[0] / errors[1]) < 2.1


# ------------------------------------------------------------------ stiffness
@pytest.mark.parametrize("stiffness", [8e4, 1e7])
def test_the_default_scheme_is_stable_for_any_stiffness(stiffness: float) -> None:
    robot = make(SPATIAL, {name: {"stiffness": stiffness} for name in ("yaw", "roll", "pitch")})
    tape = rollout(
        FlexibleJointModel(robot, []),
        FlexibleJointModel(robot, []).rest(),
        waves(3, 2000, 1000),
        RunOptions(rate=1000),
    )
    assert np.max(np.abs(tape.v)) < 20.0  # torques of 6 N m: an arm of this size stays far below
    assert np.max(np.abs(tape.theta - tape.q)) < 20.0 / stiffness + 1e-4


def test_a_stiff_joint_tends_to_the_rigid_one_as_1_over_K() -> None:
    torque = waves(2, 600, 1000)
    rigid = make(PLANAR, {"hip": {"stiffness": float("inf")}, "knee": {"stiffness": float("inf")}})
    limit = rollout(
        FlexibleJointModel(rigid, []), FlexibleJointModel(rigid, []).rest(), torque, RunOptions(rate=1000)
    ).q
    errors = []
    for stiffness in (1e4, 1e5, 1e6):
        robot = make(
            PLANAR, {n: {"stiffness": stiffness, "damping": stiffness * 2e-3} for n in ("hip", "knee")}
        )
        model = FlexibleJointModel(robot, [])
        errors.append(np.max(np.abs(rollout(model, model.rest(), torque, RunOptions(rate=1000)).q - limit)))
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(10, rel=0.1)


# ------------------------------------------------------------------ dry friction
def held(effects: list[Planned], torque: float, seconds: float = 3.0, start: float = 0.3) -> Trajectory:
    """A pendulum at rest at `start`, its spring carrying gravity, under a constant motor torque."""
    model = FlexibleJointModel(make(PENDULUM), effects)
    x = model.rest(np.array([start]))
    x.theta = x.theta + model.body.gravity_torque(x.q) / model.flows[0].drive.K
    steps = round(seconds * 1000)
    return rollout(model, x, np.full((steps, 1), torque), RunOptions(rate=1000.0))


GRAVITY = 2.4 * 9.81 * 0.26 * np.sin(0.3)  # what the spring of `held` carries: 1.809 N m


@pytest.mark.parametrize(
    "effect",
    [
        effect("motor_coulomb_friction", "joint", level=2.0),
        effect("stribeck_friction", "joint", level=1.0, static_extra=1.0, velocity=0.05),
        effect("asymmetric_friction", "joint", level_positive=0.2, level_negative=2.0),
    ],
    ids=lambda effect: effect.effect.name,
)
def test_a_motor_sticks_below_its_level_and_breaks_away_above(effect: Planned) -> None:
    stuck = held([effect], 0.0)  # gravity pulls the motor with 1.81 N m, friction holds up to 2
    assert np.ptp(stuck.theta) == 0.0  # not a tiny drift: none
    assert np.ptp(stuck.q) < 1e-12  # rounding of the balance of spring and gravity
    moved = held([effect], -0.3)  # 2.11 N m
    assert np.ptp(moved.theta) > 1e-2


def test_a_link_sticks_below_its_level_and_breaks_away_above() -> None:
    model = FlexibleJointModel(make(PENDULUM), [effect("link_coulomb_friction", "joint", level=1.9)])
    for load, sticks in ((0.0, True), (-0.2, False)):
        x = model.rest(np.array([0.3]))  # a slack spring: friction alone carries gravity, 1.81 N m
        x.theta = x.theta + load / model.flows[0].drive.K
        tape = rollout(model, x, np.full((2000, 1), load), RunOptions(rate=1000.0))
        if sticks:
            assert np.ptp(tape.q) == 0.0
        else:
            assert np.ptp(tape.q) > 1e-2


def test_coupled_links_stick_together_and_one_by_one() -> None:
    both = [effect("link_coulomb_friction", name, level=30.0) for name in ("hip", "knee")]
    model = FlexibleJointModel(make(PLANAR), both)
    torque = waves(2, 1500, 1000)
    tape = rollout(model, model.rest(np.array([0.4, -0.2])), torque, RunOptions(rate=1000.0))
    assert np.ptp(tape.q) == np.ptp(tape.q[0])  # neither moves
    one = [effect("link_coulomb_friction", "hip", level=40.0), effect("link_coulomb_friction", "knee")]
    model = FlexibleJointModel(make(PLANAR), one)
    tape = rollout(model, model.rest(np.array([0.4, -0.2])), torque, RunOptions(rate=1000.0))
    assert np.ptp(tape.q[:, 0]) == 0.0
    assert np.ptp(tape.q[:, 1]) > 0.05


def test_a_rigid_joint_sticks_by_its_motors_friction() -> None:
    robot = make(PENDULUM, {"joint": {"stiffness": float("inf")}})
    model = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "joint", level=1.9)])
    assert (
        np.ptp(rollout(model, model.rest(np.array([0.3])), np.zeros((2000, 1)), RunOptions(rate=1000)).q)
        == 0.0
    )
    tape = rollout(model, model.rest(np.array([0.3])), np.full((200, 1), -0.2), RunOptions(rate=1000))
    assert np.ptp(tape.q) > 1e-3


def test_a_sliding_motor_stops_where_its_energy_is_spent() -> None:
    robot = make(PENDULUM, {"joint": {"stiffness": 1e-6, "damping": 0.0, "motor_damping": 0.0}})
    model = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "joint", level=2.0)])
    x = model.rest()
    x.dtheta[:] = 3.0
    tape = rollout(model, x, np.zeros((1000, 1)), RunOptions(rate=1000.0))
    distance = 0.5 * 0.12 * 3.0**2 / 2.0  # B w^2 / 2 = level times distance
    assert tape.theta[-1, 0] == pytest.approx(distance, abs=3.0 * 1e-3)  # a step at the first speed
    assert tape.dtheta[-1, 0] == 0.0


def test_link_friction_acts_through_the_whole_mass_matrix() -> None:
    # two free links, no gravity: friction on the knee alone must leave the hip's momentum as it is
    free = {"stiffness": 1e-9, "damping": 0.0, "motor_damping": 0.0}
    robot = make(PLANAR, {"hip": free, "knee": free}, gravity=[0, 0, 0])
    model = FlexibleJointModel(robot, [effect("link_coulomb_friction", "knee", level=0.05)])
    x = model.rest(np.array([0.0, 0.5]))
    x.v = np.array([0.0, 2.0])
    tape = rollout(model, x, np.zeros((800, 2)), RunOptions(rate=1000.0))

    def hip_momentum(row: int) -> float:  # conserved: the base exerts no torque about the hip
        return float((model.body.mass_matrix(tape.q[row]) @ tape.v[row])[0])

    assert abs(tape.v[-1, 1]) < 1.0
    assert hip_momentum(-1) == pytest.approx(hip_momentum(0), abs=2e-5)  # order h^2, with h = 1 ms


# ------------------------------------------------------------------ conserved quantities
def energy(model: FlexibleJointModel, tape: Trajectory, row: int) -> float:
    q, v = tape.q[row], tape.v[row]
    body, data = model.robot.model, model.robot.model.createData()
    total = pin.computeKineticEnergy(body, data, q, v) + pin.computePotentialEnergy(body, data, q)
    for k, i in enumerate(model.flexible):
        drive, joint = model.joints[i].drive, model.joints[i]
        phi = tape.theta[row, k] - q[joint.idx_q]
        total += 0.5 * drive.B * tape.dtheta[row, k] ** 2 + 0.5 * drive.K * phi**2
    return float(total)


def test_energy_is_kept_without_damping_and_lost_as_the_dampers_say() -> None:
    lossless = {name: {"damping": 0.0, "motor_damping": 0.0} for name in ("hip", "knee")}
    model = FlexibleJointModel(make(PLANAR, lossless), [])
    x = model.rest(np.array([0.8, -0.5]))
    drifts = []
    for rate in (1000, 2000):
        tape = rollout(model, x, np.zeros((2 * rate, 2)), RunOptions(rate=rate))
        drifts.append(abs(energy(model, tape, -1) - energy(model, tape, 0)))
    assert drifts[0] < 1e-2  # of 10 J
    assert drifts[0] / drifts[1] > 2.5  # order 2, within the phase of its oscillation
    model = FlexibleJointModel(make(PLANAR), [])
    tape = rollout(model, x, np.zeros((4000, 2)), RunOptions(rate=4000))
    phi_rate = tape.dtheta - tape.v
    D, D_m = np.array([1.6, 1.0]), np.array([12.0, 8.0])
    lost = np.trapezoid(phi_rate**2 @ D + tape.dtheta**2 @ D_m, tape.time)
    assert energy(model, tape, 0) - energy(model, tape, -1) == pytest.approx(lost, rel=1e-3)


def test_a_floating_robot_keeps_its_momentum() -> None:
    robot = make(SPATIAL, base="floating", gravity=[0, 0, 0])
    model = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "roll", level=1.0)])
    start = model.rest()
    data = robot.model.createData()
    for rate in (500, 1000):
        tape = rollout(model, start, waves(3, rate, rate), RunOptions(rate=rate))
        momentum = pin.computeCentroidalMomentum(robot.model, data, tape.q[-1], tape.v[-1]).vector
        assert np.max(np.abs(momentum)) < 1e-13  # rounding: measured 1e-15 of bodies with some kg m/s
        assert np.max(np.abs(tape.v)) > 0.5
        assert np.linalg.norm(tape.q[-1, 3:7]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        [effect("motor_coulomb_friction", "joint", level=1.0), effect("backlash", "joint", gap=0.01)],
        [effect("spring_hysteresis", "joint"), effect("link_coulomb_friction", "joint", level=0.4)],
        [effect("dahl_friction", "joint"), effect("hardening_spring", "joint")],
    ],
)
def test_mirrored_torques_give_the_mirrored_motion(effects: list[Planned]) -> None:
    model = FlexibleJointModel(make(PENDULUM), effects)
    torque = waves(1, 1500, 1000, size=8.0)
    there, back = (
        rollout(model, model.rest(), side * torque, RunOptions(rate=1000.0)) for side in (1.0, -1.0)
    )
    assert np.max(np.abs(there.q)) > 0.1
    np.testing.assert_allclose(back.theta, -there.theta, rtol=0, atol=1e-12)  # rounding only
    np.testing.assert_allclose(back.q, -there.q, rtol=0, atol=1e-12)


# ------------------------------------------------------------------ interface
def test_names_and_widths_are_checked() -> None:
    robot: Robot = make(PENDULUM)
    rubbing = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "joint")])
    with pytest.raises(UnknownNameError, match="rk4"):
        make_step(rubbing, 1e-3, "rk5")
    with pytest.raises(SimulationError, match="give a width"):
        make_step(rubbing, 1e-3, "rk4")
    make_step(rubbing, 1e-3, "rk4", width=0.01)
