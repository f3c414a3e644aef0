"""The static law: theta_d = q_d + g(q_d)/K, springs that are not linear, and that a robot stays there."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.pages import DOCS, blocks
from support.robots import standing
from support.robots.arms import PENDULUM, PLANAR, make

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.effects import Planned, Signals, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium, holding_torque
from flexjoint.rigidbody.symbolic import SymbolicBody
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

Q = np.array([[0.3, -0.9], [-1.2, 0.4], [0.0, 0.0]])


def gravity(q: np.ndarray) -> np.ndarray:
    """(N, 2) of the planar arm, written out: masses 3.2 and 1.5 kg, joint to joint 0.4 m."""
    hip, both = q[:, 0], q[:, 0] + q[:, 1]
    knee = 1.5 * 9.81 * 0.17 * np.sin(both)
    # +y axis: a centre of mass ahead of the axis (+x) pulls the angle up
    thigh = 3.2 * 9.81 * (0.2 * np.sin(hip) - 0.01 * np.cos(hip)) + 1.5 * 9.81 * 0.4 * np.sin(hip)
    return np.stack([thigh + knee, knee], axis=1)


def test_linear_springs_deflect_by_g_over_K() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    rest = equilibrium(model, Q)
    np.testing.assert_allclose(rest.tau, gravity(Q), atol=1e-12)
    np.testing.assert_allclose(rest.theta, Q + gravity(Q) / [800.0, 420.0], atol=1e-14)


def test_a_rigid_joint_does_not_deflect() -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": {"stiffness": math.inf}}), [])
    np.testing.assert_array_equal(equilibrium(model, Q).theta[:, 1], Q[:, 1])


def test_link_effects_share_the_load() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("cable_spring", "hip", stiffness=9.0, rest=0.2)])
    load = holding_torque(model, Q)
    np.testing.assert_allclose(load[:, 0], gravity(Q)[:, 0] - 9.0 * (0.2 - Q[:, 0]), atol=1e-12)


def test_a_play_is_crossed_by_half_its_gap() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("backlash", "knee", gap=0.02)])
    load = gravity(Q)[:2, 1]
    phi = equilibrium(model, Q[:2]).theta[:, 1] - Q[:2, 1]
    np.testing.assert_allclose(phi, load / 420.0 + 0.01 * np.sign(load), atol=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        [effect("hardening_spring", "hip", cubic=1e7)],
        [effect("hardening_spring", "hip", cubic=1e12)],
        [effect("transmission_error", "hip", amplitude=4e-3, cycles=30.0, phase=1.0)],
        [effect("spring_preload", "hip", torque=2.0), effect("backlash", "hip", gap=0.01)],
    ],
    ids=lambda effects: effects[0].effect.name,
)
def test_any_spring_then_carries_its_load(effects: list[Planned]) -> None:
    model = FlexibleJointModel(make(PLANAR), effects)
    q = np.stack([np.linspace(-1.5, 1.5, 40), np.zeros(40)], axis=1)
    rest = equilibrium(model, q)
    phi = rest.theta[:, 0] - q[:, 0]
    carried = model.flows[0].transmission(Signals(q=q[:, 0], theta=rest.theta[:, 0], phi=phi), [])
    # at a stiffness of 3e5 the last digit of phi is worth 1e-12 N m
    np.testing.assert_allclose(carried, rest.tau[:, 0], atol=1e-9)


def test_the_robot_stays_where_its_equilibrium_is() -> None:
    effects = [effect("hardening_spring", "hip", cubic=1e6), effect("backlash", "knee", gap=0.01)]
    model = FlexibleJointModel(make(PLANAR), effects)
    rest = equilibrium(model, Q[:1])
    state = model.rest(Q[0])
    state.theta = rest.theta[0]
    tape = rollout(model, state, np.tile(rest.tau, (1000, 1)), RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q[-1], Q[0], atol=1e-10)  # rounding over a second of a stable rest


def test_shapes_and_impossible_loads_are_refused() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    with pytest.raises(ModelError, match=r"\(N, 2\)"):
        equilibrium(model, np.zeros((3, 3)))
    softening = Planned(effect("hardening_spring", "joint").effect, "joint", {"cubic": -1e9})
    bent = FlexibleJointModel(make(PENDULUM), [softening])
    with pytest.raises(ModelError, match="cannot carry the load"):
        equilibrium(bent, np.array([[1.2]]))


# --- batches and limits of stiffness ------------------------------------------------------------------------
def test_a_batch_is_a_loop() -> None:
    """And Pinocchio's gravity over K, pose by pose."""
    model = standing.model("fixed", (effect("hardening_spring", "j_arm1_2", cubic=1e8),))
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (30, model.nq))
    together = equilibrium(model, q)
    data = model.robot.model.createData()
    for k, pose in enumerate(q):
        alone = equilibrium(model, pose)
        for name in ("theta", "tau", "gravity", "tau_m", "deflection"):
            # Newton's method stops for the whole batch at once
            np.testing.assert_allclose(getattr(together, name)[k], getattr(alone, name)[0], atol=1e-13)
        expected = pin.computeGeneralizedGravity(model.robot.model, data, pose)
        np.testing.assert_allclose(together.tau[k], expected, rtol=0, atol=1e-12)
    linear = [i for i, joint in enumerate(model.joints) if joint.name != "j_arm1_2"]
    stiffness = np.array([joint.drive.K for joint in model.joints])
    by_hand = q + together.tau / stiffness
    np.testing.assert_allclose(together.theta[:, linear], by_hand[:, linear], rtol=0, atol=1e-14)


