"""The effects that came later: their laws at a state, and what the machine, its drive and its sensors make of
them, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting.catalogue import BEYOND, TWO_JOINTS, Planted
from planting.machine.by_hand import JOINT, LEVER, lever, lever_gravity, lever_inertia, run, spring
from planting.machine.drive import Drive
from planting.machine.machine import Machine
from planting.machine.sensing import FROM_CURRENT, PERFECT, robot_noise
from planting.robots import ROBOTS, read_robot
from planting.simulate import plant
from planting.sizes import MET_EFFECTS, usual_effect
from scipy.integrate import quad, solve_ivp

CRANE = ROBOTS / "crane.yaml"
CURRENT = replace(FROM_CURRENT, noise=PERFECT.noise, resolution=0.0)

DAHL = Planted("dahl_friction", JOINT, {"level": 2.0, "scale": 0.004})
BREAKAWAY = Planted("breakaway_friction", JOINT, {"level": 3.0, "distance": 0.05})
CREEP = Planted("spring_creep", JOINT, {"stiffness": 80.0, "time_constant": 0.4})
DRAG = Planted("quadratic_drag", JOINT, {"coefficient": 1.5})
LOSSES = Planted("drive_efficiency", JOINT, {"loss_driving": 0.1, "loss_backdriving": 0.3})
SPOT = Planted("rough_spot", JOINT, {"level": 2.0, "position": 0.3, "width": 0.05})
LIMIT = Planted("torque_speed_limit", JOINT, {"stall": 5.0, "drop": 2.0})
HUM = Planted("periodic_disturbance", JOINT, {"amplitude": 1.2, "frequency": 4.0, "phase": 0.7})


def held_at(q: float) -> tuple[float, list[float]]:
    """The torque that holds the lever at q, and the state at rest there."""
    held = float(lever_gravity(q))
    return held, [q, 0.0, q + held / read_robot(LEVER).stiffness[0], 0.0]


# --- laws at a state --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("planted", "state", "expected"),
    [
        (DAHL, {"z": 0.4}, -0.4),
        (BREAKAWAY, {"z": 0.6}, -1.8),
        (BREAKAWAY, {"z": 0.6, "dtheta": -0.9}, 1.8),
        (SPOT, {}, -2 * np.exp(-0.36)),
        (SPOT, {"theta": 0.26, "dtheta": -0.9}, 2 * np.exp(-0.64)),
        (LIMIT, {}, (5 - 1.8) - 7),
        (LIMIT, {"u": -7.0}, (-5 - 1.8) + 7),
        (LIMIT, {"u": 3.0}, 0.0),
        (LIMIT, {"u": 7.0, "dtheta": -2.0}, 0.0),  # a motor that is pushed back has more
    ],
)
def test_motor_laws(planted, state, expected):
    sticks = planted.effect not in ("dahl_friction", "torque_speed_limit")
    _, motor, torque, _ = lever(planted, modes=[np.sign(state.get("dtheta", 0.9))] if sticks else [], **state)
    assert motor == pytest.approx(expected, abs=1e-10)  # rounding
    assert torque == pytest.approx(spring(state.get("theta", 0.33) - 0.3, state.get("dtheta", 0.9) - 0.4))


@pytest.mark.parametrize(
    ("theta", "w", "loss"), [(0.33, 0.9, 0.1), (0.33, -0.9, 0.3), (0.27, 0.9, 0.3), (0.27, -0.9, 0.1)]
)
def test_a_drive_loses_more_where_the_load_drives_it(theta, w, loss):
    _, motor, torque, _ = lever(LOSSES, modes=[np.sign(w)], theta=theta, dtheta=w)
    assert np.sign(torque) == np.sign(theta - 0.3)
    assert motor == pytest.approx(-np.sign(w) * loss * abs(torque))


@pytest.mark.parametrize(
    ("planted", "state", "expected"),
    [
        (DAHL, {"z": 0.4}, 0.9 * (2.0 - 0.4) / 0.004),
        (DAHL, {"z": 0.4, "dtheta": -0.9}, -0.9 * (2.0 + 0.4) / 0.004),
        (BREAKAWAY, {"z": 0.6}, -0.9 / 0.05 * 0.6),
        (BREAKAWAY, {"z": 0.6, "dtheta": -0.9}, -0.9 / 0.05 * 0.6),
        (CREEP, {"z": 0.01}, 0.5 - 0.01 / 0.4),
    ],
)
def test_rates_of_the_states(planted, state, expected):
    modes = [np.sign(state.get("dtheta", 0.9))] if planted is BREAKAWAY else []
    assert lever(planted, modes=modes, **state)[3] == pytest.approx(expected)


def test_a_creeping_spring_adds_its_state_to_the_spring_torque():
    assert lever(CREEP, z=0.01)[2] == pytest.approx(spring() + 0.8)


@pytest.mark.parametrize(
    ("planted", "state", "expected"),
    [
        (DRAG, {}, -1.5 * 0.16),
        (DRAG, {"dq": -0.4}, 1.5 * 0.16),
        (HUM, {"t": 1.53}, 1.2 * np.sin(2 * np.pi * 4 * 1.53 + 0.7)),
    ],
)
def test_link_laws(planted, state, expected):
    assert lever(planted, **state)[0] == pytest.approx(expected, abs=1e-10)  # rounding


@pytest.mark.parametrize("effect", [e for e in BEYOND if e not in (*MET_EFFECTS, *TWO_JOINTS)])
def test_a_closed_gate_removes_every_law(effect):
    planted = usual_effect(effect, "lever", JOINT, np.random.default_rng(0))
    switches = Machine(read_robot(LEVER), [planted], 2e-4, 5).switches
    link, motor, torque, dz = lever(planted, modes=[1] * len(switches), gates=np.zeros(1), z=0.3)
    assert abs(link) + abs(motor) + abs(dz) < 1e-10  # rounding
    assert torque == pytest.approx(spring())


# --- the machine ------------------------------------------------------------------------------------------
def test_dahls_friction_grows_with_the_path_to_its_level():
    held, start = held_at(0.2)
    states = run(read_robot(LEVER), [DAHL], start, [held + 4.0], 0.2)
    theta, w, z = states[:, 2], states[:, 3], states[:, 4]
    assert (w[1:] > 0).all() and z[-1] > 1.99
    np.testing.assert_allclose(z, 2.0 * -np.expm1(-(theta - theta[0]) / 0.004), atol=1e-6)
    back = run(read_robot(LEVER), [DAHL], states[-1], [held - 40.0], 0.4)
    assert back[-1, 3] < 0 and back[-1, 4] == pytest.approx(-2.0, abs=1e-3)


def test_breakaway_friction_holds_once_and_falls_with_the_path():
    robot = read_robot(LEVER)
    held, start = held_at(0.2)
    assert np.ptp(run(robot, [BREAKAWAY], start, [held + 2.9], 0.3)[:, 2]) == 0.0
    states = run(robot, [BREAKAWAY], start, [held + 12.0], 1.0)
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(states[:, 2])))])
    assert path[-1] > 0.02
    # the path is summed over substeps, which a reversal within one shortens
    np.testing.assert_allclose(states[:, 4], np.exp(-path / 0.05), atol=1e-6)
    worn = [*start, states[-1, 4]]
    level = 3.0 * states[-1, 4]
    assert np.ptp(run(robot, [BREAKAWAY], worn, [held + 0.97 * level], 0.1)[:, 2]) == 0.0
    assert np.ptp(run(robot, [BREAKAWAY], worn, [held + 1.03 * level], 0.1)[:, 2]) > 0.0


def test_a_creeping_spring_relaxes_while_it_is_held():
    robot = read_robot(LEVER)
    fixed = [
        Planted("motor_coulomb_friction", JOINT, {"level": 500.0}),
        Planted("link_coulomb_friction", JOINT, {"level": 500.0}),
    ]
    machine = Machine(robot, [CREEP, *fixed], 2e-4, 5)
    machine.x[:] = [0.2, 0.0, 0.23, 0.0, 0.03]
    u, gates = np.zeros((5, 1)), np.ones((5, 3))
    machine.settle(u[0], gates[0], 0.0)
    torque = np.concatenate([machine.advance(u, gates, k * 1e-3)[1] for k in range(1000)])[:, 0]
    time = 2e-4 * np.arange(1, 5001)
    expected = robot.stiffness[0] * 0.03 + 80.0 * 0.03 * np.exp(-time / 0.4)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


@pytest.mark.parametrize("q", [0.2, -0.2])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_lossy_drive_holds_its_load_as_its_levels_say(q, direction):
    robot = read_robot(LEVER)
    held, start = held_at(q)
    level = abs(held) * (0.1 if held * direction > 0 else 0.3)
    assert np.ptp(run(robot, [LOSSES], start, [held + 0.97 * direction * level], 0.2)[:, 2]) == 0.0
    moved = run(robot, [LOSSES], start, [held + 1.03 * direction * level], 0.2)[-1, 2] - start[2]
    assert moved * direction > 0


def test_a_rough_spot_holds_where_it_is():
    robot = read_robot(LEVER)
    for q, sticks in ((0.3, True), (0.1, False)):
        held, start = held_at(q)
        spot = replace(SPOT, parameters={**SPOT.parameters, "position": start[2] if sticks else 0.3})
        assert (np.ptp(run(robot, [spot], start, [held + 1.95], 0.1)[:, 2]) == 0.0) == sticks


def test_a_step_follows_an_independent_solver():
    robot = read_robot(LEVER)
    k, d, b, dm = (x[0] for x in (robot.stiffness, robot.damping, robot.motor_inertia, robot.motor_damping))
    limit = Planted("torque_speed_limit", JOINT, {"stall": 20.0, "drop": 6.0})
    inertia, flat, upright = lever_inertia(), lever_gravity(0.0), lever_gravity(np.pi / 2)

    def slope(t, x):
        q, dq, theta, w, z = x
        spring_torque = k * (theta - q) + d * (w - dq) + 80.0 * z
        link = spring_torque - flat * np.cos(q) - upright * np.sin(q) - 1.5 * abs(dq) * dq
        link += 1.2 * np.sin(2 * np.pi * 4.0 * t + 0.7)
        drive = min(max(25.0, -20.0 - 6.0 * w), 20.0 - 6.0 * w)
        motor = drive - spring_torque - dm * w
        return [dq, link / inertia, w, motor / b, w - dq - z / 0.4]

    x0 = np.array([0.1, 0.2, 0.12, 0.3, 0.0])
    exact = solve_ivp(slope, (0, 1), x0, method="DOP853", rtol=1e-10, atol=1e-12, max_step=1e-3).y[:, -1]
    ours = run(robot, [CREEP, DRAG, HUM, limit], x0, [25.0], 1.0)[-1]
    np.testing.assert_allclose(ours, exact, atol=1e-7)  # steps across the kinks of drag and limit


# --- recordings -------------------------------------------------------------------------------------------
def test_a_periodic_disturbance_has_its_phase_at_the_start_of_the_recording():
    recorded = plant(LEVER, [HUM], "rest", 2, 3, PERFECT, rate=1000)
    q, dq, torque = (recorded.true[c][:, 0] for c in ("q", "dq", "tau_t"))
    ddq = (8 * (dq[3:-1] - dq[1:-3]) - (dq[4:] - dq[:-4])) / 12e-3
    link = lever_inertia() * ddq + lever_gravity(q[2:-2]) - torque[2:-2]
    expected = 1.2 * np.sin(2 * np.pi * 4.0 * recorded.columns["time"][2:-2] + 0.7)
    np.testing.assert_allclose(link, expected, atol=2e-3)  # the quotient, where the held command jumps


@pytest.mark.parametrize("channel", ["q", "theta"])
def test_encoder_ripple(channel):
    parameters = {"amplitude": 0.002, "cycles": 14, "phase": 0.7, "channel": channel}
    recorded = plant(LEVER, [Planted("encoder_ripple", JOINT, parameters)], "slow", 2, 2, PERFECT)
    for c in ("q", "dq", "theta", "dtheta", "tau_t"):
        x = recorded.true[c][:, 0]
        expected = x + 0.002 * np.sin(14 * x + 0.7) if c == channel else x
        np.testing.assert_array_equal(recorded.columns[f"{c}.{JOINT}"], expected)


def test_a_torque_that_falls_with_the_speed():
    limit = Planted("torque_speed_limit", JOINT, {"stall": 10.0, "drop": 4.0})
    robot = read_robot(LEVER)
    recorded = plant(LEVER, [limit], "rich", 4, 2, CURRENT, rate=1000)
    w, tau, spring_torque = (recorded.true[c][:, 0] for c in ("dtheta", "tau", "tau_t"))
    clipped = np.isclose(tau, 10 - 4 * w, atol=0.05) | np.isclose(tau, -10 - 4 * w, atol=0.05)
    assert 0.02 < clipped.mean() < 0.98 and (np.abs(tau + 4 * w) < 10.05).all()
    mean = (tau[1:] + tau[:-1]) / 2
    np.testing.assert_allclose(recorded.columns[f"tau_motor.{JOINT}"][1:], mean, atol=0.1)
    middle = (spring_torque[1:] + spring_torque[:-1]) / 2
    inertial = robot.motor_inertia[0] * np.diff(w) * 1000
    left = tau[:-1] - inertial - robot.motor_damping[0] * (w[1:] + w[:-1]) / 2 - middle
    assert np.abs(left).max() < 0.1  # what the limit moves within a tick


def drive(effects, robot=LEVER, ticks=40, substeps=5):
    return Drive(read_robot(robot), effects, np.zeros(len(read_robot(robot).joints)), ticks, substeps)


def test_a_lag_gives_the_mean_of_its_step_response():
    constant = 0.008
    ours = drive([Planted("current_lag", JOINT, {"time_constant": constant})])
    commands = [np.array([2.0 if k < 3 else 5.0]) for k in range(40)]
    torque = np.concatenate([ours.apply(k, k * 1e-3, c)[:, 0] for k, c in enumerate(commands)])
    np.testing.assert_array_equal(torque[:15], 2.0)  # settled at the start
    edges = 2e-4 * np.arange(len(torque) - 14)
    for a, b, mean in zip(edges[:-1], edges[1:], torque[15:], strict=True):
        area = quad(lambda t: 5.0 - 3.0 * np.exp(-t / constant), a, b)[0]
        assert mean == pytest.approx(area / 2e-4, rel=1e-12)


def test_a_lag_that_sets_in_late_starts_from_the_torque_there_is_and_follows_a_delay():
    effects = [
        Planted("torque_delay", JOINT, {"delay": 0.001}),
        Planted("current_lag", JOINT, {"time_constant": 0.004}, since=0.006),
    ]
    ours = drive(effects)
    torque = [ours.apply(k, k * 1e-3, np.array([2.0 if k < 5 else 5.0]))[:, 0] for k in range(9)]
    np.testing.assert_array_equal(torque[5], 2.0)  # a tick late
    # from the 2 N m of the tick before on, to the 5 N m that are there by then
    share = 0.2 / 4
    assert torque[6][0] == pytest.approx(5.0 - 3.0 * -np.expm1(-share) / share)
    assert torque[8][4] == pytest.approx(5.0 - 3.0 * np.exp(-14 * share) * -np.expm1(-share) / share)


@pytest.mark.parametrize(
    ("joint", "side", "other"), [("elbow", "before", "shoulder"), ("shoulder", "after", "elbow")]
)
def test_a_coupled_motor_gets_a_share_of_what_its_neighbour_is_asked_for(joint, side, other):
    effects = [
        Planted("joint_coupling", joint, {"share": 0.1, "side": side}),
        Planted("torque_gain", joint, {"gain": 0.2}),
        Planted("torque_saturation", other, {"limit": 10.0}),
    ]
    recorded = plant(CRANE, effects, "rich", 2, 4, PERFECT, rate=1000)
    own, others = (recorded.columns[f"tau_m.{j}"] for j in (joint, other))
    tau = recorded.true["tau"][:, ("shoulder", "elbow").index(joint)]
    np.testing.assert_allclose(tau, 1.2 * own + 0.1 * others, atol=1e-12)
    assert np.abs(others).max() > 10.0  # as commanded, whatever its own drive makes of it


@pytest.mark.parametrize("effect", ["coupled_friction", "differential_friction"])
@pytest.mark.parametrize(("speed", "sign"), [("sum", 1.0), ("difference", -1.0)])
def test_a_shared_friction_acts_on_both_motors(effect, speed, sign):
    """From the recorded motion: what the motors' torques lack of inertia, damping and springs is the
    friction."""
    level, coefficient = 2.0, 1.5
    values = {"level": level, "coefficient": coefficient, "speed": speed}
    if effect == "differential_friction":  # of which the other motor is free
        ways = {"sum": 0.0, "difference": 0.0, speed: 1.0}
        values = {f"level_{way}": level * share for way, share in ways.items()}
        values |= {f"coefficient_{way}": coefficient * share for way, share in ways.items()}
    friction = Planted(effect, "elbow", values)
    recorded = plant(CRANE, [friction], "rich", 3, 4, PERFECT, rate=1000)
    robot, true = recorded.real, recorded.true
    acceleration = np.diff(true["dtheta"], axis=0) / 1e-3
    speeds, springs = ((true[key][1:] + true[key][:-1]) / 2 for key in ("dtheta", "tau_t"))
    # over each tick, in which the torque is held
    lacking = true["tau"][:-1] - springs - robot.motor_inertia * acceleration - robot.motor_damping * speeds
    shaft = speeds[:, 1] + sign * speeds[:, 0]
    f = level * np.sign(shaft) + coefficient * shaft
    turning = np.abs(shaft) > 0.1  # where it does not creep
    for j, share in ((1, 1.0), (0, sign)):  # of some N m; the mean of a tick's ends is not its mean
        assert np.max(np.abs(lacking[turning, j] - share * f[turning])) < 0.05


def test_a_current_shows_a_lag_and_what_comes_from_a_neighbour():
    coupled = Planted("joint_coupling", "elbow", {"share": 0.1})  # side: before
    lag = Planted("current_lag", "shoulder", {"time_constant": 0.008})
    offset = Planted("torque_offset", "shoulder", {"offset": 4.0})
    # both channels, to hold the one against the other
    sensors = replace(CURRENT, channels=(*CURRENT.channels, "tau_m"))
    recorded = plant(CRANE, [coupled, lag, offset], "steps", 2, 4, sensors, rate=1000)
    asked = {j: recorded.columns[f"tau_m.{j}"] for j in ("shoulder", "elbow")}
    shown = {j: recorded.columns[f"tau_motor.{j}"] for j in asked}
    total = asked["elbow"] + 0.1 * asked["shoulder"]
    np.testing.assert_allclose(shown["elbow"][1:], (total[1:] + total[:-1]) / 2, atol=1e-9)
    steps = 200  # of an exponential on the held command, in each tick; at rest for the first 0.4 s
    held, out = np.repeat(asked["shoulder"], steps), []
    now, share = held[0], np.exp(-1e-3 / steps / 0.008)
    for goal in held:
        now = goal + (now - goal) * share
        out.append(now)
    half = np.cumsum(out)
    centred = (half[3 * steps // 2 :: steps] - half[steps // 2 : -steps : steps]) / steps
    difference = shown["shoulder"][1:] - centred[: len(shown["shoulder"]) - 1]
    assert np.abs(difference[50:]).max() < 2e-2
    assert np.abs(shown["shoulder"] - asked["shoulder"]).max() > 1.0


def test_a_coupling_leaves_a_mark_above_the_noise():
    planted = usual_effect("joint_coupling", "crane", "elbow", np.random.default_rng(5))
    changed, healthy = (plant(CRANE, effects, "rich", 3, 11, PERFECT) for effects in ([planted], []))
    change = changed.columns["theta.elbow"] - healthy.columns["theta.elbow"]
    assert np.sqrt(np.mean(change**2)) > 3 * robot_noise("crane")["theta"]


# --- what cannot be planted -------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("robot", "effects", "message"),
    [
        (LEVER, [Planted("joint_coupling", JOINT, {"share": 0.1})], "lever has no joint before swing"),
        (CRANE, [Planted("joint_coupling", "elbow", {"share": 0.1, "side": "after"})], "no joint after"),
        (LEVER, [DAHL, CREEP], "swing has room for one state, not for dahl_friction and spring_creep"),
    ],
)
def test_what_a_robot_has_no_place_for_is_refused(robot, effects, message):
    with pytest.raises(ValueError, match=message):
        plant(robot, effects, "rich", 1, 1, PERFECT)


def test_words_are_checked():
    with pytest.raises(ValueError, match="side is one of before, after, got 'behind'"):
        Planted("joint_coupling", "elbow", {"share": 0.1, "side": "behind"})
    with pytest.raises(ValueError, match="channel is one of q, theta, got 'tau_t'"):
        Planted("encoder_ripple", JOINT, {"amplitude": 0.1, "cycles": 9, "channel": "tau_t"})
    with pytest.raises(ValueError, match="no usual size for 'rough_spot'"):
        usual_effect("rough_spot", "lever", JOINT, np.random.default_rng(0))
    with pytest.raises(ValueError, match="lever has one joint"):
        usual_effect("joint_coupling", "lever", JOINT, np.random.default_rng(0))
