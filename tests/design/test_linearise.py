"""Linearisation: closed forms, Pinocchio against CasADi, differences of the nonlinear rates, and kinks."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, one_of_each
from support.robots.elastic_ur5 import ur5

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.design.linear_model import LinearModel
from flexjoint.design.linearise import linearise, symbolic_linearisation
from flexjoint.design.quasilinear import describing, has_kinks
from flexjoint.effects import Planned, Signals, effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.robot.robot import Robot, load

WIDTH = 0.2
# the pendulum of arms.py: inertia about its axis, gravity's slope hanging, and its drive
M, G = 0.05 + 2.4 * 0.26**2, 2.4 * 9.81 * 0.26
K, D, B, D_M = 340.0, 0.9, 0.12, 4.0


def moving(model: FlexibleJointModel, seed: int = 0) -> tuple[State, np.ndarray]:
    """A state at random, springs deflected, and motor torques."""
    random = np.random.default_rng(seed)
    state = model.rest(model.body.integrate(model.body.neutral, random.uniform(-1.2, 1.2, model.nv)))
    state.v = random.normal(size=model.nv)
    state.theta = state.theta + random.uniform(0.02, 0.05, model.nf)
    state.dtheta = random.uniform(0.3, 1.0, model.nf)
    state.z = 0.1 * random.normal(size=model.nz)
    return state, random.uniform(1.0, 8.0, len(model.joints))


def rates(model: FlexibleJointModel, at: State, step: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """All rates but that of the positions, at a state moved by a tangent step."""
    nv, nf = model.nv, model.nf
    moved = model.rest(model.body.integrate(at.q, step[:nv]))
    moved.v, moved.theta = at.v + step[nv : 2 * nv], at.theta + step[2 * nv : 2 * nv + nf]
    moved.dtheta, moved.z = at.dtheta + step[2 * nv + nf : 2 * nv + 2 * nf], at.z + step[2 * nv + 2 * nf :]
    r = model.rates(moved, tau, WIDTH)
    return np.concatenate([r.acc, r.dtheta, r.ddtheta, r.dz])


def agree(model: FlexibleJointModel) -> LinearModel:
    """Numeric against symbolic, and against central differences; the numeric one."""
    state, tau = moving(model)
    both = [
        linearise(model, state, tau, nonsmooth="slope", width=WIDTH, method=method)  # type: ignore[arg-type]
        for method in ("numeric", "symbolic")
    ]
    for name in ("A", "B", "C", "D", "drift"):
        numeric, symbolic = (getattr(linear, name) for linear in both)
        # asked for is 1e-9; what differs is rounding
        scale = max(float(np.max(np.abs(numeric))), 1.0)
        np.testing.assert_allclose(numeric, symbolic, rtol=0.0, atol=1e-11 * scale, err_msg=name)
    linear, size = both[0], len(both[0].states)
    step = 1e-6
    columns = [
        (rates(model, state, step * e, tau) - rates(model, state, -step * e, tau)) / (2 * step)
        for e in np.eye(size)
    ]
    forces = [
        (
            rates(model, state, np.zeros(size), tau + step * e)
            - rates(model, state, np.zeros(size), tau - step * e)
        )
        / (2 * step)
        for e in np.eye(len(tau))
    ]
    # differences: rounding of 1e-16 / 1e-6 in rates, relative, and the square of the step
    scale = float(np.max(np.abs(linear.A)))
    np.testing.assert_allclose(linear.A[model.nv :], np.array(columns).T, rtol=0, atol=3e-9 * scale)
    np.testing.assert_allclose(linear.B[model.nv :], np.array(forces).T, rtol=0, atol=1e-6)
    return linear


# --- against other derivatives ----------------------------------------------------------------------------
ROBOTS = {
    "rrbot": lambda: load("rrbot"),
    "kr300": lambda: load("kr300"),
    "ur5": ur5,
    "floating": lambda: make(SPATIAL, base="floating"),
    "rigid_and_passive": lambda: make(SPATIAL, {"roll": {"stiffness": math.inf}, "yaw": None}),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_numeric_symbolic_and_differences_agree(name: str) -> None:
    robot: Robot = ROBOTS[name]()
    agree(FlexibleJointModel(robot))


@pytest.mark.parametrize("planned", one_of_each("roll"), ids=lambda planned: planned.effect.name)
def test_every_effect_agrees(planned: Planned) -> None:
    agree(FlexibleJointModel(make(SPATIAL), [planned]))


def test_a_free_flyer_that_moves_is_measured_in_its_frame() -> None:
    """d(dq)/dt of the deviation: how it is carried along, by Pinocchio's own derivative of integrate."""
    model = FlexibleJointModel(make(PENDULUM, base="floating"))
    state, tau = moving(model)
    linear = linearise(model, state, tau)
    h, pin_model = 1e-6, model.robot.model
    ahead, back = (
        pin.dIntegrate(pin_model, state.q, s * h * state.v, pin.ArgumentPosition.ARG0) for s in (1, -1)
    )
    np.testing.assert_allclose(linear.A[:7, :7], (ahead - back) / (2 * h), atol=1e-8)  # of differences
    np.testing.assert_array_equal(linear.A[:7, 7:14], np.eye(7))