def test_a_batch_is_quick() -> None:
    """20,000 poses of 37 joints took 0.13 s of one core; a loop over poses in Python would take 20 s."""
    model = standing.model("fixed")
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (20_000, model.nq))
    begin = time.process_time()
    equilibrium(model, q)
    assert time.process_time() - begin < 3.0


def test_motors_meet_the_links_as_springs_stiffen() -> None:
    """|theta_d - q_d| falls with 1/K, to 0 at infinity."""
    gaps = []
    for stiffness in (1e3, 1e4, 1e5, math.inf):
        changes = {name: {"stiffness": stiffness} for name in ("hip", "knee")}
        gaps.append(np.max(np.abs(equilibrium(FlexibleJointModel(make(PLANAR, changes), []), Q).theta - Q)))
    np.testing.assert_allclose(gaps[:2], [10 * gaps[1], 10 * gaps[2]], rtol=1e-9)  # K phi is exact
    assert gaps[3] == 0.0


# --- springs in closed form ---------------------------------------------------------------------------------
def test_a_hardening_spring_is_cardanos_cubic() -> None:
    cubic, stiffness = 5e5, 800.0
    model = FlexibleJointModel(make(PLANAR), [effect("hardening_spring", "hip", cubic=cubic)])
    load = gravity(Q)[:, 0]
    p, half = stiffness / cubic, load / cubic / 2
    root = np.sqrt(half**2 + (p / 3) ** 3)
    expected = np.cbrt(half + root) + np.cbrt(half - root)
    np.testing.assert_allclose(equilibrium(model, Q).deflection[:, 0], expected, rtol=1e-12, atol=1e-15)


def test_a_slow_path_leaves_its_hysteresis() -> None:
    """Out and back: K phi + z carries the load throughout, z follows Dahl's exponential, and the hanging
    pendulum comes back to a deflection that is not 0."""
    level, scale, stiffness = 3.0, 4e-3, 340.0
    law = effect("spring_hysteresis", "joint", level=level, scale=scale)
    model = FlexibleJointModel(make(PENDULUM), [law])
    q = np.concatenate([np.linspace(0.0, 1.2, 25), np.linspace(1.2, 0.0, 25)])[:, None]
    rest = equilibrium(model, q, path=True)
    phi, z, load = rest.deflection[:, 0], rest.z[:, 0], 2.4 * 9.81 * 0.26 * np.sin(q[:, 0])
    np.testing.assert_allclose(stiffness * phi + z, load, atol=1e-9)
    for k in range(1, len(q)):
        way = np.sign(phi[k] - phi[k - 1])
        expected = way * level + (z[k - 1] - way * level) * np.exp(-abs(phi[k] - phi[k - 1]) / scale)
        assert z[k] == pytest.approx(expected, abs=1e-9)  # the scheme's own difference quotient of the rate
    assert abs(phi[-1]) > 1e-3 and abs(equilibrium(model, q).deflection[-1, 0]) < 1e-15


