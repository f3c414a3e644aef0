"""Dirty machines are what they say: numbers within tolerances, a background of its size, their own laws."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import yaml
from planting.catalogue import BEYOND, CATALOGUE, OUTSIDE, Planted
from planting.dirty.case import LARGE
from planting.dirty.choice import LARGE_CAUSES, SMALL_CAUSES, SMALL_SHARES, UNKNOWN, _feels_weight
from planting.dirty.dirty import KINDS, dirty, moves
from planting.machine import outside
from planting.machine.by_hand import JOINT, LEVER, lever_gravity, lever_inertia, run
from planting.machine.drive import Drive
from planting.machine.laws import Equations
from planting.machine.sensing import PERFECT, Motion, Sensors
from planting.robots import MOST, read_robot, robot_file, within_tolerance
from planting.shares import Torques
from planting.simulate import plant
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.signal import lfilter, lsim
from support.thorough import thorough

RIGID_LEVER = robot_file("dirty_lever_rigid_5")
RIGID_CRANE = robot_file("dirty_crane_rigid_5")
ONE_JOINT = (("causes", 3), ("unknown", 7), ("background", 1))  # lever, rigid turret, turret


@cache
def recorded(kind, number):
    return dirty(kind, number).train()


# --- machines ---------------------------------------------------------------------------------------------
@thorough
def test_a_machine_follows_from_its_kind_and_number():
    again, first = dirty.__wrapped__("unknown", 7), dirty("unknown", 7)
    assert again == first != dirty("causes", 3)
    rows = again.train().columns
    for name, values in recorded("unknown", 7).columns.items():
        np.testing.assert_array_equal(values, rows[name])
    with pytest.raises(ValueError, match="causes, background, unknown"):
        dirty("clean", 0)


@pytest.mark.parametrize(("kind", "number"), ONE_JOINT)
def test_a_machine_has_what_its_kind_says(kind, number):
    case = dirty(kind, number)
    assert bool(case.effects) == (kind == "causes") and bool(case.unknown) == (kind == "unknown")
    assert {p.effect for p in case.effects} <= set(LARGE_CAUSES)
    assert {p.effect for p in case.unknown} <= set(UNKNOWN)
    assert 4 <= len(case.background) <= 8
    outside_catalogue = [p for p in case.background if p.effect in OUTSIDE]
    assert len(outside_catalogue) == len(case.background) // 2
    assert {OUTSIDE[p.effect].family for p in outside_catalogue} == {case.background_family}
    assert moves(recorded(kind, number))
    told = case.measured(recorded(kind, number))
    low, high = SMALL_SHARES
    for entry in told["background"]:
        # sized on a part of the motion, and not linearly in all: a third and three times are let through
        assert low / 3 < entry["share"] < 3 * high, entry
    for entry in told["truth"]:
        assert entry["large"] and entry["share"] > LARGE
    for entry in told["unknown"]:
        assert entry["share"] > 0.5 * LARGE  # it may act in a part of the recording only
    assert set(told["background_share"]) == set(read_robot(robot_file(case.robot)).joints)


def test_a_payload_hangs_where_it_weighs():
    weighs = {name: _feels_weight(read_robot(robot_file(name))) for name in ("turret", "scara", "lever")}
    assert weighs == {"turret": True, "scara": False, "lever": True}  # the turret leans


def test_no_law_outside_is_in_the_catalogue():
    assert not set(OUTSIDE) & {*CATALOGUE, *BEYOND}
    assert {*LARGE_CAUSES, *SMALL_CAUSES} <= {*CATALOGUE, *BEYOND} and set(UNKNOWN) <= set(OUTSIDE)
    assert set(KINDS) == {"causes", "background", "unknown"}


@pytest.mark.parametrize("name", ["dirty_gimbal_mixed_10", "dirty_drawn_12_of6_rigid_2"])
def test_numbers_are_within_the_stated_tolerance(name):
    path = robot_file(name)
    nominal, tolerance = read_robot(path), yaml.safe_load(path.read_text())["tolerance"]
    assert tolerance["inertial"] == pytest.approx(float(name.rsplit("_", 1)[1]) / 100)
    real = within_tolerance(nominal, tolerance, np.random.default_rng(4))
    pairs = [
        ("inertial", nominal.motor_inertia, real.motor_inertia),
        ("stiffness", nominal.stiffness, real.stiffness),
        ("damping", nominal.motor_damping, real.motor_damping),
    ]
    for told, own in zip(nominal.bodies, real.bodies, strict=True):
        pairs += [("inertial", told.mass, own.mass), ("inertial", told.com, own.com)]
        pairs += [("inertial", told.inertia, own.inertia)]
    for kind, told, own in pairs:
        finite = np.isfinite(told) & (np.asarray(told) != 0)
        off = np.abs(np.asarray(own)[finite] / np.asarray(told)[finite] - 1)
        assert (off <= MOST * tolerance[kind] + 1e-12).all()
    assert np.abs(real.motor_inertia / nominal.motor_inertia - 1).max() > 0.1 * tolerance["inertial"]


def test_variants_have_the_springs_that_their_name_says():
    stiff = {kind: read_robot(robot_file(f"dirty_gimbal_{kind}_5")).stiffness for kind in
             ("flexible", "mixed", "rigid")}  # fmt: skip
    assert [list(np.isinf(stiff[kind])) for kind in stiff] == [[False] * 3, [False, False, True], [True] * 3]
    assert len(read_robot(robot_file("dirty_drawn_12_of6_rigid_2")).joints) == 6
    with pytest.raises(ValueError, match="dirty_crane_rigid_5"):
        robot_file("dirty_crane")
    with pytest.raises(ValueError, match="is rigid"):
        plant(RIGID_LEVER, [Planted("backlash", JOINT, {"gap": 0.01})], "rich", 1, 1, PERFECT)


# --- rigid joints -----------------------------------------------------------------------------------------
def test_a_rigid_joint_is_rigid_while_it_sticks_and_slips():
    effects = [
        Planted("motor_coulomb_friction", "elbow", {"level": 3.0}),
        Planted("link_coulomb_friction", "elbow", {"level": 1.0}),
        Planted("load_friction", "shoulder", {"coefficient": 0.1}),
    ]
    made = plant(RIGID_CRANE, effects, "slow", 4, 1, PERFECT)
    np.testing.assert_array_equal(made.true["theta"], made.true["q"])
    np.testing.assert_array_equal(made.true["dtheta"], made.true["dq"])
    assert (made.run.modes == 0).any() and made.run.machine.unfinished_events == 0
    assert not any(name.startswith(("q.", "dq.", "tau_t.")) for name in made.columns)


def test_rigid_motion_converges_to_an_independent_solver():
    robot = read_robot(RIGID_CRANE)
    effects = [
        Planted("cable_spring", "shoulder", {"stiffness": 9.0, "rest": 0.2}),
        Planted("motor_viscous_friction", "elbow", {"coefficient": 2.0}),
    ]
    model = pin.buildModelFromUrdf(str(RIGID_CRANE.with_suffix(".urdf")))
    model.armature = robot.motor_inertia.copy()
    data, u = model.createData(), np.array([5.0, 2.0])

    def slope(t, x):
        q, v = x.reshape(2, 2)
        torque = u - robot.motor_damping * v + np.array([9.0 * (0.2 - q[0]), -2.0 * v[1]])
        return np.concatenate([v, pin.aba(model, data, q, v, torque)])

    exact = solve_ivp(slope, (0, 1), [0.3, -0.2, 0, 0], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    ours = run(robot, effects, [0.3, -0.2, 0, 0, 0.3, -0.2, 0, 0], u, 1.0)[-1]
    np.testing.assert_allclose(ours[:4], exact, atol=1e-8)  # order 4 at 5 kHz leaves about 1e-10


@pytest.mark.parametrize(("torque", "moves_off"), [(1.19, False), (1.21, True), (0.81, False), (0.79, True)])
def test_load_friction_of_a_rigid_joint_holds_its_share_of_the_load(torque, moves_off):
    robot, held = read_robot(RIGID_LEVER), lever_gravity(0.2)
    planted = Planted("load_friction", JOINT, {"coefficient": 0.2})
    states = run(robot, [planted], [0.2, 0, 0.2, 0], [torque * held], 0.3)
    assert (np.abs(states[:, 1]).max() > 0) == moves_off


# --- laws outside the catalogue ---------------------------------------------------------------------------
SIZES = {
    "torque": 2.0, "coefficient": 1.5, "velocity": 0.4, "width": 0.2, "level": 1.0, "cycles": 3.0,
    "period": 4.0, "phase": 0.7,
}  # fmt: skip
DRAGS = ("thinning_drag", "one_way_drag", "root_drag", "loaded_drag", "drag_at_speed")


def at(speed, tau_t=0.0, theta=0.4, t=1.0):
    return outside.At(0.0, speed, theta, speed, 1.0, t, tau_t, 100.0, 0.1, -0.3)


def of(effect):
    return Planted(effect, JOINT, {name: SIZES[name] for name in OUTSIDE[effect].required})


@pytest.mark.parametrize("effect", DRAGS)
def test_drags_take_energy(effect):
    for speed in np.linspace(-2, 2, 41):
        for tau_t in (-3.0, 3.0):
            assert float(outside.MOTOR[effect](of(effect), at(speed, tau_t))) * speed <= 0.0
    lost = sum(abs(float(outside.MOTOR[effect](of(effect), at(w, 3.0)))) for w in (0.3, 0.5))
    assert lost > 0.1


@pytest.mark.parametrize("effect", outside.DRY)
def test_dry_friction_never_pushes(effect):
    levels = [
        float(outside.DRY[effect](of(effect), at(1.0, theta=x, t=5 * x))) for x in np.linspace(-3, 3, 90)
    ]
    assert min(levels) >= 0.0 and max(levels) > 1.8


def test_a_drag_of_two_joints_takes_energy_from_both():
    robot = read_robot(RIGID_CRANE)
    e = Equations(robot, [Planted("neighbour_drag", "elbow", {"coefficient": 2.0, "side": "before"})])
    lack = ca.Function("lack", [e.x, e.u, e.gates, e.accelerations, e.t], [e.balance])
    x = np.array([0.1, 0.2, 0.7, -0.4, 0.1, 0.2, 0.7, -0.4, 0, 0])
    on, off = (np.array(lack(x, [0, 0], [g], np.zeros(4), 0)).ravel()[:2] for g in (1, 0))
    np.testing.assert_allclose(on - off, [-2.0 * 0.3] * 2, atol=1e-9)  # both feel the sum of the speeds
    assert (on - off) @ x[2:4] < 0


def test_a_wobbling_mass_keeps_and_loses_energy_as_a_pendulum_on_a_spring():
    robot = read_robot(RIGID_LEVER)
    inertia, omega = 0.2, 2 * np.pi * 2.0
    for damping in (0.0, 0.1):
        numbers = {"inertia": inertia, "frequency": 2.0, "damping": damping}
        states = run(robot, [Planted("wobbling_mass", JOINT, numbers)], [0.5, 0, 0.5, 0], [0.0], 1.0)
        q, dq, angle, speed = states[:, 0], states[:, 1], states[:, 5], states[:, 6]
        grid = np.linspace(q.min(), q.max(), 2001)
        height = cumulative_trapezoid(lever_gravity(grid), grid, initial=0)
        link = 0.5 * (lever_inertia() + robot.motor_inertia[0]) * dq**2 + np.interp(q, grid, height)
        mass = 0.5 * inertia * ((dq + speed) ** 2 + (omega * angle) ** 2)
        taken = [robot.motor_damping[0] * dq**2, 2 * damping * omega * inertia * speed**2]
        lost = [cumulative_trapezoid(power, dx=2e-4, initial=0) for power in taken]
        assert np.ptp(link + mass + sum(lost)) < 1e-4 * np.ptp(link)  # rules of second order at 5 kHz
        assert np.ptp(mass) > 0.01 * np.ptp(link) and (lost[1][-1] > 1e-3 * np.ptp(link)) == (damping > 0)


def test_a_drive_resonates_as_a_filter_of_second_order():
    robot, rate = read_robot(LEVER), 1000.0
    planted = Planted("drive_resonance", JOINT, {"period": 0.05, "damping": 0.3})
    drive = Drive(robot, [planted], np.zeros(1), 300, 5)
    commands = np.where(np.arange(300) < 20, 0.0, 1.0)
    ours = np.concatenate([drive.apply(k, k / rate, np.array([c]))[:, 0] for k, c in enumerate(commands)])
    omega, times = 2 * np.pi / 0.05, np.arange(1501) / (5 * rate)
    held = np.append(np.repeat(commands, 5), 1.0)
    _, exact, _ = lsim(([omega**2], [1, 2 * 0.3 * omega, omega**2]), held, times, interp=False)
    np.testing.assert_allclose(ours, (exact[1:] + exact[:-1]) / 2, atol=1e-9)


def test_a_filtered_position_lags_as_a_filter_of_first_order():
    step, lag = 1e-4, 0.003
    times = np.arange(0, 2, step)
    motion = np.sin(5 * times) + 0.3 * np.sin(20 * times)
    speed = 5 * np.cos(5 * times) + 6 * np.cos(20 * times)
    share = np.exp(-step / lag)
    exact = lfilter([(1 - share) / 2, (1 - share) / 2], [1, -share], motion)  # the trapezoid of both ends
    robot = read_robot(LEVER)
    planted = Planted("position_filter", JOINT, {"time_constant": lag, "channel": "theta"})
    seen = Sensors(robot, [planted], PERFECT, 1, np.random.default_rng(0))
    true = Motion(0.0, step, {"theta": motion[:, None], "dtheta": speed[:, None]})
    late = times[times > 0.5]
    ours = seen.clean("theta", true, late)[:, 0]
    np.testing.assert_allclose(ours, exact[times > 0.5], atol=3e-5)  # the held input is half a step off


# --- shares -----------------------------------------------------------------------------------------------
def test_shares_are_those_of_torques_that_are_known():
    path, n = RIGID_LEVER, 1
    effects = [
        Planted("motor_coulomb_friction", JOINT, {"level": 2.0}),
        Planted("torque_gain", JOINT, {"gain": 0.05}),
        Planted("cable_spring", JOINT, {"stiffness": 5.0, "rest": 0.1}),
    ]
    made = plant(path, effects, "rich", 4, 3, PERFECT)
    torques = Torques(read_robot(path), made.real, made.run, effects)
    scale = np.sqrt(np.mean(made.true["tau"] ** 2))
    assert torques.scale.shape == (n,) and torques.scale[0] == pytest.approx(scale, rel=0.02)
    slipping = np.mean(made.true["dtheta"] != 0)
    assert torques.share(0)[0] == pytest.approx(2.0 * np.sqrt(slipping) / scale, rel=0.03)
    assert torques.share(1)[0] == pytest.approx(0.05 / 1.05, rel=0.06)  # of the torque with the gain
    pull = 5.0 * np.sqrt(np.mean((made.true["q"] - 0.1) ** 2))
    assert torques.share(2)[0] == pytest.approx(pull / scale, rel=0.03)
    assert torques.of_numbers()[0] == pytest.approx(0.0, abs=1e-9)


def test_the_torques_of_a_machine_balance_on_its_own_motion():
    case = dirty("causes", 3)
    made = recorded("causes", 3)
    torques = Torques(read_robot(robot_file(case.robot)), made.real, made.run, list(case.everything))
    lack = torques._lack(np.ones(len(case.everything)))
    slipping = np.all(made.run.modes[torques.rows] != 0, axis=1)
    assert slipping.mean() > 0.5
    assert np.abs(lack[:, slipping]).max() < 1e-6 * torques.scale[0]
