"""What acts between a command and its motor with a state or a neighbour: lags and couplings of joints."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from support.loops import loops_agree
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, waves

from flexjoint.core.errors import ModelError
from flexjoint.design.linearise import linearise
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.effects import Planned, Signals, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.joint import JointFlow, Part
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.model.statics.start import at_rest
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.recording.table import make as recorded
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes.discrete import DiscreteModel
from flexjoint.simulation.simulate import simulate


def lag(joint: str, seconds: float, since: float | None = None) -> Planned:
    return replace(effect("current_lag", joint, time_constant=seconds), since=since)


def couplings(share: float) -> list[Planned]:
    return [
        effect("joint_coupling", "hip", share=share, side="after"),
        effect("joint_coupling", "knee", share=-0.5 * share),
    ]


# --- a lag ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seconds", [1e-6, 1e-4, 1e-3, 0.02, 0.5])
def test_a_lag_gives_the_impulse_of_its_closed_form_in_any_step(seconds: float) -> None:
    """However short it is against the step: u + (z - u) T/h (1 - exp(-h/T)) on average."""
    item, h, u, z = lag("joint", seconds), 1e-3, 7.0, [-2.0]
    flow = JointFlow(make(PENDULUM).joints[0], [Part(item.effect, item.p, 0)])
    x = h / seconds
    mean = u + (z[0] - u) * -math.expm1(-x) / x
    # 1e-4 of the jump: what stands for a decay of none
    assert flow.command(Signals(tau_m=u), u, z, h) == pytest.approx(mean, abs=1e-3)
    ((slot, after),) = flow.advanced(Signals(tau_m=u), z, h)
    assert slot == 0 and after == pytest.approx(u + (z[0] - u) * math.exp(-x), rel=1e-9)


def test_a_lag_follows_what_acts_before_it_and_is_scaled_by_what_acts_behind() -> None:
    items = [lag("joint", 0.01), effect("cogging", "joint", amplitude=2.0, phase=0.5 * math.pi)]
    items.append(effect("torque_gain", "joint", gain=1.0))
    flow = FlexibleJointModel(make(PENDULUM), items).flows[0]
    s = Signals(tau_m=5.0)
    assert flow.rates(s, [4.0]) == [(0, pytest.approx((5.0 + 2.0 - 4.0) / 0.01))]
    assert flow.command(s, 5.0, [4.0]) == pytest.approx(2.0 * 4.0)
    assert flow.steady_command(s, 5.0) == pytest.approx(2.0 * 7.0)
    assert flow.steady_state(s, 5.0) == [(0, pytest.approx(7.0))]
    assert s.tau_m == 5.0


@pytest.mark.parametrize("since", [None, 0.2])
def test_a_robot_at_rest_stays_there_with_a_lag_that_works_or_sets_in(since: float | None) -> None:
    effects = [lag("hip", 0.05, since), lag("knee", 0.003, since), effect("torque_gain", "hip", gain=0.2)]
    model = FlexibleJointModel(make(PLANAR), effects)
    q = np.array([0.4, -0.7])
    start = at_rest(model, q)
    torque = np.tile(equilibrium(model, q).tau_m, (500, 1))
    tape = rollout(model, start, torque, RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q, np.tile(q, (501, 1)), atol=1e-9)
    np.testing.assert_allclose(tape.z, np.tile(start.z, (501, 1)), rtol=1e-9)


def test_a_lag_that_sets_in_has_followed_the_command_before() -> None:
    """At its onset the motor's torque does not jump to where the recording began."""
    model = FlexibleJointModel(make(PLANAR), [lag("hip", 0.01, 0.3)])
    torque = waves(2, 600, 1000.0, 8.0)
    tape = rollout(model, model.rest(), torque, RunOptions(rate=1000.0))
    z = 0.0
    for k in range(599):
        z = torque[k, 0] + (z - torque[k, 0]) * math.exp(-0.1)
        assert tape.z[k + 1, 0] == pytest.approx(z, abs=1e-9)


def test_a_lag_is_a_pole_of_the_linear_model() -> None:
    linear = linearise(FlexibleJointModel(make(PENDULUM), [lag("joint", 0.02)]))
    assert np.min(np.abs(linear.poles + 50.0)) < 1e-6
    np.testing.assert_allclose(linear.drift, 0.0, atol=1e-9)


def test_windows_of_a_comparison_start_with_the_lag_where_it_was() -> None:
    """The machine's own model leaves of its own recording what the states' estimate leaves, not a jump of the
    torque at every start."""
    model = FlexibleJointModel(make(PLANAR), [lag("hip", 0.03), lag("knee", 0.03)])
    time = np.arange(0.0, 3.0, 1e-3)
    reference = {("q_ref", "hip"): 0.5 * np.sin(4.0 * time), ("q_ref", "knee"): 0.4 * np.sin(7.0 * time)}
    measured = simulate(model, recorded(time, reference), sample_rate=1000.0).measured
    with_lag = compare(model, measured, horizon=0.1).nrmse["q.hip"]
    without = compare(FlexibleJointModel(make(PLANAR), []), measured, horizon=0.1).nrmse["q.hip"]
    assert with_lag < 0.02 * without


