"""Where stability ends, in closed form; and the static law against a robot at rest."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from control.pzmap import PoleZeroData
from support.robots.arms import PENDULUM, PLANAR, make
from support.thorough import thorough

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.design.feedback import Gains, close_loop
from flexjoint.design.linearise import linearise
from flexjoint.design.stability_limits import (
    FIXED_STEP,
    longest_period,
    scheme_limits,
    simulated,
    stiffness_locus,
    with_stiffness,
)
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.model.statics.static_law import static_error
from flexjoint.simulation.controllers import MotorPD
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop

M = 0.05 + 2.4 * 0.26**2
K, B = 340.0, 0.12
WEIGHTLESS = {"gravity": (0.0, 0.0, 0.0)}
UNDAMPED = {"joint": {"damping": 0.0, "motor_damping": 0.0}}


@pytest.mark.parametrize(("kp", "kd"), [(60.0, 0.6), (60.0, 20.0)])
def test_longest_period_of_a_rigid_joint(kp: float, kd: float) -> None:
    """A double integrator under sampled PD is stable while kd T < 2 J and kp T < 2 kd (Jury's test)."""
    rigid = make(PENDULUM, {"joint": {"stiffness": math.inf, "motor_damping": 0.0}}, **WEIGHTLESS)
    linear = linearise(FlexibleJointModel(rigid, []))
    gains = Gains.motor_pd(rigid, np.array([kp]), np.array([kd]))
    expected = min(2.0 * (M + B) / kd, 2.0 * kd / kp)
    assert longest_period(linear, gains) == pytest.approx(expected, rel=1e-5)  # of the bisection
    assert longest_period(linear, Gains.motor_pd(rigid, np.array([-1.0]), np.array([kd]))) == 0.0


@thorough
def test_a_late_command_of_a_damper_may_tick_more_slowly() -> None:
    """v+ = v - a ((T - d) v + d v before): -1 is a root at T = 2 / a + 2 d."""
    rigid = make(PENDULUM, {"joint": {"stiffness": math.inf, "motor_damping": 0.0}}, **WEIGHTLESS)
    linear = linearise(FlexibleJointModel(rigid, []))
    gains = Gains.motor_pd(rigid, np.array([1e-3]), np.array([20.0]))
    expected = 2.0 * (M + B) / 20.0 + 2.0 * 0.01
    assert longest_period(linear, gains, delay=0.01) == pytest.approx(expected, rel=1e-4)  # kp is not quite 0


def test_scheme_limits_of_an_undamped_spring() -> None:
    """Semi-implicit Euler is stable for omega h < 2, classical Runge-Kutta for omega h < 2 sqrt(2) (Hairer,
    Norsett and Wanner 1993), explicit Euler never."""
    bare = make(PENDULUM, UNDAMPED, **WEIGHTLESS)
    omega = math.sqrt(K * (1.0 / M + 1.0 / B))
    found = scheme_limits(FlexibleJointModel(bare, []), rate=500.0)
    # check_stability lets a mode grow by 1e-6 a step: its own allowance for rounding
    assert found["semi_implicit_euler"].period == pytest.approx(2.0 / omega, rel=1e-5)
    assert found["rk4"].period == pytest.approx(2.0 * math.sqrt(2.0) / omega, rel=1e-4)
    assert found["semi_implicit_euler"].stiffness == pytest.approx((2.0 * 500.0 / omega) ** 2, rel=1e-5)
    assert found["explicit_euler"].period < 1e-3 * found["rk4"].period
    assert math.isinf(found["linearly_implicit_midpoint"].stiffness)


@pytest.mark.parametrize("scheme", FIXED_STEP)
def test_the_poles_of_a_simulation(scheme: str) -> None:
    """A rigid joint under held torque, step by step: what each scheme makes of J dv = u."""
    h, kp, kd = 1e-3, 60.0, 20.0
    rigid = make(PENDULUM, {"joint": {"stiffness": math.inf, "motor_damping": 0.0}}, **WEIGHTLESS)
    gains = Gains.motor_pd(rigid, np.array([kp]), np.array([kd]))
    poles = close_loop(simulated(FlexibleJointModel(rigid, []), None, scheme), gains).poles
    a, b = h * kd / (M + B), h * h * kp / (M + B)
    # q+ = q + h v + share h^2 u, v+ = v + h u, under u = -(kp q + kd v) / J
    share = {"explicit_euler": 0.0, "semi_implicit_euler": 1.0, "kamedula2016": 1.0}.get(scheme, 0.5)
    expected = np.linalg.eigvals([[1.0 - share * b, h - share * h * a], [-b / h, 1.0 - a]])
    for pole in expected:
        assert np.min(np.abs(poles - pole)) < 1e-8  # of differences


def test_a_simulation_tends_to_the_robot() -> None:
    """Poles of the default scheme against the exact ones: the square of the step."""
    off = []
    for rate in (1000.0, 2000.0, 4000.0):
        model = FlexibleJointModel(make(PLANAR, rates={"physics": rate, "control": 1000.0}), [])
        exact = linearise(model, np.array([0.4, -0.7])).sampled(1000.0).poles
        poles = simulated(model, np.array([0.4, -0.7])).poles
        off.append(max(np.min(np.abs(poles - pole)) for pole in exact))
    np.testing.assert_allclose(np.log2(np.array(off[:-1]) / off[1:]), 2.0, atol=0.2)


def test_the_controller_counts_in_what_a_scheme_bears() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    gains = Gains.motor_pd(make(PENDULUM), np.array([1100.0]), np.array([12.0]))
    alone, closed = scheme_limits(model), scheme_limits(model, gains=gains)
    for scheme in ("semi_implicit_euler", "rk4"):
        assert 1.0 < closed[scheme].stiffness < alone[scheme].stiffness * (1.0 + 1e-6)
        assert closed[scheme].period == alone[scheme].period
    # a simulation a little stiffer than the limit diverges, a little softer one does not
    limit = closed["semi_implicit_euler"].stiffness
    for share, calm in ((0.97, True), (1.03, False)):
        stiff = FlexibleJointModel(with_stiffness(model.robot, share * limit), [])
        start = stiff.rest()
        start.dtheta = np.array([1e-6])
        still = {name: np.zeros((300, 1)) for name in ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")}
        tape = closed_loop(
            stiff, start, gains.law(stiff.robot), still, RunOptions(rate=1000.0, scheme="semi_implicit_euler")
        )
        speed = np.abs(tape.dtheta[:, 0])
        assert (np.max(speed[-50:]) < np.max(speed[:50])) == calm
    with pytest.raises(UnknownNameError, match="rk4"):
        scheme_limits(model, schemes=["rk5"])
    with pytest.raises(ModelError, match="whole multiple"):
        simulated(model, rate=1500.0)


def test_the_locus_over_stiffness_is_that_of_the_equation() -> None:
    values = np.geomspace(50.0, 5000.0, 7)
    bare = make(PENDULUM, UNDAMPED, **WEIGHTLESS)
    data = stiffness_locus(FlexibleJointModel(bare, []), values.tolist(), "joint")
    np.testing.assert_array_equal(data.gains, values)
    swing = np.max(data.loci.imag, axis=1)
    np.testing.assert_allclose(swing, np.sqrt(values * (1.0 / M + 1.0 / B)), rtol=1e-9)
    closed = stiffness_locus(
        FlexibleJointModel(make(PLANAR), []),
        [0.5, 1.0, 2.0],
        gains=Gains.motor_pd(make(PLANAR), np.full(2, 900.0), np.full(2, 9.0)),
    )
    assert closed.loci.shape == (3, 8) and np.all(closed.loci.real < 0.0)
    closed.plot()
    plt.close("all")
    assert isinstance(data, PoleZeroData)
    with pytest.raises(ModelError, match="increasing"):
        stiffness_locus(FlexibleJointModel(bare, []), [2.0, 1.0])
    with pytest.raises(UnknownNameError, match="joint"):
        with_stiffness(bare, 100.0, "elbow")


# --- static law -------------------------------------------------------------------------------------------
KP = np.array([900.0, 400.0])
STIFFNESS = np.array([800.0, 420.0])


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0], ids=["no g", "a part of g", "g"])
def test_a_robot_comes_to_rest_where_the_static_law_says(share: float) -> None:
    robot = make(PLANAR)
    model = FlexibleJointModel(robot, [])
    q_d = np.array([0.9, -0.5])
    command = share * equilibrium(model, q_d).tau[0]
    theta_d = q_d + command / STIFFNESS
    state = model.rest(q_d)
    state.theta = theta_d.copy()
    rows = {"q_ref": q_d, "theta_ref": theta_d, "dtheta_ref": np.zeros(2), "tau_ff": command}
    references = {name: np.tile(row, (4000, 1)) for name, row in rows.items()}
    law = MotorPD(KP, np.array([40.0, 20.0]), np.full(2, np.inf))
    tape = closed_loop(model, state, law, references, RunOptions(rate=1000.0))
    assert np.max(np.abs(tape.v[-1])) < 1e-8  # 4 s of it: at rest
    load = equilibrium(model, tape.q[-1]).tau[0]
    error = static_error(load, command, KP, STIFFNESS)
    np.testing.assert_allclose(tape.q[-1] - q_d, error.link, atol=1e-8)
    np.testing.assert_allclose(tape.theta[-1] - theta_d, error.motor, atol=1e-8)
    np.testing.assert_allclose(tape.theta[-1] - tape.q[-1], error.deflection, atol=1e-8)
    assert (np.max(np.abs(error.link)) < 1e-12) == (share == 1.0)


def test_the_static_law_of_many_and_of_rigid_joints() -> None:
    error = static_error(np.full((5, 2), 3.0), 1.0, [100.0, 50.0], [math.inf, 200.0])
    np.testing.assert_allclose(error.link[2], [-2.0 / 100.0, -2.0 * (1.0 / 50.0 + 1.0 / 200.0)])
    np.testing.assert_array_equal(error.deflection[0], [0.0, 3.0 / 200.0])
    with pytest.raises(ModelError, match="kp"):
        static_error(1.0, 0.0, 0.0, 100.0)
