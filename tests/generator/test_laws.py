"""Every law of the table, evaluated at a state where its closed form is known."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planting.cases import usual_effect
from planting.machine.by_hand import (
    JOINT,
    LEVER,
    lever,
    lever_gravity,
    lever_inertia,
    lever_state,
    rate_of,
    spring,
)
from planting.machine.laws import CATALOGUE, Equations, Planted, _tilted
from planting.robots import read_robot


def test_a_healthy_lever_has_only_its_nominal_torques():
    link, motor, torque, dz = lever()
    assert (link, motor, dz) == (pytest.approx(0, abs=1e-11), pytest.approx(0, abs=1e-11), 0)
    assert torque == pytest.approx(spring())


@pytest.mark.parametrize(
    ("effect", "parameters", "w", "expected"),
    [
        ("cogging", {"amplitude": 1.5, "cycles": 18, "phase": 0.4}, 0.9, 1.5 * np.sin(18 * 0.33 + 0.4)),
        ("motor_viscous_friction", {"coefficient": 3.0}, 0.9, -2.7),
        ("motor_coulomb_friction", {"level": 2.0}, 0.9, -2.0),
        ("motor_coulomb_friction", {"level": 2.0}, -0.9, 2.0),
        ("asymmetric_friction", {"level_positive": 2.0, "level_negative": 3.0}, 0.9, -2.0),
        ("asymmetric_friction", {"level_positive": 2.0, "level_negative": 3.0}, -0.9, 3.0),
        ("stribeck_friction", {"level": 2, "static_extra": 1, "velocity": 0.1}, 0.1, -2 - np.exp(-1)),
        ("stribeck_friction", {"level": 2, "static_extra": 1, "velocity": 0.1}, -0.9, 2.0),
        ("friction_drift", {"level": 2.0, "time_constant": 3.0}, 0.9, -2 * np.exp(-1.5 / 3)),
    ],
)
def test_motor_laws(effect, parameters, w, expected):
    dry = effect not in ("cogging", "motor_viscous_friction")
    planted = Planted(effect, JOINT, parameters)
    _, motor, _, _ = lever(planted, modes=[np.sign(w)] if dry else [], t=1.5, dtheta=w)
    assert motor == pytest.approx(expected, abs=1e-10)  # rounding


def test_load_friction_follows_the_whole_spring_torque():
    _, motor, torque, _ = lever(Planted("load_friction", JOINT, {"coefficient": 0.2}), modes=[1])
    assert motor == pytest.approx(-0.2 * torque)
    _, motor, torque, _ = lever(Planted("load_friction", JOINT, {"coefficient": 0.2}), modes=[1], theta=0.25)
    assert torque < 0 and motor == pytest.approx(0.2 * torque)


def test_motor_inertia_scales_b():
    robot = read_robot(LEVER)
    plain, _ = rate_of(robot, [], lever_state(), np.array([7.0]))
    heavy, _ = rate_of(
        robot, [Planted("motor_inertia", JOINT, {"scale": 0.25})], lever_state(), np.array([7.0])
    )
    assert heavy[3] == pytest.approx(plain[3] / 1.25)


@pytest.mark.parametrize(
    ("effect", "parameters", "modes", "expected"),
    [
        ("spring_stiffness", {"scale": 0.2}, [], lambda k, d: 1.2 * k * 0.03 + d * 0.5),
        ("spring_damping", {"scale": 0.2}, [], lambda k, d: k * 0.03 + 1.2 * d * 0.5),
        ("hardening_spring", {"cubic": 1e5}, [], lambda k, d: k * 0.03 + d * 0.5 + 1e5 * 0.03**3),
        ("backlash", {"gap": 0.02}, [1], lambda k, d: k * 0.02 + d * 0.5),
        ("backlash", {"gap": 0.08}, [0], lambda k, d: 0.0),
        ("spring_preload", {"torque": -1.5}, [], lambda k, d: k * 0.03 + d * 0.5 - 1.5),
        (
            "transmission_error",
            {"amplitude": 0.002, "cycles": 16, "phase": 0.3},
            [],
            lambda k, d: k * (0.03 + 0.002 * np.sin(16 * 0.33 + 0.3)) + d * 0.5,
        ),
        ("spring_hysteresis", {"level": 1.0, "scale": 0.003}, [], lambda k, d: k * 0.03 + d * 0.5 + 0.4),
    ],
)
def test_transmission_laws(effect, parameters, modes, expected):
    z = 0.4 if effect == "spring_hysteresis" else 0.0
    robot = read_robot(LEVER)
    _, _, torque, dz = lever(Planted(effect, JOINT, parameters), modes=modes, z=z)
    assert torque == pytest.approx(expected(robot.stiffness[0], robot.damping[0]), abs=1e-10)  # rounding
    if effect == "spring_hysteresis":
        assert dz == pytest.approx(0.5 * 1.0 / 0.003 * (1 - 0.4 / 1.0))
        _, _, _, back = lever(Planted(effect, JOINT, parameters), z=z, dtheta=-0.1)  # dphi = -0.5
        assert back == pytest.approx(-0.5 * 1.0 / 0.003 * (1 + 0.4 / 1.0))


@pytest.mark.parametrize(
    ("effect", "parameters", "expected"),
    [
        ("link_viscous_friction", {"coefficient": 1.5}, -1.5 * 0.4),
        ("link_coulomb_friction", {"level": 1.5}, -1.5),
        ("cable_spring", {"stiffness": 8.0, "rest": -0.1}, 8.0 * (-0.1 - 0.3)),
        ("end_stop", {"position": 0.25, "stiffness": 900.0}, -900 * 0.05),
        ("end_stop", {"position": 0.35, "stiffness": 900.0}, 0.0),
        ("end_stop", {"position": -0.25, "stiffness": 900.0}, 0.0),
    ],
)
def test_link_laws(effect, parameters, expected):
    modes = [1] if effect == "link_coulomb_friction" else []
    link, *_ = lever(Planted(effect, JOINT, parameters), modes=modes)
    assert link == pytest.approx(expected, abs=1e-10)  # rounding


def test_a_lower_end_stop_pushes_up():
    link, *_ = lever(Planted("end_stop", JOINT, {"position": -0.25, "stiffness": 900.0}), q=-0.3)
    assert link == pytest.approx(900 * 0.05)


def test_payload_adds_weight_and_inertia():
    robot, mass, r = read_robot(LEVER), 0.7, np.array([0.05, 0.3, -0.4])
    planted = Planted("payload", JOINT, {"mass": mass, "position": list(r)})
    x = lever_state(dq=0.0)
    rate, torque = rate_of(robot, [planted], x, np.array([7.0]))
    gravity, inertia = lever_gravity(0.3), lever_inertia()
    gravity += -mass * 9.81 * (r[0] * np.cos(0.3) + r[2] * np.sin(0.3))
    inertia += mass * (r[0] ** 2 + r[2] ** 2)
    assert rate[1] == pytest.approx((torque[0] - gravity) / inertia)


def test_base_tilt_turns_gravity():
    pitch = 0.06
    link, *_ = lever(Planted("base_tilt", None, {"roll": 0.0, "pitch": pitch}), dq=0.0)
    # Ry(pitch)^T g is what a base turned by +pitch sees; the lever turns about y, so this is q + pitch
    assert link == pytest.approx(lever_gravity(0.3) - lever_gravity(0.3 + pitch))
    rolled, *_ = lever(Planted("base_tilt", None, {"roll": 0.3, "pitch": 0.0}), dq=0.0)
    assert rolled == pytest.approx(lever_gravity(0.3) - lever_gravity(0.3, roll=0.3))


def test_roll_comes_before_pitch():
    turned = _tilted(0.3, 0.2, np.array([0.0, 0.0, -9.81]))
    by_hand = 9.81 * np.array([np.cos(0.3) * np.sin(0.2), -np.sin(0.3), -np.cos(0.3) * np.cos(0.2)])
    np.testing.assert_allclose(turned, by_hand, atol=1e-12)


def test_a_closed_gate_removes_every_law():
    for effect in CATALOGUE:
        if effect in ("torque_saturation", "end_stop"):
            continue  # no usual size; the stop has its own gate test in the recordings below
        planted = usual_effect(effect, "lever", JOINT, np.random.default_rng(0))
        switched = bool(Equations(read_robot(LEVER), [planted]).switches)
        link, motor, torque, dz = lever(planted, modes=[1] if switched else [], gates=np.zeros(1))
        assert abs(link) + abs(motor) + abs(dz) < 1e-10, effect  # rounding
        assert torque == pytest.approx(spring()), effect


def test_hysteresis_loop_has_dahls_area():
    level, scale, amplitude = 1.2, 0.004, 0.01
    e = Equations(read_robot(LEVER), [Planted("spring_hysteresis", JOINT, {"level": level, "scale": scale})])
    dz = ca.Function("dz", [e.x, e.u, e.modes, e.gates, e.t], [e.rate[4]])

    def slope(phi_rate, z):
        return float(dz([0, 0, 0, phi_rate, z], [0], [], [1], 0))

    z, step, area = 0.0, amplitude / 400, 0.0
    for direction, lap in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        for _ in range(400 if (direction, lap) == (1, 0) else 800):
            middle = z + step / 2 * slope(direction, z)
            ahead = z + step * slope(direction, middle)
            area += lap * direction * step * (z + ahead) / 2
            z = ahead
    memory = np.exp(-2 * amplitude / scale)
    expected = 2 * level * (2 * amplitude - 2 * scale * (1 - memory) / (1 + memory))
    assert area == pytest.approx(expected, rel=2e-3)  # the first loop starts 1 % off the steady one
