"""Where stability ends, in closed form; and the static law against a robot at rest."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from arms import PENDULUM, PLANAR, make
from control.pzmap import PoleZeroData

from flexjoint.clockwork import closed_loop
from flexjoint.control import MotorPD
from flexjoint.equilibrium import equilibrium
from flexjoint.errors import ModelError, UnknownNameError
from flexjoint.feedback import Gains
from flexjoint.limits import longest_period, scheme_limits, stiffness_locus, with_stiffness
from flexjoint.linearise import linearise
from flexjoint.model import FlexibleJointModel
from flexjoint.static_law import static_error

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
    assert longest_period(linear, gains) == pytest.approx(expected, rel=1e-6)
    assert longest_period(linear, Gains.motor_pd(rigid, np.array([-1.0]), np.array([kd]))) == 0.0


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
    tape = closed_loop(model, state, law, references, 1000.0)
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
