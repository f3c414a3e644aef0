"""The model: equations of one joint by hand, the order of effects in the signal flow, onsets, refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, one_of_each

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.effects import Effect, Parameter, Planned, Signals, Site, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.joint import JointFlow


def flow_of(*effects: Planned) -> JointFlow:
    return FlexibleJointModel(make(PENDULUM), effects).flows[0]


# ------------------------------------------------------------------ equations
def test_one_joint_obeys_the_three_equations_written_out_by_hand() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    q, v, theta, w, tau = 0.4, -1.2, 0.43, 0.7, 5.0
    spring = 340 * (theta - q) + 0.9 * (w - v)
    inertia = 0.05 + 2.4 * 0.26**2
    acc = (spring - 2.4 * 9.81 * 0.26 * math.sin(q)) / inertia
    ddtheta = (tau - 4 * w - spring) / 0.12
    np.testing.assert_allclose(
        model.rhs(np.array([q, v, theta, w]), np.array([tau]), width=0.01), [v, acc, w, ddtheta], rtol=1e-13
    )


def test_a_rigid_joint_carries_its_motor_as_armature_and_damping() -> None:
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"stiffness": math.inf}}), [])
    q, v, tau = 0.4, -1.2, 5.0
    acc = (tau - 4 * v - 2.4 * 9.81 * 0.26 * math.sin(q)) / (0.05 + 2.4 * 0.26**2 + 0.12)
    np.testing.assert_allclose(model.rhs(np.array([q, v]), np.array([tau]), 0.01), [v, acc], rtol=1e-13)


def test_a_passive_joint_swings_freely() -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": None}), [])
    assert model.nf == 1
    state = model.rest(np.array([0.3, -0.4]))
    state.theta = state.theta + 0.01
    rates = model.rates(state, np.zeros(1), 0.01)
    body, data = model.robot.model, model.robot.model.createData()
    back = pin.rnea(body, data, state.q, state.v, rates.acc)
    np.testing.assert_allclose(back, [800 * 0.01, 0.0], atol=1e-12)


def test_smoothed_dry_friction_is_level_times_tanh() -> None:
    effects = [effect("motor_coulomb_friction", "joint", level=2.0)]
    rubbing, free = FlexibleJointModel(make(PENDULUM), effects), FlexibleJointModel(make(PENDULUM), [])
    x = np.array([0.1, 0.0, 0.1, 0.03])
    change = rubbing.rhs(x, np.zeros(1), 0.05) - free.rhs(x, np.zeros(1), 0.05)
    np.testing.assert_allclose(change, [0, 0, 0, -2.0 * math.tanh(0.03 / 0.05) / 0.12], atol=1e-12)


def test_body_effects_change_masses_and_gravity() -> None:
    robot = make(PLANAR)
    loaded = FlexibleJointModel(robot, [effect("payload", "knee", mass=0.7, position=(0.1, 0.0, -0.3))])
    own = robot.model.copy()
    knee = own.getJointId("knee")
    own.inertias[knee] = own.inertias[knee] + pin.Inertia(0.7, np.array([0.1, 0.0, -0.3]), np.zeros((3, 3)))
    q = np.array([0.3, -0.8])
    np.testing.assert_allclose(loaded.body.mass_matrix(q), pin.crba(own, own.createData(), q), atol=1e-13)
    tilted = FlexibleJointModel(robot, [effect("base_tilt", roll=0.0, pitch=0.2)])
    np.testing.assert_allclose(
        tilted.body.gravity, [9.81 * math.sin(0.2), 0, -9.81 * math.cos(0.2)], atol=1e-13
    )
    np.testing.assert_array_equal(robot.model.gravity.linear, [0, 0, -9.81])  # the shared model is untouched


# ------------------------------------------------------------------ signal flow
def test_nothing_acts_inside_the_gap_and_spring_effects_see_what_is_left() -> None:
    flow = flow_of(effect("backlash", "joint", gap=0.02), effect("hardening_spring", "joint", cubic=1e6))
    inside = Signals(phi=0.009, dphi=3.0)
    assert flow.transmission(inside, []) == 0.0
    assert (inside.phi, inside.dphi) == (0.009, 3.0)  # the caller's signals are as they were
    outside = flow.transmission(Signals(phi=0.013, dphi=3.0), [])
    assert outside == pytest.approx(340 * 0.003 + 0.9 * 3.0 + 1e6 * 0.003**3, rel=1e-12)


def test_the_gear_errs_before_the_play_and_leaves_the_damper_alone() -> None:
    error = effect("transmission_error", "joint", amplitude=0.004, cycles=2.0, phase=0.5)
    ripple = 0.004 * math.sin(2.0 * 0.3 + 0.5)
    s = Signals(theta=0.3, phi=0.013, dphi=2.0)
    assert flow_of(error).transmission(s, []) == pytest.approx(340 * (0.013 + ripple) + 0.9 * 2.0, rel=1e-12)
    both = flow_of(effect("backlash", "joint", gap=0.02), error)
    assert both.transmission(s, []) == pytest.approx(340 * (0.013 + ripple - 0.01) + 0.9 * 2.0, rel=1e-12)


def test_drive_effects_edit_the_four_numbers() -> None:
    flow = flow_of(
        effect("spring_stiffness", "joint", scale=0.3),
        effect("spring_damping", "joint", scale=-0.5),
        effect("motor_inertia", "joint", scale=0.1),
        effect("motor_viscous_friction", "joint", coefficient=2.0),
    )
    drive = flow.drive
    np.testing.assert_allclose([drive.K, drive.D, drive.B, drive.D_m], [442.0, 0.45, 0.132, 6.0], rtol=1e-14)


def test_linearised_spring_has_the_derivatives_of_the_torque() -> None:
    flow = flow_of(
        effect("hardening_spring", "joint", cubic=1e6),
        effect("transmission_error", "joint"),
        effect("spring_creep", "joint", stiffness=50.0),
    )
    z, step = [0.002], 1e-6

    def torque(phi: float, dphi: float) -> float:
        return float(flow.transmission(Signals(theta=0.3, phi=phi, dphi=dphi), z, 5e-4))

    tau, stiffness, damping = flow.linear_spring(Signals(theta=0.3, phi=0.01, dphi=0.4), z, 5e-4)
    assert tau == pytest.approx(torque(0.01, 0.4), rel=1e-12)
    by_phi = (torque(0.01 + step, 0.4) - torque(0.01 - step, 0.4)) / (2 * step)
    by_dphi = (torque(0.01, 0.4 + step) - torque(0.01, 0.4 - step)) / (2 * step)
    assert stiffness == pytest.approx(by_phi, rel=1e-6)  # the difference quotient's own error
    assert damping == pytest.approx(by_dphi, rel=1e-6)


def test_readings_are_corrected_to_what_was_true() -> None:
    flow = flow_of(
        effect("encoder_eccentricity", "joint", amplitude=0.05, phase=1.0, channel="q"),
        effect("link_encoder_offset", "joint", offset=-0.3),
        effect("torque_sensor_gain", "joint", gain=1.5),
        effect("torque_sensor_offset", "joint", offset=0.7),
    )
    x = np.linspace(-4.0, 4.0, 50)
    for channel in ("q", "tau_t", "theta"):
        seen = flow.read(channel, Signals(), x)
        np.testing.assert_allclose(flow.corrected(channel, Signals(), seen), x, atol=1e-12)
    np.testing.assert_allclose(flow.read("tau_t", Signals(), x), 2.5 * x + 0.7)  # gain, then offset


# ------------------------------------------------------------------ states and time
def test_states_are_named_packed_and_unpacked_in_one_order() -> None:
    effects = [effect("spring_hysteresis", "roll"), effect("dahl_friction", "yaw")]
    model = FlexibleJointModel(make(SPATIAL, {"pitch": {"stiffness": math.inf}}), effects)
    assert model.state_names == (
        "q.yaw", "q.roll", "q.pitch", "dq.yaw", "dq.roll", "dq.pitch", "theta.yaw", "theta.roll",
        "dtheta.yaw", "dtheta.roll", "dahl_friction.yaw", "spring_hysteresis.roll",
    )  # fmt: skip
    x = np.arange(float(model.nx))
    state = model.unpack(x, t=2.0)
    np.testing.assert_array_equal(model.pack(state), x)
    assert (state.t, state.z[model.slot("spring_hysteresis", "roll")]) == (2.0, 11.0)
    with pytest.raises(UnknownNameError, match=r"dahl_friction\.yaw"):
        model.slot("backlash", "yaw")


def test_a_floating_base_takes_part() -> None:
    model = FlexibleJointModel(make(SPATIAL, base="floating"), [])
    assert (model.nq, model.nv, model.nf) == (10, 9, 3)
    rates = model.rates(model.rest(), np.zeros(3), 0.01)
    np.testing.assert_allclose(rates.acc[:3], [0, 0, -9.81], atol=1e-12)  # it falls
    with pytest.raises(ModelError, match="nq = nv"):
        model.rhs(model.pack(model.rest()), np.zeros(3), 0.01)


def test_effects_sleep_before_their_onset() -> None:
    late = Planned(effect("spring_stiffness", "joint").effect, "joint", {"scale": 1.0}, since=2.0)
    later = Planned(effect("base_tilt").effect, None, {"roll": 0.0, "pitch": 0.1}, since=3.0)
    model = FlexibleJointModel(make(PENDULUM), [late, later])
    assert model.onsets == (2.0, 3.0)
    stiffness = [phase.flows[0].drive.K for _, phase in model.phases]
    tilts = [phase.body.gravity[0] != 0.0 for _, phase in model.phases]
    assert stiffness == [340, 680, 680]
    assert tilts == [False, False, True]


def test_effects_that_come_and_go_make_a_model_for_each_set_that_acts() -> None:
    picked = effect("payload", "joint", since=1.0, switches=(2.0, 3.0, 4.0), mass=1.0)
    model = FlexibleJointModel(make(PENDULUM), [picked])
    assert model.onsets == (1.0, 2.0, 3.0, 4.0)
    off, on = model.phases[0][1], model.phases[1][1]
    assert off is not on and [phase is on for _, phase in model.phases] == [False, True, False, True, False]


def test_when_an_effect_acts() -> None:
    times = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 9.0])
    always, late = effect("payload", "joint"), effect("payload", "joint", since=1.0)
    placed = effect("payload", "joint", switches=(0.5,))
    picked = effect("payload", "joint", since=0.5, switches=(1.0, 2.0))
    assert always.acts(times).all() and always.acts(0.0) and always.changes == ()
    np.testing.assert_array_equal(late.acts(times), times >= 1.0)
    np.testing.assert_array_equal(placed.acts(times), times < 0.5)
    np.testing.assert_array_equal(picked.acts(times), [0, 0, 1, 0, 0, 1, 1])
    assert always.during == ((-math.inf, math.inf),) and placed.during == ((-math.inf, 0.5),)
    assert picked.during == ((0.5, 1.0), (2.0, math.inf)) and picked.changes == (0.5, 1.0, 2.0)


@pytest.mark.parametrize("switches", [(0.5,), (2.0, 2.0), (3.0, 2.0), (math.nan,), (math.inf,)])
def test_switches_that_do_not_increase_are_refused(switches: tuple[float, ...]) -> None:
    with pytest.raises(ModelError, match="increasing times after `since`"):
        effect("payload", "joint", since=1.0, switches=switches)


# ------------------------------------------------------------------ refusals
def test_what_makes_no_sense_is_refused_with_a_remedy() -> None:
    robot = make(PENDULUM)
    twice = [effect("backlash", "joint", gap=0.01), effect("backlash", "joint", gap=0.02)]
    with pytest.raises(ModelError, match="given twice; keep one"):
        FlexibleJointModel(robot, twice)
    with pytest.raises(UnknownNameError, match="valid: joint"):
        FlexibleJointModel(robot, [effect("backlash", "elbow")])
    rigid = make(PENDULUM, {"joint": {"stiffness": math.inf}})
    with pytest.raises(ModelError, match="rigid; give it a finite stiffness"):
        FlexibleJointModel(rigid, [effect("backlash", "joint")])


class _TwoStates(Effect):
    site, states = Site.MOTOR, (0.0, 0.0)
    params = (Parameter("level", "N m", "l", value=1.0, low=0.0, high=1.0),)


def test_an_effect_of_two_states_is_refused() -> None:
    with pytest.raises(ModelError, match="1 at most"):
        FlexibleJointModel(make(PENDULUM), [Planned(_TwoStates(), "joint", {})])


@pytest.mark.parametrize("planned", one_of_each("roll"), ids=lambda planned: planned.effect.name)
def test_every_effect_changes_the_motion_or_a_reading(planned: Planned) -> None:
    """An effect that no site of the signal flow picks up would be silently ignored."""
    robot = make(SPATIAL)
    nominal, model = FlexibleJointModel(robot, []), FlexibleJointModel(robot, [planned])
    state = model.rest(np.array([0.3, 0.4, -0.5]))
    state.theta, state.dtheta = state.theta + 0.02, np.array([0.5, 1.5, -0.3])
    state.v, state.z, state.t = np.array([0.4, 1.2, 0.1]), state.z + 0.01, 0.02
    tau = np.array([4.0, 12.0, 3.0])
    plain = nominal.unpack(nominal.pack(nominal.rest()))
    for name in ("q", "v", "theta", "dtheta"):
        setattr(plain, name, getattr(state, name))
    a, b = model.rates(state, tau, 0.05), nominal.rates(plain, tau, 0.05)
    changed = not (np.allclose(a.acc, b.acc, rtol=1e-9) and np.allclose(a.ddtheta, b.ddtheta, rtol=1e-9))
    flow, s = model.flows[1], Signals(q=0.4, theta=0.42)
    sensed: list[Any] = [
        flow.read(c, s, 0.4) != 0.4 or flow.reading_delay(c) > 0 for c in ("q", "theta", "tau_t")
    ]
    late = flow.command_delay() > 0
    assert changed or any(sensed) or late
    assert not (planned.effect.site is Site.SENSOR and changed)


def test_flow_orders_effects_alphabetically_whatever_the_order_they_come_in() -> None:
    robot = make(PENDULUM)
    items = [effect("torque_gain", "joint", gain=1.0), effect("torque_offset", "joint", offset=3.0)]
    for parts in (items, items[::-1]):
        flow = FlexibleJointModel(robot, parts).flows[0]
        assert flow.command(Signals(), 5.0, []) == 13.0  # (1 + gain) tau, then the offset
