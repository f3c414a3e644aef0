"""The machine moves as it must: rigid-body dynamics, Runge-Kutta steps, located events."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from planting import simulate
from planting.machine.by_hand import JOINT, LEVER, lever_gravity, run
from planting.machine.chain import body_load, inverse_dynamics, mass_matrix
from planting.machine.laws import Planted
from planting.machine.sensing import PERFECT
from planting.robots import ROBOTS, read_robot, robot_file
from planting.simulate import plant
from scipy.integrate import solve_ivp

NAMES = ("lever", "turret", "crane", "gimbal", "scara", "reach", "drawn_1", "drawn_14_exact")
CRANE, GIMBAL = ROBOTS / "crane.yaml", ROBOTS / "gimbal.yaml"


@pytest.mark.parametrize("name", NAMES)
def test_rigid_body_dynamics_match_pinocchio(name):
    path = robot_file(name)
    robot = read_robot(path)
    n, bodies = len(robot.joints), list(robot.bodies)
    model = pin.buildModelFromUrdf(str(path.with_suffix(".urdf")))
    assert tuple(model.names)[1:] == robot.joints
    data = model.createData()
    q, v, a = (ca.SX.sym(s, n) for s in "qva")
    loads = [body_load(body) for body in bodies]
    torque = inverse_dynamics(bodies, loads, ca.SX(robot.gravity), q, v, a)
    f = ca.Function("f", [q, v, a], [torque, mass_matrix(bodies, loads, q)])
    for at in np.random.default_rng(1).normal(size=(5, 3, n)):
        torque, matrix = f(*at)
        upper = np.triu(pin.crba(model, data, at[0]))
        np.testing.assert_allclose(
            np.array(torque).ravel(), pin.rnea(model, data, *at), rtol=1e-12, atol=1e-11
        )  # rounding
        np.testing.assert_allclose(np.triu(np.array(matrix)), upper, rtol=1e-12, atol=1e-12)  # rounding


def test_robots_are_drawn_from_their_number_alone():
    first = robot_file("drawn_3")
    texts = [path.read_bytes() for path in (first, first.with_suffix(".urdf"))]
    for path in (first, first.with_suffix(".urdf")):
        path.unlink()
    again = robot_file("drawn_3")
    assert [path.read_bytes() for path in (again, again.with_suffix(".urdf"))] == texts
    exact, loose = read_robot(robot_file("drawn_3_exact")), read_robot(robot_file("drawn_3_loose"))
    np.testing.assert_array_equal(exact.stiffness, loose.stiffness)  # they differ by what they claim
    assert {len(read_robot(robot_file(f"drawn_{n}")).joints) for n in range(20)} == {1, 2, 3, 4}
    with pytest.raises(ValueError, match="drawn_12_loose"):
        robot_file("drawn_three")


def test_fixed_and_locked_joints_keep_their_mass(tmp_path):
    urdf = (ROBOTS / "crane.urdf").read_text()
    (tmp_path / "crane.urdf").write_text(urdf)
    yaml = CRANE.read_text().split("  elbow")[0] + "lock: [elbow]\n"
    (tmp_path / "one.yaml").write_text(yaml)
    robot = read_robot(tmp_path / "one.yaml")
    model = pin.buildModelFromUrdf(str(ROBOTS / "crane.urdf"))
    reduced = pin.buildReducedModel(model, [model.getJointId("elbow")], np.zeros(2))
    assert robot.joints == ("shoulder",)
    assert robot.bodies[0].mass == pytest.approx(reduced.inertias[1].mass)
    np.testing.assert_allclose(robot.bodies[0].com, reduced.inertias[1].lever, atol=1e-12)
    np.testing.assert_allclose(robot.bodies[0].inertia, reduced.inertias[1].inertia, atol=1e-12)


def test_smooth_motion_converges_to_an_independent_solver():
    robot = read_robot(GIMBAL)
    effects = [
        Planted("hardening_spring", "tilt", {"cubic": 2e5}),
        Planted("transmission_error", "pan", {"amplitude": 0.002, "cycles": 16}),
        Planted("cogging", "twist", {"amplitude": 0.3, "cycles": 12, "phase": 0.5}),
        Planted("cable_spring", "pan", {"stiffness": 9.0, "rest": 0.2}),
        Planted("motor_viscous_friction", "tilt", {"coefficient": 3.0}),
    ]
    model = pin.buildModelFromUrdf(str(ROBOTS / "gimbal.urdf"))
    data, u = model.createData(), np.array([3.0, 4.0, 0.6])

    def slope(t, x):
        q, dq, th, w = x.reshape(4, 3)
        e = th - q + np.array([0.002 * np.sin(16 * th[0]), 0, 0])
        spring = robot.stiffness * e + robot.damping * (w - dq) + np.array([0, 2e5 * e[1] ** 3, 0])
        link = spring + np.array([9.0 * (0.2 - q[0]), 0, 0])
        drive = u + np.array([0, 0, 0.3 * np.sin(12 * th[2] + 0.5)]) - np.array([0, 3.0 * w[1], 0])
        dw = (drive - spring - robot.motor_damping * w) / robot.motor_inertia
        return np.concatenate([dq, pin.aba(model, data, q, dq, link), w, dw])

    x0 = np.concatenate([[0.1, -0.2, 0.3], np.zeros(3), [0.12, -0.18, 0.28], [0.5, 0, -0.5]])
    exact = solve_ivp(slope, (0, 1), x0, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    ours = run(robot, effects, x0, u, 1.0)[-1, :12]
    np.testing.assert_allclose(ours, exact, atol=1e-8)  # order 4 at 5 kHz leaves about 1e-10


def test_finer_steps_change_nothing_between_located_events(monkeypatch):
    effects = [
        Planted("stribeck_friction", JOINT, {"level": 3.0, "static_extra": 2.0, "velocity": 0.06}),
        Planted("link_coulomb_friction", JOINT, {"level": 1.5}),
        Planted("backlash", JOINT, {"gap": 0.006}),
    ]
    coarse = plant(LEVER, effects, "slow", 3, 4, PERFECT)
    monkeypatch.setattr(simulate, "STEP_RATE", 20000.0)
    fine = plant(LEVER, effects, "slow", 3, 4, PERFECT)
    for channel in ("q", "theta"):
        gap = np.abs(coarse.true[channel] - fine.true[channel]).max()
        assert gap < 1e-7  # a hundredth of the encoders' noise


def test_dry_friction_sticks_without_creep():
    robot = read_robot(LEVER)
    held = lever_gravity(0.2)
    planted = Planted("motor_coulomb_friction", JOINT, {"level": 3.0})
    theta = 0.2 + held / robot.stiffness[0]
    states = run(robot, [planted], [0.2, 0, theta, 0], [held + 2.9], 1.0)
    assert np.abs(states[:, 2] - theta).max() == 0.0  # the law is a set: below the level nothing moves
    states = run(robot, [planted], [0.2, 0, theta, 0], [held + 3.1], 1.0)
    assert states[-1, 2] > theta + 1e-3


def test_static_friction_holds_more_than_sliding_friction():
    robot, held = read_robot(LEVER), lever_gravity(0.2)
    theta = 0.2 + held / robot.stiffness[0]
    stribeck = Planted("stribeck_friction", JOINT, {"level": 2.0, "static_extra": 1.0, "velocity": 0.02})
    coulomb = Planted("motor_coulomb_friction", JOINT, {"level": 3.0})
    start = [0.2, 0, theta, 0]
    assert np.abs(run(robot, [stribeck], start, [held + 2.9], 0.5)[:, 3]).max() == 0.0
    jumped = run(robot, [stribeck], start, [held + 3.1], 0.5)[-1, 2] - theta
    crept = run(robot, [coulomb], start, [held + 3.1], 0.5)[-1, 2] - theta
    assert jumped > 3 * crept > 0


@pytest.mark.parametrize(("torque", "moves"), [(1.9, False), (2.1, True), (-3.9, False), (-4.1, True)])
def test_each_direction_has_its_own_level(torque, moves):
    robot, held = read_robot(LEVER), lever_gravity(0.2)
    planted = Planted("asymmetric_friction", JOINT, {"level_positive": 2.0, "level_negative": 4.0})
    states = run(robot, [planted], [0.2, 0, 0.2 + held / robot.stiffness[0], 0], [held + torque], 0.3)
    assert (np.abs(states[:, 3]).max() > 0) == moves


def test_a_caught_motor_rests_exactly():
    robot, held = read_robot(LEVER), lever_gravity(0.2)
    planted = Planted("motor_coulomb_friction", JOINT, {"level": 30.0})
    states = run(robot, [planted], [0.2, 0, 0.2 + held / robot.stiffness[0], 1.0], [held], 0.5)
    assert states[100, 2] > states[0, 2] + 1e-3
    assert np.ptp(states[1000:, 2]) == 0.0


def test_a_stuck_link_holds_while_its_neighbours_move():
    robot = read_robot(GIMBAL)
    planted = Planted("link_coulomb_friction", "tilt", {"level": 40.0})
    states = run(robot, [planted], np.zeros(12), [6.0, 0.0, 1.0], 0.5)
    assert np.abs(states[:, 1]).max() == 0.0
    assert min(np.abs(states[:, 0]).max(), np.abs(states[:, 2]).max()) > 0.01


@pytest.mark.parametrize(
    "effects",
    [
        [],
        [
            Planted("motor_coulomb_friction", "elbow", {"level": 1.5}),
            Planted("backlash", "elbow", {"gap": 0.01}),
        ],
        [
            Planted("link_coulomb_friction", "elbow", {"level": 1.0}),
            Planted("load_friction", "shoulder", {"coefficient": 0.1}),
        ],
    ],
)
def test_a_passive_machine_never_gains_energy(effects):
    robot = read_robot(CRANE)
    model = pin.buildModelFromUrdf(str(ROBOTS / "crane.urdf"))
    data = model.createData()
    gap = np.array([0.0, 0.01 if any(p.effect == "backlash" for p in effects) else 0.0])
    states = run(robot, effects, [0.5, -0.4, 0, 0, 0.52, -0.43, 0, 0], [0, 0], 1.5)

    def energy(x):
        q, dq, theta, w, _ = x.reshape(5, 2)
        stretch = np.maximum(np.abs(theta - q) - gap / 2, 0)
        motors = 0.5 * robot.motor_inertia @ w**2 + 0.5 * robot.stiffness @ stretch**2
        return (
            motors + pin.computeKineticEnergy(model, data, q, dq) + pin.computePotentialEnergy(model, data, q)
        )

    energies = np.array([energy(x) for x in states])
    assert energies[0] - energies[-1] > 0.5
    # order 4 at 5 kHz leaves about 1e-9 J a step; a wrong sign anywhere gains 1e-3 J or more
    assert np.diff(energies).max() < 1e-7
