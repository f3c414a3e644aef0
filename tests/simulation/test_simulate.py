"""The clockwork: ticks, delays, onsets, sensors, and recorded torques."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, one_of_each, waves

from flexjoint.core.errors import RecordingError, RobotError, SimulationError, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as table
from flexjoint.simulation.controllers import LinkPD, MotorPD, law_of
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs.pieces import simulated_in_pieces
from flexjoint.simulation.sensors import readings, true_signals
from flexjoint.simulation.simulate import command_rate, references_at, simulate, torque_over


def model_of(*effects: Planned) -> FlexibleJointModel:
    return FlexibleJointModel(make(PENDULUM), effects)


# ------------------------------------------------------------------ delays and onsets
@pytest.mark.parametrize("delay", [0.0, 0.004, 0.0125, 0.05])
def test_a_late_command_acts_exactly_so_much_later(delay: float) -> None:
    torque = waves(1, 400, 1000)
    plain, late = model_of(), model_of(effect("torque_delay", "joint", delay=delay))
    tape = rollout(late, late.rest(), torque, RunOptions(rate=1000.0))
    # a torque held over steps and delayed by a part of one has this mean over each step
    steps, share = divmod(delay * 1000, 1)
    padded = np.concatenate([np.tile(torque[:1], (60, 1)), torque])
    rows = 60 + np.arange(400) - round(steps)
    shifted = (1 - share) * padded[rows] + share * padded[rows - 1]
    expected = rollout(plain, plain.rest(), shifted, RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q[tape.first :], expected.q, atol=1e-13)
    np.testing.assert_allclose(tape.tau_m[tape.first : -1], torque)  # recorded as commanded


def test_a_late_reading_is_the_true_signal_so_much_earlier() -> None:
    model = model_of(
        effect("sensor_delay", "joint", delay=0.0065, channel="q"),
        effect("link_encoder_offset", "joint", offset=0.2),
    )
    tape = rollout(model, model.rest(), waves(1, 400, 1000), RunOptions(rate=1000.0))
    true, seen = true_signals(model, tape), readings(model, tape)
    at = tape.time[tape.first :]
    for channel, offset in (("q", 0.2), ("dq", 0.0)):
        expected = np.interp(at - 0.0065, tape.time, true[channel, "joint"]) + offset
        np.testing.assert_allclose(seen[channel, "joint"], expected, atol=1e-14)
    np.testing.assert_array_equal(seen["theta", "joint"], true["theta", "joint"][tape.first :])


def test_an_effect_sets_in_at_its_time() -> None:
    torque = waves(1, 600, 1000)
    plain, whole = model_of(), model_of(effect("motor_inertia", "joint", scale=1.0))
    late = model_of(replace(effect("motor_inertia", "joint", scale=1.0), since=0.3))
    nominal, with_onset = (rollout(m, m.rest(), torque, RunOptions(rate=1000.0)) for m in (plain, late))
    np.testing.assert_array_equal(with_onset.q[:301], nominal.q[:301])
    assert np.max(np.abs(with_onset.q[301:] - nominal.q[301:])) > 1e-4
    resumed = rollout(whole, with_onset.state(300), torque[300:], RunOptions(rate=1000.0))
    # all but the scheme's memory of the last step goes on alike
    np.testing.assert_allclose(resumed.q[-1], with_onset.q[-1], atol=1e-5)


def test_a_load_is_put_down_and_picked_again() -> None:
    torque, options = waves(1, 600, 1000), RunOptions(rate=1000.0)
    numbers = {"mass": 1.0, "position": (0.0, 0.0, -0.5)}
    bare = model_of()
    held, placed, picked = (
        model_of(effect("payload", "joint", switches=switches, **numbers))
        for switches in ((), (0.2,), (0.2, 0.4))
    )
    always, once, twice = (rollout(m, bare.rest(), torque, options) for m in (held, placed, picked))
    np.testing.assert_array_equal(once.q[:201], always.q[:201])
    np.testing.assert_array_equal(twice.q[:401], once.q[:401])
    assert np.max(np.abs(once.q[201:401] - always.q[201:401])) > 1e-3
    # all but the scheme's memory of the last step goes on as without and with the load
    for one, at, model in ((once, 200, bare), (twice, 400, held)):
        resumed = rollout(model, one.state(at), torque[at:], options)
        np.testing.assert_allclose(resumed.q[-1], one.q[-1], atol=1e-5)


def test_a_sensor_effect_sets_in_at_its_time() -> None:
    model = model_of(replace(effect("motor_encoder_offset", "joint", offset=0.5), since=0.2))
    tape = rollout(model, model.rest(), waves(1, 400, 1000), RunOptions(rate=1000.0))
    jump = readings(model, tape)["theta", "joint"] - true_signals(model, tape)["theta", "joint"]
    np.testing.assert_allclose(jump, np.where(tape.time < 0.2 - 1e-9, 0.0, 0.5), atol=1e-12)


# ------------------------------------------------------------------ controller
def test_the_controller_holds_its_torque_between_ticks() -> None:
    robot = make(PENDULUM, rates={"physics": 1000, "control": 250})
    model = FlexibleJointModel(robot, [])
    assert physics_rate(robot) == 1000
    ticks = {name: np.zeros((50, 1)) for name in ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")}
    ticks["theta_ref"][10:] = 0.1
    tape = closed_loop(model, model.rest(), law_of(robot), ticks, RunOptions(rate=1000.0))
    tau = tape.tau_m[:-1, 0].reshape(50, 4)
    assert np.all(tau == tau[:, :1])
    assert np.all(tau[:10] == 0.0)  # the step acts from its own tick on
    expected = 1100 * (0.1 - tape.theta[40, 0]) - 12 * tape.dtheta[40, 0]
    assert tau[10, 0] == pytest.approx(np.clip(expected, -45, 45))


def test_whole_steps_to_a_tick_take_a_raised_physics_rate() -> None:
    assert physics_rate(make(PENDULUM, rates={"physics": 1000, "control": 300})) == 1200
    assert physics_rate(make(PENDULUM, rates={"physics": 500, "control": 1000})) == 1000


def test_the_law_saturates_the_total_torque_and_reads_the_sensors() -> None:
    law = MotorPD(np.array([100.0]), np.array([2.0]), np.array([30.0]))
    zero = np.zeros(1)
    ref = {
        "q_ref": zero,
        "theta_ref": np.array([0.5]),
        "dtheta_ref": np.array([1.0]),
        "tau_ff": np.array([-8.0]),
    }
    reading = {"theta": np.array([0.2]), "dtheta": np.array([-0.5])}
    assert law.torque(ref, reading) == pytest.approx(-8 + 100 * 0.3 + 2 * 1.5)
    assert law.torque({**ref, "tau_ff": np.array([20.0])}, reading) == 30.0
    offset = effect("motor_encoder_offset", "joint", offset=0.03)
    ticks = {name: np.zeros((1, 1)) for name in ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")}
    model = model_of(offset)
    tape = closed_loop(model, model.rest(), law_of(model.robot), ticks, RunOptions(rate=1000.0))
    assert tape.tau_m[0, 0] == pytest.approx(-1100 * 0.03)


def test_a_robots_sensing_delay_reaches_its_controller() -> None:
    ticks = {name: np.zeros((60, 1)) for name in ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")}
    robot = make(PENDULUM, sensing_delay=0.003)
    model = FlexibleJointModel(robot, [])
    start = model.rest(np.array([0.02]))
    tape = closed_loop(model, start, law_of(robot), ticks, RunOptions(rate=1000.0))
    row = tape.first + 40
    expected = -1100 * tape.theta[row - 3, 0] - 12 * tape.dtheta[row - 3, 0]
    assert tape.tau_m[row, 0] == pytest.approx(expected, rel=1e-12)


def test_controllers_are_chosen_by_name_with_named_gains() -> None:
    law = law_of(make(PENDULUM, {"joint": {"controller": {"name": "link_pd", "kp": 50}}}))
    assert isinstance(law, LinkPD)
    assert (law.kp, law.kd, law.limit) == (50.0, 12.0, 45.0)
    with pytest.raises(UnknownNameError, match="link_pd, motor_pd"):
        law_of(make(PENDULUM, {"joint": {"controller": "pid"}}))
    with pytest.raises(UnknownNameError, match="kd, kp, limit"):
        law_of(make(PENDULUM, {"joint": {"controller": {"ki": 3}}}))
    with pytest.raises(RobotError, match="must be a number"):
        law_of(make(PENDULUM, {"joint": {"controller": {"kp": "high"}}}))


# ------------------------------------------------------------------ recorded torque
@pytest.mark.parametrize(
    ("physics", "control", "sampled", "expected"),
    [(1000, 500, 1000, 500), (1000, 300, 1000, 1000), (500, 1200, 500, 500), (500, 1200, 1200, 1200)],
)
def test_commands_change_on_ticks_or_where_these_fall_between_steps_on_steps(
    physics: int, control: int, sampled: int, expected: int
) -> None:
    robot = make(PENDULUM, rates={"physics": physics, "control": control})
    time = np.arange(200) / sampled
    assert command_rate(robot, recorded("tau_m", time, np.zeros(200))) == expected


def recorded(channel: str, time: np.ndarray, values: np.ndarray) -> Recording:
    return table(time, {(channel, "joint"): values, ("q", "joint"): np.zeros_like(time)})


def test_a_recorded_command_is_held_and_missed_ticks_are_interpolated() -> None:
    time = np.arange(100) / 500  # f_c is 1 kHz: every second tick is missing
    command = np.where(np.arange(100) % 3 == 0, 4.0, -1.0)
    edges = np.arange(50, 121) / 1000
    torque = torque_over(recorded("tau_m", time, command), ("joint",), edges, 1000.0)[:, 0]
    np.testing.assert_allclose(torque, np.interp(edges[:-1], time, command), atol=1e-10)  # held from its tick
    finer = np.arange(500, 1201) / 10000
    held = torque_over(recorded("tau_m", time, command), ("joint",), finer, 1000.0)[:, 0]
    np.testing.assert_allclose(held, np.repeat(torque, 10), atol=1e-9)


def test_a_measured_torque_is_interpolated_and_not_held() -> None:
    time = np.arange(100) / 500
    edges = np.arange(50, 121) / 1000
    torque = torque_over(recorded("tau_motor", time, np.sin(30 * time)), ("joint",), edges, 1000.0)[:, 0]
    np.testing.assert_allclose(torque, np.interp(edges[:-1] + 5e-4, time, np.sin(30 * time)), atol=1e-12)
    with pytest.raises(RecordingError, match="no tau_m or tau_motor for joint elbow"):
        torque_over(recorded("tau_m", time, time), ("joint", "elbow"), edges, 1000.0)


def test_missing_cells_of_a_command_are_bridged() -> None:
    time = np.arange(100) / 1000
    command = 20.0 * time
    command[[10, 50, 51]] = np.nan
    torque = torque_over(recorded("tau_m", time, command), ("joint",), time[5:80], 1000.0)[:, 0]
    np.testing.assert_allclose(torque, 20.0 * time[5:79], atol=1e-11)


# ------------------------------------------------------------------ simulate
def reference(robot_joints: tuple[str, ...], seconds: float = 1.0, rate: float = 500.0) -> Recording:
    time = 3.0 + np.arange(round(seconds * rate)) / rate  # a recording need not begin at 0
    columns = {}
    for k, joint in enumerate(robot_joints):
        columns["q_ref", joint] = 0.2 * (1 - np.cos(2 * np.pi * (1 + 0.3 * k) * (time - 3.0)))
    return table(time, columns, "waves")


def test_a_simulation_has_the_form_of_a_recording() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("motor_encoder_offset", "hip", offset=0.1)])
    run = simulate(model, reference(("hip", "knee")), sample_rate=500)
    channels = {channel for channel, _ in run.measured.columns}
    assert channels == {
        "q", "dq", "theta", "dtheta", "tau_t", "tau_m", "q_ref", "theta_ref", "dtheta_ref", "tau_ff"
    }  # fmt: skip
    assert run.measured.time[0] == 3.0
    np.testing.assert_allclose(np.diff(run.measured.time), 0.002, atol=1e-12)
    np.testing.assert_allclose(
        run.measured.get("theta", "hip") - run.true.get("theta", "hip"), 0.1, atol=1e-12
    )
    np.testing.assert_array_equal(run.measured.get("tau_m", "hip"), run.true.get("tau_m", "hip"))


def test_absent_references_are_made_from_the_nominal_model() -> None:
    robot = make(PENDULUM)
    extended = FlexibleJointModel(robot.extended([effect("spring_stiffness", "joint", scale=-0.5)]))
    made = references_at(extended, reference(("joint",)), np.array([3.1, 3.2]))
    gravity = 2.4 * 9.81 * 0.26 * np.sin(made["q_ref"])
    np.testing.assert_allclose(made["tau_ff"], gravity, atol=1e-12)
    np.testing.assert_allclose(made["theta_ref"], made["q_ref"] + gravity / 340, atol=1e-13)  # K as nominal
    with pytest.raises(RecordingError, match="no q_ref for joint knee"):
        references_at(FlexibleJointModel(make(PLANAR), []), reference(("hip",)), np.array([3.1]))


def test_a_simulated_command_drives_the_same_motion_open_loop() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("motor_coulomb_friction", "hip", level=1.0)])
    first = simulate(model, reference(("hip", "knee")))
    again = simulate(model, first.measured, drive="torque", start=first.trajectory.state(0))
    rows = slice(0, len(first.true.time))
    # the command passes through a running sum of impulses, exact to about 1e-12 N m
    np.testing.assert_allclose(again.true.get("q", "hip")[rows], first.true.get("q", "hip"), atol=1e-9)


def test_noise_is_seeded_and_readings_are_rounded_to_their_resolution() -> None:
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"resolution": {"q": 1e-3}}}), [])
    noise = {"q": 1e-4, "tau_t": 0.05}
    runs = [simulate(model, reference(("joint",)), noise=noise, seed=seed) for seed in (1, 1, 2)]
    same, other = (runs[0].measured.get("tau_t", "joint"), runs[2].measured.get("tau_t", "joint"))
    np.testing.assert_array_equal(same, runs[1].measured.get("tau_t", "joint"))
    assert np.std(same - runs[0].true.get("tau_t", "joint")) == pytest.approx(0.05, rel=0.1)  # 1000 samples
    assert not np.array_equal(same, other)
    counts = runs[0].measured.get("q", "joint") / 1e-3
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)


def test_a_simulation_repeats_bit_for_bit() -> None:
    model = FlexibleJointModel(
        make(SPATIAL), [effect("stribeck_friction", "yaw"), effect("backlash", "roll")]
    )
    one, two = (simulate(model, reference(("yaw", "roll", "pitch"))) for _ in range(2))
    for key, values in one.measured.columns.items():
        np.testing.assert_array_equal(values, two.measured.columns[key])


@pytest.mark.parametrize("planned", one_of_each("roll"), ids=lambda planned: planned.effect.name)
def test_every_effect_simulates_without_a_floating_point_error(planned: Planned) -> None:
    model = FlexibleJointModel(make(SPATIAL), [planned])
    with np.errstate(all="raise"):
        run = simulate(model, reference(("yaw", "roll", "pitch"), seconds=0.4))
    assert all(np.all(np.isfinite(values)) for values in run.measured.columns.values())


def test_all_effects_at_once_and_rigid_joints_simulate() -> None:
    effects = [e for e in one_of_each("roll") if e.joint is None or not e.effect.whole_robot]
    run = simulate(FlexibleJointModel(make(SPATIAL), effects), reference(("yaw", "roll", "pitch")))
    assert np.all(np.isfinite(run.measured.get("q", "roll")))
    rigid = make(SPATIAL, {"roll": {"stiffness": math.inf}})
    on_one = [e for e in effects if not (e.effect.needs_spring or e.effect.reaches_before)]
    on_rigid = FlexibleJointModel(rigid, on_one)
    run = simulate(on_rigid, reference(("yaw", "roll", "pitch")))
    np.testing.assert_array_equal(run.true.get("q", "roll"), run.true.get("theta", "roll"))


def test_a_rigid_joints_transmission_torque_is_what_its_link_takes() -> None:
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"stiffness": math.inf}}), [])
    run = simulate(model, reference(("joint",)))
    q, v, t = run.true.get("q", "joint"), run.true.get("dq", "joint"), run.true.time
    load = (0.05 + 2.4 * 0.26**2) * np.gradient(v, t) + 2.4 * 9.81 * 0.26 * np.sin(q)
    # it is the torque of the step's midpoint: half a step late, and differences blur
    np.testing.assert_allclose(run.true.get("tau_t", "joint")[50:-50], load[50:-50], atol=0.05)


def test_what_cannot_be_simulated_is_refused_with_a_remedy() -> None:
    model = model_of()
    with pytest.raises(SimulationError, match=r"sample_rate must divide .* 1000 Hz"):
        simulate(model, reference(("joint",)), sample_rate=300)
    with pytest.raises(SimulationError, match=r"torque: expected \(N, 1\)"):
        rollout(model, model.rest(), np.zeros((5, 2)), RunOptions(rate=1000.0))
    wild = model_of(
        Planned(effect("link_viscous_friction", "joint").effect, "joint", {"coefficient": -900.0})
    )
    with pytest.raises(SimulationError, match=r"finite numbers at joint joint, t = .* s"):
        rollout(wild, wild.rest(), np.ones((5000, 1)), RunOptions(rate=1000.0, engine="pin"))
    with pytest.raises(RecordingError, match="no tau_m or tau_motor"):
        simulate(model, reference(("joint",)), drive="torque")


def test_a_robot_is_simulated_as_its_model_is_and_what_is_neither_is_refused() -> None:
    robot = make(PENDULUM)
    reference = table(np.linspace(0.0, 0.2, 201), {("q_ref", "joint"): np.zeros(201)}, "still")
    of_robot, of_model = (simulate(one, reference) for one in (robot, FlexibleJointModel(robot)))

    np.testing.assert_array_equal(of_robot.trajectory.q, of_model.trajectory.q)
    with pytest.raises(RobotError, match="simulate: expected a robot first"):
        simulate("arm.yaml", reference)  # type: ignore[arg-type]


def test_a_result_beyond_the_largest_recording_is_refused_before_it_is_made() -> None:
    """9e6 steps of one joint are within what is run, but their 11 columns are more than a recording has."""
    robot = make(PENDULUM)
    (name,) = robot.joint_names
    seconds = 1.001e8 / 11.0 / physics_rate(robot)
    time = np.arange(0.0, seconds, 0.25)
    reference = table(time, {("q_ref", name): np.sin(time)})
    with pytest.raises(SimulationError, match=r"rows of 11 columns, at most 1e\+08 cells are kept"):
        simulate(robot, reference)


# ------------------------------------------------------------------ pauses
def with_a_pause(seconds: float) -> Recording:
    """A second at 250 Hz with a pause in its middle."""
    time = np.arange(250) / 250.0
    time[125:] += seconds
    return Recording(time, {("q_ref", "joint"): np.full(250, 0.3)}, name="paused.csv")


@pytest.mark.parametrize("seconds", [1000.0, 1e5, 1e9])
@pytest.mark.parametrize("run", [simulate, lambda *given: list(simulated_in_pieces(*given))])
def test_a_long_pause_is_refused_before_it_is_walked_through(
    run: Callable[..., object], seconds: float
) -> None:
    with pytest.raises(SimulationError) as refused:
        run(model_of(), with_a_pause(seconds))
    assert f"the longest pause is {seconds + 0.004:.4g} s at 0.496 s; cut it" in str(refused.value)


@pytest.mark.parametrize("seconds", [2.0, 20.0])
def test_a_short_pause_is_simulated(seconds: float) -> None:
    """A reference made by hand may hold its last sample but one for more than ten periods each."""
    done = simulate(model_of(), with_a_pause(seconds))
    assert done.measured.duration == pytest.approx(seconds + 0.996)