def test_the_symbolic_function_is_of_state_and_torque() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    function = symbolic_linearisation(model)
    state, tau = moving(model)
    A = function(model.pack(state), tau)[0].full()
    np.testing.assert_allclose(A, linearise(model, state, tau).A, atol=1e-9)
    x = ca.SX.sym("x", model.nx)
    assert ca.jacobian(function(x, tau)[0], x).nnz() > 0  # a part of other expressions


# --- closed forms -----------------------------------------------------------------------------------------
def test_a_pendulum_has_the_poles_and_zeros_of_its_equation() -> None:
    """M ddq + G q = K (theta - q) + D (dtheta - dq); B ddtheta + D_m dtheta = tau - that."""
    linear = linearise(FlexibleJointModel(make(PENDULUM), []))
    spring, link, motor = np.array([D, K]), np.array([M, D, K + G]), np.array([B, D_M + D, K])
    equation = np.polysub(np.polymul(link, motor), np.polymul(spring, spring))
    np.testing.assert_allclose(np.sort_complex(linear.poles), np.sort_complex(np.roots(equation)), rtol=1e-9)
    zeros = linear.to_control()["theta_joint", "tau_m_joint"].zeros()
    np.testing.assert_allclose(np.sort_complex(zeros), np.sort_complex(np.roots(link)), rtol=1e-9)


def test_resonance_and_antiresonance_without_gravity() -> None:
    bare = make(PENDULUM, {"joint": {"damping": 0.0, "motor_damping": 0.0}}, gravity=(0.0, 0.0, 0.0))
    linear = linearise(FlexibleJointModel(bare, []))
    resonance, antiresonance = math.sqrt(K * (1.0 / M + 1.0 / B)), math.sqrt(K / M)
    assert np.max(linear.poles.imag) == pytest.approx(resonance, rel=1e-9)
    zeros = linear.to_control()["theta_joint", "tau_m_joint"].zeros()
    assert np.max(zeros.imag) == pytest.approx(antiresonance, rel=1e-9)


def test_a_pose_is_an_equilibrium() -> None:
    model = FlexibleJointModel(ur5())
    q = np.array([0.3, -1.0, 1.2, -0.5, 0.8, 0.1])
    linear = linearise(model, q)
    # rest of springs of 12 kN m/rad: rounding of theta - q times K / B
    np.testing.assert_allclose(linear.drift, 0.0, atol=1e-9)
    assert linear.states[0] == "q.shoulder_pan_joint" and linear.states[-1] == "dtheta.wrist_3_joint"
    assert linear.inputs[0] == "tau_m.shoulder_pan_joint" and linear.outputs[4] == "tau_t.shoulder_pan_joint"