def test_a_long_path_tells_how_far_it_is() -> None:
    law = effect("spring_hysteresis", "joint", level=3.0, scale=4e-3)
    model = FlexibleJointModel(make(PENDULUM), [law])
    told: list[float] = []
    q = np.linspace(0.0, 1.2, 900)[:, None]
    equilibrium(model, q, path=True, progress=lambda share, _what: told.append(share))
    np.testing.assert_allclose(told, [0.0, 200 / 900, 400 / 900, 600 / 900, 800 / 900])


def test_the_robot_stays_where_its_hysteresis_left_it() -> None:
    """With the spring's state and that of a friction that gives way (Dahl) taken over."""
    effects = [
        effect("spring_hysteresis", "joint", level=3.0, scale=4e-3),
        effect("dahl_friction", "joint", level=0.5, scale=2e-3),
    ]
    model = FlexibleJointModel(make(PENDULUM), effects)
    q = np.concatenate([np.linspace(0.0, 0.9, 10), np.linspace(0.9, 0.5, 7)[1:]])[:, None]
    rest = equilibrium(model, q, path=True)
    assert np.max(np.abs(rest.z[-1])) > 0.1 and np.max(np.abs(rest.tau_m - rest.tau)) > 0.4
    state = model.rest(q[-1])
    state.theta, state.z = rest.theta[-1], rest.z[-1]
    tape = rollout(model, state, np.tile(rest.tau_m[-1:], (1000, 1)), RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q[-1], q[-1], atol=1e-9)  # round-off, as below


def test_friction_remembers_in_a_rigid_joint_too() -> None:
    law = effect("dahl_friction", "joint", level=0.5, scale=2e-3)
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"stiffness": math.inf}}), [law])
    rest = equilibrium(model, np.array([[0.0], [0.5], [0.499]]), path=True)
    forth = 0.5 * (1.0 - np.exp(-0.5 / 2e-3))
    back = -0.5 + (forth + 0.5) * np.exp(-1e-3 / 2e-3)
    np.testing.assert_allclose(rest.tau_m[:, 0] - rest.tau[:, 0], [0.0, forth, back], atol=1e-9)
    np.testing.assert_array_equal(rest.deflection, 0.0)


def test_creep_has_relaxed_on_a_slow_path() -> None:
    law = effect("spring_creep", "joint", stiffness=50.0, time_constant=10.0)
    model = FlexibleJointModel(make(PENDULUM), [law])
    q = np.linspace(0.0, 1.0, 5)[:, None]
    slow = equilibrium(model, q, path=True)
    np.testing.assert_allclose(slow.theta, equilibrium(model, q).theta, atol=1e-9)


# --- the motor's side ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("effects", "command"),
    [
        ({"torque_gain": {"gain": 0.25}}, lambda tau, theta: tau / 1.25),
        ({"torque_gain": {"gain": -0.6}}, lambda tau, theta: tau / 0.4),
        ({"torque_offset": {"offset": 1.5}}, lambda tau, theta: tau - 1.5),
        (
            {"torque_gain": {"gain": 1.0}, "torque_saturation": {"limit": 60.0}},
            lambda tau, theta: tau / 2,
        ),
        (
            {"cogging": {"amplitude": 0.5, "cycles": 7.0, "phase": 0.2}},
            lambda tau, theta: tau - 0.5 * np.sin(7.0 * theta + 0.2),
        ),
        ({"load_friction": {"coefficient": 0.1}}, lambda tau, theta: tau),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else "",
)
def test_the_command_goes_through_the_motors_effects(
    effects: dict[str, dict[str, float]], command: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> None:
    model = FlexibleJointModel(make(PLANAR), [Planned.of(name, "hip", p) for name, p in effects.items()])
    rest = equilibrium(model, Q)
    expected = command(rest.tau[:, 0], rest.theta[:, 0])
    np.testing.assert_allclose(rest.tau_m[:, 0], expected, rtol=1e-10, atol=1e-10)
    assert rest.violations == ()


def test_dry_friction_leaves_a_band() -> None:
    effects = [
        effect("motor_coulomb_friction", "hip", level=0.7),
        effect("load_friction", "hip", coefficient=0.1),
    ]
    rest = equilibrium(FlexibleJointModel(make(PLANAR), effects), Q)
    np.testing.assert_allclose(rest.friction[:, 0], 0.7 + 0.1 * np.abs(rest.tau[:, 0]), rtol=1e-14)


EFFECTS = [
    [effect("torque_gain", "hip", gain=0.2), effect("torque_offset", "knee", offset=-1.0)],
    [effect("spring_preload", "hip", torque=2.0), effect("cable_spring", "knee", stiffness=9.0)],
    [effect("transmission_error", "hip", amplitude=4e-3, cycles=30.0, phase=1.0)],
    [
        effect("payload", "knee", mass=0.8, position=(0.0, 0.0, -0.2)),
        effect("base_tilt", roll=0.1),
    ],
]


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda effects: effects[0].effect.name)
def test_a_held_motor_torque_keeps_the_robot_where_it_is(effects: list[Planned]) -> None:
    """The arm hangs: with the torque that holds it and no controller, it stays for a second."""
    model = FlexibleJointModel(make(PLANAR), effects)
    pose = np.array([0.3, -0.2])
    rest = equilibrium(model, pose)
    state = model.rest(pose)
    state.theta = rest.theta[0]
    tape = rollout(model, state, np.tile(rest.tau_m, (1000, 1)), RunOptions(rate=1000.0))
    # round-off in tau_m, 1e-14 N m, over the softest motion of the arm; a torque off by 1e-3 N m gives 1e-5
    np.testing.assert_allclose(tape.q[-1], pose, atol=1e-9)
    np.testing.assert_allclose(tape.theta[-1], rest.theta[0], atol=1e-9)


