"""Simulation against recording: windows, sums, start states, what recordings lack."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.robots.arms import PLANAR, make

from flexjoint.core.errors import RecordingError, SimulationError
from flexjoint.core.running.budget import Budget
from flexjoint.diagnosis.comparison.compare import Comparison, compare
from flexjoint.diagnosis.comparison.estimate import StateEstimator
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.smooth import local_polynomial, noise
from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as table
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import command_rate, simulate, torque_over

NOISE = {"q": 2e-5, "theta": 2e-5, "dq": 4e-3, "dtheta": 4e-3, "tau_t": 0.05}
JOINTS = ("hip", "knee")


def reference(joints: tuple[str, ...], seconds: float) -> Recording:
    time = np.arange(round(seconds * 1000)) / 1000
    columns = {}
    for k, joint in enumerate(joints):
        sweep = (0.8 + 0.4 * k) * time + 0.25 * time**2  # 0.8 to some 3 Hz
        columns["q_ref", joint] = 0.25 * np.sin(2 * np.pi * sweep) * np.minimum(time / 0.5, 1.0)
    return table(time, columns, "sweep")


def recorded(*effects: Planned) -> Recording:
    """A planar arm with these effects, 3 s at 500 Hz with noise; the nominal controller drives it."""
    model = FlexibleJointModel(make(PLANAR), effects)
    return simulate(model, reference(JOINTS, 3.0), sample_rate=500, noise=NOISE, seed=3).measured


def only(recording: Recording, *channels: str) -> Recording:
    columns = {key: values for key, values in recording.columns.items() if key[0] in channels}
    return table(recording.time, columns, recording.name)


def judged(recording: Recording, *effects: Planned, robot: Robot | None = None) -> Comparison:
    return compare(FlexibleJointModel(robot or make(PLANAR), effects), recording)


def excess(result: Comparison) -> float:
    """The largest RMS in units of the noise, for what is well above it."""
    worst = 0.0
    for name, value in result.rms.items():
        channel = name.split(".")[0]
        worst = max(worst, value / (NOISE["q"] if channel == "phi" else NOISE[channel]))
    return worst


# ------------------------------------------------------------------ the sums
def test_the_true_model_is_left_with_the_noise() -> None:
    result = judged(recorded())
    assert result.windows == 6
    for joint in JOINTS:
        # start states from noisy samples cost positions some noise levels, drifting over half a second
        assert result.rms[f"q.{joint}"] < 10 * NOISE["q"]
        assert result.rms[f"dq.{joint}"] < 1.1 * NOISE["dq"]
        assert result.rms[f"tau_t.{joint}"] < 1.1 * NOISE["tau_t"]
        assert result.rms[f"phi.{joint}"] < 1.5 * math.sqrt(2) * NOISE["q"]


@pytest.mark.parametrize(
    "planned",
    [
        effect("motor_coulomb_friction", "hip", level=2.5),
        effect("backlash", "knee", gap=0.009),
        effect("spring_hysteresis", "knee", level=1.1, scale=3e-3),
        effect("torque_delay", "knee", delay=0.005),
        effect("sensor_delay", "knee", delay=0.006, channel="q"),
        effect("link_encoder_offset", "hip", offset=-0.02),
        effect("encoder_eccentricity", "hip", amplitude=3e-3, phase=1.0, channel="theta"),
        effect("torque_sensor_gain", "hip", gain=-0.1),
        effect("payload", "knee", mass=0.4, position=(0.02, 0.0, -0.26)),
    ],
    ids=lambda planned: planned.effect.name,
)
def test_naming_the_effect_brings_the_error_down_to_the_noise(planned: Planned) -> None:
    recording = recorded(planned)
    assert excess(judged(recording, planned)) < 12  # as for the true model above
    nominal, extended = judged(recording), judged(recording, planned)
    assert np.mean(list(nominal.nrmse.values())) > 3 * np.mean(list(extended.nrmse.values()))


def test_rms_and_nrmse_are_what_they_say() -> None:
    recording = recorded(effect("motor_coulomb_friction", "hip", level=2.5))
    result = judged(recording)
    for name in ("q.hip", "tau_t.knee"):
        channel, joint = name.split(".")
        measured = recording.get(channel, joint)
        error = result.simulated[channel, joint] - measured
        assert result.rms[name] == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=1e-12)
        assert result.nrmse[name] == pytest.approx(result.rms[name] / np.std(measured), rel=1e-12)
    phi = recording.get("theta", "hip") - recording.get("q", "hip")
    error = result.simulated["theta", "hip"] - result.simulated["q", "hip"] - phi
    assert result.rms["phi.hip"] == pytest.approx(np.std(error), rel=1e-9)  # about its mean
    assert result.nrmse["phi.hip"] == pytest.approx(np.std(error) / np.std(phi), rel=1e-9)


def test_a_last_partial_window_is_dropped() -> None:
    recording = recorded()
    result = compare(FlexibleJointModel(make(PLANAR), []), recording, horizon=0.7)
    assert (result.windows, result.horizon) == (4, 0.7)
    inside = np.isfinite(result.simulated["q", "hip"])
    np.testing.assert_array_equal(inside, recording.time < 2.8 - 1e-9)
    with pytest.raises(RecordingError, match=r"window of 5 s does not fit into 3 s"):
        compare(FlexibleJointModel(make(PLANAR), []), recording, horizon=5.0)
    with pytest.raises(RecordingError, match="horizon > 0"):
        compare(FlexibleJointModel(make(PLANAR), []), recording, horizon=0.0)


def test_the_json_form_is_plain() -> None:
    text = json.loads(json.dumps(judged(recorded()).to_json()))
    assert set(text) == {"rms", "nrmse", "horizon", "windows"}
    assert text["horizon"] == 0.5
    assert {"q.hip", "tau_t.knee", "phi.hip"} <= set(text["rms"])


def test_missing_cells_count_in_no_sum() -> None:
    recording = recorded()
    columns = {key: values.copy() for key, values in recording.columns.items()}
    lost = np.random.default_rng(0).random(len(recording.time)) < 0.05
    columns["q", "hip"][lost] = np.nan
    columns["tau_m", "hip"][lost] = np.nan
    result = judged(table(recording.time, columns))
    assert excess(result) < 12
    error = (result.simulated["q", "hip"] - columns["q", "hip"])[~lost]
    assert result.rms["q.hip"] == pytest.approx(np.sqrt(np.mean(error**2)))


def test_a_window_counts_up_to_a_gap_in_its_drive() -> None:
    recording = recorded()
    gone = (recording.time > 1.7) & (recording.time < 1.9)
    rest = Recording(recording.time[~gone], {k: v[~gone] for k, v in recording.columns.items()}, "gap")
    result = judged(rest)
    counted = np.isfinite(result.simulated["q", "hip"])
    blind = (rest.time > 1.75) & (rest.time < 2.0)
    assert result.windows == 6
    assert not np.any(counted[blind])
    assert np.all(counted[(rest.time < 1.69) | (rest.time >= 2.0)])
    assert excess(result) < 12


# ------------------------------------------------------------------ drives
def test_without_a_command_the_controller_drives() -> None:
    friction = effect("motor_coulomb_friction", "hip", level=2.5)
    recording = recorded(friction)
    silent = table(recording.time, {k: v for k, v in recording.columns.items() if k[0] != "tau_m"})
    assert excess(judged(silent, friction)) < 12
    closed = compare(FlexibleJointModel(make(PLANAR), [friction]), recording, closed_loop=True)
    assert closed.rms == judged(silent, friction).rms
    with pytest.raises(RecordingError, match="no q_ref for joint hip"):
        judged(only(recording, "q", "theta"))


@pytest.mark.parametrize(("physics", "control"), [(1000, 300), (1000, 1300), (500, 1200)])
def test_any_two_rates_are_simulated_and_compared(physics: int, control: int) -> None:
    """Commands begin on steps, between ticks; a recording of every step has them all."""
    robot = make(PLANAR, rates={"physics": physics, "control": control})
    model = FlexibleJointModel(robot, [])
    run = simulate(model, reference(JOINTS, 3.0), noise=NOISE, seed=3)
    recording, tape = run.measured, run.trajectory
    assert recording.period == pytest.approx(1.0 / physics, rel=1e-9)
    edges = np.arange(len(recording.time)) / physics
    torque = torque_over(recording, JOINTS, edges, command_rate(robot, recording))
    np.testing.assert_allclose(torque, tape.tau_m[tape.first : tape.first + len(torque)], atol=1e-9)
    for closed_loop in (False, True):
        # as of the true model above, beside the ripple that uneven ticks leave in the start states
        assert excess(compare(model, recording, closed_loop=closed_loop)) < 12


def test_a_late_sensor_in_the_loop_starts_from_the_measured_past() -> None:
    late = effect("sensor_delay", "knee", delay=0.006, channel="theta")
    recording = recorded(late)
    silent = only(recording, "q", "theta", "q_ref", "theta_ref", "tau_ff")
    assert excess(judged(silent, late)) < 12


def test_a_measured_motor_torque_drives_as_well() -> None:
    recording = recorded()
    columns = {k: v for k, v in recording.columns.items() if k[0] != "tau_m"}
    for joint in JOINTS:  # what a sensor shows of a held command: the middle of its step
        held = recording.get("tau_m", joint)
        columns["tau_motor", joint] = np.interp(recording.time - 5e-4, recording.time, held)
    assert excess(judged(table(recording.time, columns))) < 12


# ------------------------------------------------------------------ start states
def test_start_states_are_close_to_the_true_ones() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    run = simulate(model, reference(JOINTS, 3.0), sample_rate=500, noise=NOISE, seed=5)
    estimator = StateEstimator(run.measured, model)
    rows = np.arange(50, 1450, 7)
    motion = estimator.at(run.measured.time[rows])
    for k, joint in enumerate(JOINTS):
        for found, channel, bound in (
            (motion.q[:, k], "q", NOISE["q"]),
            (motion.theta[:, k], "theta", NOISE["q"]),
            (motion.v[:, k], "dq", NOISE["dq"]),
            (motion.dtheta[:, k], "dtheta", NOISE["dq"]),
        ):
            # smoothing over some nine samples: below the noise of one
            assert np.sqrt(np.mean((found - run.true.get(channel, joint)[rows]) ** 2)) < 0.8 * bound


@pytest.mark.parametrize(
    "channels", [("theta", "dtheta"), ("theta",), ("theta", "tau_t"), ("q", "tau_t"), ("q",)]
)
def test_a_side_without_an_encoder_follows_from_the_rest(channels: tuple[str, ...]) -> None:
    friction = effect("motor_coulomb_friction", "hip", level=2.5)
    recording = recorded(friction)
    result = judged(only(recording, *channels, "tau_m"), friction)
    measured = {name.split(".")[0] for name in result.rms}
    assert measured == set(channels)
    # 0.05 N m of sensor noise is 6e-5 to 1.2e-4 rad of deflection; an acceleration from an encoder is no
    # better; the drift over half a second triples it
    for joint in JOINTS:
        assert result.rms[f"{channels[0]}.{joint}"] < 4e-4
    wrong = judged(only(recording, *channels, "tau_m"))
    assert wrong.rms[f"{channels[0]}.hip"] > 5 * result.rms[f"{channels[0]}.hip"]


def test_internal_states_start_where_the_recording_left_them() -> None:
    hysteresis = effect("spring_hysteresis", "knee", level=1.1, scale=3e-3)
    model = FlexibleJointModel(make(PLANAR), [hysteresis])
    run = simulate(model, reference(JOINTS, 2.0), sample_rate=500, noise=NOISE)
    found = StateEstimator(run.measured, model).at(run.measured.time)
    tape = run.trajectory
    true = tape.z[tape.first : -1 : 2, 0]
    assert np.std(true) > 0.5
    assert np.sqrt(np.mean((found.z[:, 0] - true) ** 2)) < 0.05  # of a loop of +-1.1 N m


def test_offsets_of_a_recording_are_a_nuisance_where_the_robot_says_so() -> None:
    recording = recorded()
    columns = {key: values.copy() for key, values in recording.columns.items()}
    columns["theta", "hip"] = columns["theta", "hip"] + 0.3
    shifted = table(recording.time, columns)
    robot = make(PLANAR, offsets="per_recording")
    assert StateEstimator(shifted, FlexibleJointModel(robot, [])).offsets["hip"] == pytest.approx(
        0.3, abs=1e-4
    )
    assert excess(judged(shifted, robot=robot)) < 15
    assert judged(shifted).rms["q.hip"] > 0.01


def test_what_cannot_be_compared_is_refused_with_a_remedy() -> None:
    recording = recorded()
    columns = {k: v for k, v in recording.columns.items() if k not in (("q", "hip"), ("theta", "hip"))}
    with pytest.raises(RecordingError, match="joint hip has neither q nor theta"):
        judged(table(recording.time, columns))
    with pytest.raises(RecordingError, match="no q for the passive joint knee"):
        hip = {key: values for key, values in recording.columns.items() if key[1] == "hip"}
        judged(table(recording.time, hip), robot=make(PLANAR, {"knee": None}))
    with pytest.raises(SimulationError, match="floating base"):
        judged(recording, robot=make(PLANAR, base="floating"))


def test_rigid_and_passive_joints_are_compared() -> None:
    robot = make(PLANAR, {"hip": {"stiffness": math.inf}, "knee": None})
    model = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "hip", level=1.0)])
    run = simulate(model, reference(("hip",), 2.0), sample_rate=500, noise=NOISE)
    columns = {k: v for k, v in run.measured.columns.items() if k[0] in ("theta", "dtheta", "tau_m")}
    tape = run.trajectory
    columns["q", "knee"] = tape.q[tape.first : -1 : 2, 1]  # the passive joint has an encoder too
    result = compare(model, table(run.measured.time, columns))
    assert result.rms["theta.hip"] < 10 * NOISE["theta"]


# ------------------------------------------------------------------ clocks and smoothing
def test_jittered_stamps_of_a_regular_clock_are_put_back() -> None:
    recording = recorded()
    random = np.random.default_rng(2)
    keep = np.sort(random.permutation(len(recording.time))[: round(0.95 * len(recording.time))])
    late = recording.time[keep] + 4e-4 * random.random(len(keep))
    columns = {key: values[keep] for key, values in recording.columns.items()}
    restored = on_regular_clock(table(late, columns))
    offset = np.mean(restored.time - recording.time[keep])
    np.testing.assert_allclose(restored.time - offset, recording.time[keep], atol=2e-5)  # of 0.4 ms jitter
    assert excess(judged(table(late, columns))) < 12
    truly = {k: np.interp(late, recording.time, v) for k, v in recording.columns.items()}
    sampled = table(late, truly)  # here the stamps tell the truth
    assert on_regular_clock(sampled) is sampled
    assert on_regular_clock(recording) is recording


@pytest.mark.parametrize("sampled_late", [False, True])
def test_a_slow_noisy_motion_tells_whether_its_stamps_are_late(sampled_late: bool) -> None:
    """Stamps up to 0.4 ms late at 0.2 rad/s make 23 urad, about the sensors' noise: no sample tells by itself
    whether it was as late as its stamp, all together do to a few per cent."""
    random = np.random.default_rng(5)
    ticks = 0.002 * np.arange(5000)
    late = ticks + 4e-4 * random.random(ticks.size)
    motion = 0.2 * np.sin(late if sampled_late else ticks)
    measured = motion + NOISE["q"] * random.standard_normal(ticks.size)
    recording = table(late, {("q", "hip"): measured})
    restored = on_regular_clock(recording)
    if sampled_late:
        assert restored is recording
    else:
        np.testing.assert_allclose(restored.time - ticks, restored.time[0], atol=2e-5)  # of 0.4 ms jitter


def test_local_polynomials_reproduce_cubics_and_widen_over_gaps() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0, 1, 400))
    time = time[(time < 0.4) | (time > 0.5)]
    cubic = np.polynomial.Polynomial([0.3, -2.0, 5.0, 4.0])
    at = np.linspace(0.0, 1.0, 57)
    found = local_polynomial(time, cubic(time), at, 5e-3, time, cubic.deriv()(time), 1e-4)
    for values, order, tolerance in zip(found, (0, 1, 2), (1e-7, 1e-5, 1e-2), strict=True):
        # the ridge of 1e-9 that keeps thin windows solvable
        np.testing.assert_allclose(values, cubic.deriv(order)(at) if order else cubic(at), atol=tolerance)


def test_noise_is_read_off_a_moving_signal() -> None:
    random = np.random.default_rng(4)
    signal = np.sin(np.arange(4000) * 0.05) + 1e-3 * random.standard_normal(4000)
    assert noise(signal) == pytest.approx(1e-3, rel=0.1)  # sampling error of a median over 4000
    signal[::7] = np.nan
    signal[1000:] += 5.0  # a jump leaves it alone
    assert noise(signal) == pytest.approx(1e-3, rel=0.15)
    assert noise(np.zeros(5)) == 0.0


def test_a_comparison_repeats_bit_for_bit() -> None:
    recording = recorded(effect("backlash", "knee", gap=0.009))
    one, two = (judged(recording, effect("backlash", "knee", gap=0.009)) for _ in range(2))
    simulated: Mapping[tuple[str, str], np.ndarray] = two.simulated
    assert all(
        np.array_equal(values, simulated[key], equal_nan=True) for key, values in one.simulated.items()
    )


def test_rates_without_noise_do_not_drown_noisy_positions() -> None:
    """A window starts where the joint is, however sure its speed seems (smoothed, or made without noise)."""
    model, few = FlexibleJointModel(make(PLANAR), []), {"q": 2e-5, "theta": 2e-5}
    measured = simulate(model, reference(JOINTS, 2.0), sample_rate=500.0, noise=few, seed=1).measured
    assert compare(model, measured, horizon=0.25).nrmse["q.hip"] < 0.01


# ------------------------------------------------------------------ long recordings
def test_a_long_recording_is_compared_part_by_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of laws and onsets counts from the beginning of the whole."""
    late = [
        effect("periodic_disturbance", "hip", amplitude=3.0, frequency=0.7),
        replace(effect("motor_coulomb_friction", "knee", level=2.0), since=1.6),
        effect("spring_hysteresis", "knee", level=1.1, scale=3e-3),
    ]
    measured = recorded(*late)
    whole = judged(measured, *late)
    sizes: list[int] = []
    estimator = StateEstimator

    def counted(part: Recording, *given: object, **named: object) -> StateEstimator:
        sizes.append(len(part.time))
        return estimator(part, *given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("flexjoint.diagnosis.comparison.compare.StateEstimator", counted)
    for name, value in (("WHOLE", 1000), ("PART", 300), ("RUN_IN", 0.4)):
        monkeypatch.setattr(f"flexjoint.diagnosis.comparison.compare.{name}", value)
    told: list[float] = []
    model = FlexibleJointModel(make(PLANAR), late)
    parts = compare(model, measured, progress=lambda share, _what: told.append(share))
    assert len(sizes) == 5 and max(sizes) < 0.6 * len(measured.time)
    assert parts.windows == whole.windows == len(told) and told[-1] == 1.0
    for name, value in whole.rms.items():
        # noise is told from the samples of a part, and the spring's memory from 0.4 s before it: that is
        # 2.3e-5 rad of phi; a disturbance out of phase or friction at a wrong time is far more
        channel = name.split(".")[0].replace("phi", "q")
        assert parts.rms[name] == pytest.approx(value, abs=2.0 * NOISE[channel]), name
    assert excess(parts) < 12.0  # as the true model's are as a rule


def test_a_part_without_a_channel_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = recorded()
    torque = measured.get("tau_m", "hip").copy()
    torque[500:1100] = np.nan
    broken = table(measured.time, {**measured.columns, ("tau_m", "hip"): torque}, "broken")
    for name, value in (("WHOLE", 1000), ("PART", 250), ("RUN_IN", 0.02)):
        monkeypatch.setattr(f"flexjoint.diagnosis.comparison.compare.{name}", value)
    simulated = judged(broken).simulated["q", "hip"]
    assert np.all(np.isfinite(simulated[:500])) and np.all(np.isnan(simulated[520:1000]))
    assert np.all(np.isfinite(simulated[1250:]))


def test_a_budget_leaves_out_the_windows_at_the_end() -> None:
    result = compare(make(PLANAR), recorded(), budget=Budget(0.0))
    assert (result.windows, result.left_out) == (1, 5)
    assert result.to_json()["left_out"] == 5 and "before the other 5" in str(result)
    assert np.all(np.isnan(result.simulated["q", "hip"][260:]))