def test_sensors_and_dead_times_are_in_the_outputs() -> None:
    effects = [
        effect("torque_sensor_gain", "joint", gain=0.1),
        effect("sensor_delay", "joint", delay=3e-3, channel="q"),
        effect("torque_delay", "joint", delay=2e-3),
    ]
    linear = linearise(FlexibleJointModel(make(PENDULUM, sensing_delay=1e-3), effects))
    late = dict(zip(linear.outputs, linear.output_delay, strict=True))
    assert late["q.joint"] == pytest.approx(4e-3) and late["theta.joint"] == pytest.approx(1e-3)
    assert linear.input_delay == pytest.approx([2e-3])
    row = linear.C[linear.outputs.index("tau_t.joint")]
    np.testing.assert_allclose(row, 1.1 * np.array([-K, -D, K, D]), rtol=1e-12)


# --- kinks ------------------------------------------------------------------------------------------------
def test_kinks_are_found_in_the_laws() -> None:
    smooth = {
        "cable_spring",
        "cogging",
        "current_lag",
        "hardening_spring",
        "joint_coupling",
        "payload",
        "periodic_disturbance",
        "spring_creep",
        "spring_stiffness",
        "torque_gain",
    }
    rough = {
        "backlash",
        "dahl_friction",
        "end_stop",
        "load_friction",
        "quadratic_drag",
        "spring_hysteresis",
        "torque_saturation",
        "torque_speed_limit",
    }
    found = {planned.effect.name for planned in one_of_each("joint") if has_kinks(planned)}
    assert rough <= found and not smooth & found


FRICTION = effect("motor_coulomb_friction", "joint", level=2.4)
PLAY = effect("backlash", "joint", gap=0.01)


def test_kinks_need_a_choice() -> None:
    model = FlexibleJointModel(make(PENDULUM), [FRICTION, PLAY])
    with pytest.raises(ModelError, match=r"motor_coulomb_friction on joint, backlash on joint.*'describing'"):
        linearise(model)
    with pytest.raises(ModelError, match="no slope at rest"):
        linearise(model, nonsmooth="slope")
    with pytest.raises(ModelError, match="amplitude of dtheta"):
        linearise(model, nonsmooth="describing", amplitude={"phi": 0.01})
    with pytest.raises(UnknownNameError, match="dtheta"):
        linearise(model, nonsmooth="describing", amplitude={"speed": 0.01})
    with pytest.raises(UnknownNameError, match="describing"):
        linearise(model, nonsmooth="smooth")  # type: ignore[arg-type]


def test_smoothed_friction_and_a_gap_at_rest_mislead_a_design() -> None:
    """The first of the traps: tanh friction is a huge damper at rest, and a gap takes the spring away. Both
    show in closed form: the slope's robot is a free pendulum beside a motor that hardly turns; the true one
    swings on its spring."""
    model = FlexibleJointModel(make(PENDULUM), [FRICTION, PLAY])
    width = 5e-3
    slope = np.sort_complex(linearise(model, nonsmooth="slope", width=width).poles)
    damper = D_M + 2.4 / width
    free = [-damper / B, -1j * math.sqrt(G / M), 0.0, 1j * math.sqrt(G / M)]
    np.testing.assert_allclose(slope, np.sort_complex(free), atol=1e-6)

    null = linearise(model, nonsmooth="null")
    np.testing.assert_array_equal(null.A, linearise(FlexibleJointModel(make(PENDULUM), [])).A)
    assert np.max(null.poles.imag) > 4.0 * math.sqrt(G / M)

    # a swing well beyond gap and breakaway: nearly the robot without them
    swing = {"dtheta": 100.0, "phi": 5.0}
    far = linearise(model, nonsmooth="describing", amplitude=swing)
    worst = [np.min(np.abs(far.poles - pole) / np.abs(pole)) for pole in null.poles]
    assert max(worst) < 0.02  # what is left: 4 * 2.4 / (100 pi) of a damping of 4


def of_backlash(gap: float, amplitude: float) -> float:
    """Gelb and Vander Velde 1968, dead zone of half-width gap / 2."""
    ratio = 0.5 * gap / amplitude
    if ratio >= 1.0:
        return 0.0
    return 1.0 - 2.0 / math.pi * (math.asin(ratio) + ratio * math.sqrt(1.0 - ratio**2))