# --- limits -------------------------------------------------------------------------------------------------
def test_limits_that_are_broken_are_named() -> None:
    model = FlexibleJointModel(make(PLANAR, {"hip": {"torque_limit": 8.0}}), [])
    rest = equilibrium(model, Q, max_deflection={"knee": 1e-3})
    torque, deflected = rest.violations
    load, phi = gravity(Q)[:, 0], gravity(Q)[:, 1] / 420.0
    assert (torque.kind, torque.joint, torque.unit) == ("motor torque", "hip", "N m")
    np.testing.assert_array_equal(torque.poses, np.flatnonzero(np.abs(load) > 8.0))
    np.testing.assert_allclose(torque.excess, np.abs(load[torque.poses]) - 8.0, rtol=1e-12)
    assert (deflected.kind, deflected.joint) == ("deflection", "knee")
    np.testing.assert_allclose(deflected.values, phi[np.abs(phi) > 1e-3], rtol=1e-12)
    k = int(np.argmax(np.abs(load)))
    assert torque.worst == k and f"motor torque of hip: pose {k} needs {load[k]:.5g} N m" in str(torque)


def test_a_torque_that_no_command_reaches_is_named() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("torque_saturation", "hip", limit=5.0)])
    (violation,) = equilibrium(model, Q).violations
    load = gravity(Q)[:, 0]
    np.testing.assert_array_equal(violation.poses, np.flatnonzero(np.abs(load) > 5.0))
    assert violation.kind == "reachable torque"
    np.testing.assert_allclose(violation.excess, np.abs(load[violation.poses]) - 5.0, rtol=1e-9)


def test_joints_out_of_range_are_named() -> None:
    model = standing.model("fixed")
    q = model.body.neutral.copy()
    q[model.robot.joint("torso_yaw").idx_q] = 9.0
    kinds = {(v.kind, v.joint) for v in equilibrium(model, q).violations}
    assert ("joint range", "torso_yaw") in kinds
    assert ("joint range", "j_arm1_2") in kinds  # its range starts at 0.02


def test_the_example_of_the_docs_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for example in blocks(DOCS / "howto" / "theta_d.md", "python"):
        exec(example, names)
    assert "deflection of joint2: pose " in capsys.readouterr().out


def test_what_cannot_be_asked_is_refused() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    with pytest.raises(ModelError, match="pose 1 has a number that is not finite"):
        equilibrium(model, np.array([[0.0, 0.0], [np.nan, 0.0]]))
    with pytest.raises(ModelError, match=r"got shape \(0, 2\)"):
        equilibrium(model, np.empty((0, 2)))
    with pytest.raises(ModelError, match="needs numbers"):
        equilibrium(FlexibleJointModel(make(PLANAR), [], SymbolicBody), Q)
    with pytest.raises(UnknownNameError, match="joint 'elbow'"):
        equilibrium(model, Q, max_deflection={"elbow": 0.1})
    with pytest.raises(ModelError, match="max_deflection of knee"):
        equilibrium(model, Q, max_deflection={"knee": 0.0})