# --- neighbours -------------------------------------------------------------------------------------------
def test_a_coupling_adds_a_share_of_the_neighbours_command() -> None:
    model = FlexibleJointModel(make(PLANAR), couplings(0.4))
    tau_m = np.array([3.0, -5.0])
    nominal = FlexibleJointModel(make(PLANAR), [])
    state = model.rest(np.array([0.3, 0.2]))
    mixed = np.array([3.0 + 0.4 * -5.0, -5.0 - 0.2 * 3.0])
    with_it, by_hand = model.rates(state, tau_m, None), nominal.rates(state, mixed, None)
    np.testing.assert_allclose(with_it.ddtheta, by_hand.ddtheta, rtol=1e-12)
    torque = waves(2, 400, 1000.0, 8.0)
    coupled = rollout(model, state, torque, RunOptions(rate=1000.0))
    other = torque @ np.array([[1.0, -0.2], [0.4, 1.0]])
    np.testing.assert_allclose(
        coupled.q, rollout(nominal, state, other, RunOptions(rate=1000.0)).q, atol=1e-12
    )


def test_the_first_joint_has_nothing_before_it() -> None:
    alone = FlexibleJointModel(make(PLANAR), [effect("joint_coupling", "hip", share=3.0)])
    nominal, tau_m = FlexibleJointModel(make(PLANAR), []), np.array([3.0, -5.0])
    np.testing.assert_array_equal(
        alone.rates(alone.rest(), tau_m, None).ddtheta, nominal.rates(nominal.rest(), tau_m, None).ddtheta
    )


def test_commands_that_act_on_each_other_hold_the_pose() -> None:
    model, q = FlexibleJointModel(make(PLANAR), couplings(0.6)), np.array([0.4, -0.7])
    rest = equilibrium(model, q)
    mix = np.array([[1.0, 0.6], [-0.3, 1.0]])
    np.testing.assert_allclose(mix @ rest.tau_m[0], rest.tau[0], rtol=1e-8)
    tape = rollout(model, at_rest(model, q), np.tile(rest.tau_m, (300, 1)), RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q, np.tile(q, (301, 1)), atol=1e-7)


def test_commands_that_cancel_each_other_are_refused() -> None:
    model = FlexibleJointModel(make(PLANAR), [*couplings(-2.0)])
    with pytest.raises(ModelError, match="act on each other"):
        equilibrium(model, np.array([0.4, -0.7]))


def test_a_coupling_is_in_the_linear_models_inputs() -> None:
    coupled, plain = (linearise(FlexibleJointModel(make(PLANAR), e)) for e in (couplings(0.4), []))
    np.testing.assert_allclose(coupled.B, plain.B @ np.array([[1.0, 0.4], [-0.2, 1.0]]), atol=1e-9)


# --- every engine -----------------------------------------------------------------------------------------
def test_lags_and_couplings_agree_compiled() -> None:
    late = [
        lag("yaw", 0.004),
        lag("roll", 0.01, 0.3),
        effect("joint_coupling", "roll", share=0.2),
        replace(effect("joint_coupling", "pitch", share=-0.1), since=0.4),
        effect("torque_delay", "yaw", delay=0.0043),
    ]
    loops_agree(make(SPATIAL, rates={"physics": 2000, "control": 500}), late, 2000.0)


@pytest.mark.parametrize("scheme", ["rk4", "semi_implicit_euler", "implicit_midpoint"])
def test_other_schemes_come_to_the_same(scheme: str) -> None:
    effects = [lag("hip", 0.02), *couplings(0.3)]
    model = FlexibleJointModel(make(PLANAR), effects)
    torque = np.repeat(waves(2, 100, 1000.0, 8.0), 10, axis=0)
    default = rollout(model, model.rest(), torque, RunOptions(rate=10000.0))
    other = rollout(model, model.rest(), torque, RunOptions(rate=10000.0, scheme=scheme))
    # order 1: h times the acceleration's change
    np.testing.assert_allclose(other.q[-1], default.q[-1], atol=1e-3 if "euler" in scheme else 2e-6)


@pytest.mark.usefixtures("one_pass")  # as an expression
def test_the_symbolic_step_is_the_same() -> None:
    model = FlexibleJointModel(make(PLANAR), [lag("hip", 0.02), *couplings(0.3)])
    symbolic = SymbolicModel(model.robot.extended(model.effects))
    discrete = DiscreteModel(symbolic, 1000.0)
    step, torque = discrete.step(), waves(2, 50, 1000.0, 8.0)
    x = ca.DM(discrete.start(model.rest(), np.zeros(2)))
    tape = rollout(model, model.rest(), torque, RunOptions(rate=1000.0, engine="pin"))
    for k in range(50):
        x = step(x, torque[k], symbolic.values, k * 1e-3)
    np.testing.assert_allclose(x.full()[:2, 0], tape.q[-1], atol=1e-12)