@pytest.mark.parametrize("amplitude", [0.004, 0.006, 0.02, 1.0])
def test_describing_function_of_a_play(amplitude: float) -> None:
    linear = linearise(
        FlexibleJointModel(make(PENDULUM), [PLAY]), nonsmooth="describing", amplitude={"phi": amplitude}
    )
    gain = of_backlash(0.01, amplitude)
    row = linear.A[linear.states.index("dtheta.joint")] * B
    # 20000 points of a cycle: the edge of the gap falls between two of them
    np.testing.assert_allclose(row, [K * gain, D * gain, -K * gain, -D * gain - D_M], atol=1e-5 * K)


def test_a_loaded_spring_does_not_see_its_play() -> None:
    model = FlexibleJointModel(make(PENDULUM), [PLAY])
    plain = linearise(FlexibleJointModel(make(PENDULUM), []), np.array([0.8])).A
    for choice in ("slope", "describing"):
        # type: ignore[arg-type]
        A = linearise(model, np.array([0.8]), nonsmooth=choice, amplitude={"phi": 1e-3}).A
        np.testing.assert_allclose(A, plain, atol=1e-5 * np.max(np.abs(plain)))


def test_describing_functions_of_friction_drag_and_saturation() -> None:
    effects = [
        FRICTION,
        effect("quadratic_drag", "joint", coefficient=0.7),
        effect("torque_saturation", "joint", limit=9.0),
    ]
    swing = {"dtheta": 1.5, "dq": 2.0, "tau_m": 30.0}
    linear = linearise(FlexibleJointModel(make(PENDULUM), effects), nonsmooth="describing", amplitude=swing)
    plain = linearise(FlexibleJointModel(make(PENDULUM), []))
    motor, link = linear.states.index("dtheta.joint"), linear.states.index("dq.joint")
    change = linear.A - plain.A
    assert change[motor, motor] * B == pytest.approx(-4.0 * 2.4 / (math.pi * 1.5), rel=1e-6)
    assert change[link, link] * M == pytest.approx(-8.0 / (3.0 * math.pi) * 0.7 * 2.0, rel=1e-6)
    passed = 1.0 - of_backlash(18.0, 30.0)  # what a saturation passes is what a dead zone keeps back
    assert linear.B[motor, 0] * B == pytest.approx(passed, rel=1e-5)


@pytest.mark.parametrize("swing", [1e-3, 0.01, 0.3])
def test_a_hysteresis_keeps_its_first_harmonic(swing: float) -> None:
    """The lag in place of the Dahl law, against an integration of the law to its periodic solution."""
    omega, level, scale = 7.0, 1.3, 5e-3
    planned = effect("spring_hysteresis", "joint", level=level, scale=scale)
    lag = describing(planned, Signals(), {"phi": swing, "dphi": swing * omega})
    gain = lag.effect.rate(Signals(dphi=1.0), lag.p, 0.0)
    decay = -lag.effect.rate(Signals(), lag.p, 1.0)
    got = gain * 1j * omega / (1j * omega + decay)

    def law(t: float, z: np.ndarray) -> np.ndarray:
        speed = swing * omega * math.cos(omega * t)
        return (speed * level - z * abs(speed)) / scale

    period, cycles = 2.0 * math.pi / omega, 12
    times = period * (cycles - 1 + np.arange(4000) / 4000)
    z = solve_ivp(
        law, (0.0, period * cycles), [0.0], t_eval=times, rtol=1e-8, atol=1e-10, max_step=period / 200
    ).y[0]
    harmonic = 2.0 * np.mean(z * np.sin(omega * times)) + 2.0j * np.mean(z * np.cos(omega * times))
    # the smallest swing has shed its start but for exp(-12 * 4 * 0.2) of it
    assert abs(got - harmonic / swing) < 2e-4 * abs(got) + 1e-4 * level / scale


def test_a_wrong_point_is_refused() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    with pytest.raises(ModelError, match=r"\(2,\) finite"):
        linearise(model, np.zeros(3))
    with pytest.raises(ModelError, match=r"\(2,\) motor torques"):
        linearise(model, np.zeros(2), np.zeros(1))
    with pytest.raises(UnknownNameError, match="numeric"):
        linearise(model, method="exact")  # type: ignore[arg-type]
