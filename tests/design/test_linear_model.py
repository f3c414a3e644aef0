"""The sampled linear model: exact hold and dead times, the simulator's own ticks, and python-control."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import control
import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, make

from flexjoint.core.errors import MissingExtraError, ModelError, UnknownNameError
from flexjoint.design.feedback import Gains, close_loop
from flexjoint.design.linear_model import LinearModel, zero_order_hold
from flexjoint.design.linearise import linearise
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.trajectory import Past

RATE = 500.0


def pendulum() -> LinearModel:
    return linearise(FlexibleJointModel(make(PENDULUM), []), np.array([0.4]))


def test_a_hold_is_that_of_python_control() -> None:
    sampled = pendulum().sampled(RATE)
    theirs = control.sample_system(pendulum().to_control(), 1.0 / RATE, "zoh")
    np.testing.assert_allclose(sampled.A, theirs.A, atol=1e-12)
    np.testing.assert_allclose(sampled.B, theirs.B, atol=1e-12)
    assert sampled.dt == 1.0 / RATE


@pytest.mark.parametrize("late_in", [0.0, 0.0007, 0.002, 0.0053])
@pytest.mark.parametrize("late_out", [0.0, 0.0011, 0.004, 0.0067])
def test_dead_times_are_exact(late_in: float, late_out: float) -> None:
    """Against steps of 0.1 ms, of which all dead times are multiples, with plain queues."""
    continuous = pendulum()
    outputs = len(continuous.outputs)
    late = np.zeros(outputs)
    late[0] = late_out  # q alone
    sampled = replace(continuous, input_delay=np.array([late_in]), output_delay=late).sampled(RATE)
    fine, per_tick, ticks = 1e-4, 20, 40
    phi, gamma = zero_order_hold(continuous.A, continuous.B, fine)
    commands = np.random.default_rng(1).normal(size=ticks)
    x, xs = np.zeros(4), []
    for k in range(ticks * per_tick):
        xs.append(x)
        sent = (k - round(late_in / fine)) // per_tick
        x = phi @ x + gamma[:, 0] * (commands[sent] if sent >= 0 else 0.0)
    state = np.zeros(len(sampled.states))
    for n in range(ticks):
        y = sampled.C @ state
        for i in range(outputs):
            k = n * per_tick - round(late[i] / fine)
            true = continuous.C[i] @ xs[k] if k >= 0 else 0.0
            assert y[i] == pytest.approx(true, abs=1e-9)  # torques of some N m
        state = sampled.A @ state + sampled.B[:, 0] * commands[n]


def test_the_simulator_ticks_as_the_sampled_model() -> None:
    """A small step of the simulated robot, dead times on command and sensors included, against the sampled
    linear closed loop. The scheme's error at 16 kHz and what the arm is not linear stay below 1 %."""
    effects = [
        effect("torque_delay", "hip", delay=3.5e-3),
        effect("sensor_delay", "knee", delay=2.25e-3, channel="theta"),
    ]
    robot = make(PLANAR, rates={"physics": 16000.0, "control": 500.0}, sensing_delay=1e-3)
    model = FlexibleJointModel(robot, effects)
    gains = Gains.motor_pd(robot, np.array([900.0, 500.0]), np.array([10.0, 5.0]))
    q, ticks = np.array([0.4, -0.7]), 60
    rest = equilibrium(model, q)
    push = 0.05  # N m beside the torque that holds
    state = model.rest(q)
    state.theta = rest.theta[0]
    rows = {"q_ref": q, "theta_ref": rest.theta[0], "dtheta_ref": np.zeros(2), "tau_ff": rest.tau[0] + push}
    references = {name: np.tile(row, (ticks, 1)) for name, row in rows.items()}
    tape = closed_loop(
        model,
        state,
        gains.law(robot),
        references,
        RunOptions(rate=16000.0),
        past=_past(model, state, rest.tau[0]),
    )
    simulated = tape.q[tape.first :: 32][:ticks] - q
    linear = close_loop(linearise(model, q).sampled(500.0), gains)
    x, expected = np.zeros(len(linear.states)), []
    for _ in range(ticks):
        expected.append(x[:2])
        x = linear.A @ x + linear.B @ np.full(2, push)
    np.testing.assert_allclose(simulated, expected, atol=0.01 * np.max(np.abs(expected)))
    assert np.max(np.abs(expected)) > 1e-5


def _past(model: FlexibleJointModel, state: State, tau: np.ndarray) -> Past:
    rows = 1000
    return Past(*(np.tile(v, (rows, 1)) for v in (tau, state.q, state.v, state.theta, state.dtheta)))


def test_signals_keep_their_names_in_python_control() -> None:
    system = pendulum().to_control()
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == ["tau_m_joint"] and system.state_labels[0] == "q_joint"
    pd = control.ss(
        [], [], [], [[900.0, 10.0]], inputs=["theta_joint", "dtheta_joint"], outputs=["back"], name="pd"
    )
    difference = control.summing_junction(["tau", "-back"], "tau_m_joint", name="sum")
    closed = control.interconnect(
        [system, pd, difference], inputs=["tau"], outputs=["q_joint"], check_unused=False
    )
    gains = Gains(np.array([[900.0, 10.0]]), ("theta.joint", "dtheta.joint"), ("tau_m.joint",))
    expected = np.sort_complex(close_loop(pendulum(), gains).poles)
    np.testing.assert_allclose(np.sort_complex(closed.poles()), expected, rtol=1e-8)


def test_dead_times_become_pade_where_the_caller_says_so() -> None:
    late = replace(pendulum(), input_delay=np.array([4e-3]))
    with pytest.raises(ModelError, match="pade=2"):
        late.to_control()
    assert late.to_control(pade=0).nstates == 4
    exact = late.to_control(pade=0)
    third = late.to_control(pade=3)
    assert third.nstates == 7 and third.output_labels == exact.output_labels
    for omega in (5.0, 60.0):
        shifted = exact(1j * omega) * np.exp(-4e-3j * omega)
        np.testing.assert_allclose(third(1j * omega), shifted, atol=1e-6 * np.max(np.abs(shifted)))


def test_nonsense_is_refused() -> None:
    with pytest.raises(ModelError, match="rate > 0"):
        pendulum().sampled(0.0)
    with pytest.raises(ModelError, match="sampled already"):
        pendulum().sampled(RATE).sampled(RATE)
    with pytest.raises(UnknownNameError, match=r"theta\.joint"):
        pendulum().places("outputs", ["thet.joint"])
    gains = Gains(np.array([[1.0]]), ("theta.joint",), ("tau_m.joint",))
    with pytest.raises(ModelError, match="sample it"):
        close_loop(replace(pendulum(), input_delay=np.array([1e-3])), gains)
    with pytest.raises(ModelError, match=r"tau_m\.other"):
        close_loop(pendulum(), replace(gains, inputs=("tau_m.other",)))


def test_python_control_is_optional(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import sys, flexjoint.design.gains, flexjoint.design.robustness; print('control' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingExtraError, match=r"flexjoint\[control\]"):
        pendulum().to_control()
