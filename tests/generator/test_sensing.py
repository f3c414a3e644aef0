"""Sensors, noise, seeds, ragged time and tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from planting.cases import usual_effect
from planting.machine.by_hand import JOINT, LEVER
from planting.machine.laws import Planted
from planting.machine.sensing import (
    ENCODERS,
    FROM_CURRENT,
    FULL,
    MEASURED,
    MOTOR_ONLY,
    NO_COMMAND,
    PERFECT,
    RAGGED,
    Ragged,
    robot_noise,
)
from planting.robots import ROBOTS, deviating, read_robot
from planting.simulate import plant

CRANE, GIMBAL = ROBOTS / "crane.yaml", ROBOTS / "gimbal.yaml"


def test_sensor_laws():
    for effect, channel, law in (
        ("link_encoder_offset", "q", lambda p, x: x + p["offset"]),
        ("motor_encoder_offset", "theta", lambda p, x: x + p["offset"]),
        ("torque_sensor_offset", "tau_t", lambda p, x: x + p["offset"]),
        ("torque_sensor_gain", "tau_t", lambda p, x: (1 + p["gain"]) * x),
    ):
        planted = usual_effect(effect, "lever", JOINT, np.random.default_rng(5))
        recorded = plant(LEVER, [planted], "rich", 1, 2, PERFECT)
        parameters = planted.parameters
        for other in ("q", "dq", "theta", "dtheta", "tau_t"):
            true = recorded.true[other][:, 0]
            expected = law(parameters, true) if other == channel else true
            np.testing.assert_array_equal(recorded.columns[f"{other}.{JOINT}"], expected)


@pytest.mark.parametrize("channel", ["q", "theta"])
def test_encoder_eccentricity(channel):
    parameters = {"amplitude": 0.006, "phase": 0.7, "channel": channel}
    recorded = plant(LEVER, [Planted("encoder_eccentricity", JOINT, parameters)], "rich", 2, 2, PERFECT)
    x = recorded.true[channel][:, 0]
    np.testing.assert_array_equal(recorded.columns[f"{channel}.{JOINT}"], x + 0.006 * np.sin(x + 0.7))


@pytest.mark.parametrize(
    ("channel", "moved"), [(None, "q dq theta dtheta tau_t"), ("q", "q dq"), ("theta", "theta dtheta")]
)
def test_sensor_delay_shifts_its_channels(channel, moved):
    delay = 0.004
    planted = Planted("sensor_delay", JOINT, {"delay": delay, "channel": channel})
    recorded = plant(LEVER, [planted], "rich", 2, 2, PERFECT, rate=1000)
    for c in ("q", "dq", "theta", "dtheta", "tau_t"):
        lag = 4 if c in moved.split() else 0
        true = recorded.true[c][: len(recorded.true[c]) - lag, 0]
        np.testing.assert_allclose(recorded.columns[f"{c}.{JOINT}"][lag:], true, atol=1e-12)


def test_a_delay_without_joint_belongs_to_all():
    recorded = plant(
        CRANE, [Planted("sensor_delay", None, {"delay": 0.002})], "rich", 1, 2, PERFECT, rate=1000
    )
    for j, joint in enumerate(("shoulder", "elbow")):
        np.testing.assert_allclose(recorded.columns[f"q.{joint}"][2:], recorded.true["q"][:-2, j], atol=1e-12)


def test_between_grid_points_positions_are_interpolated():
    delay = 0.0037
    recorded = plant(
        LEVER, [Planted("sensor_delay", JOINT, {"delay": delay})], "rich", 2, 2, PERFECT, rate=1000
    )
    time = recorded.columns["time"]
    shifted = np.interp(time[10:] - delay, time, recorded.true["q"][:, 0])
    # linear interpolation over 1 ms errs by ddq h^2 / 8 = 5e-6 rad; a tenth of a tick would show 4e-4 rad
    np.testing.assert_allclose(recorded.columns[f"q.{JOINT}"][10:], shifted, atol=1e-5)


def test_the_same_seed_gives_the_same_bits_and_another_does_not():
    def make(seed):
        return plant(
            CRANE, [Planted("backlash", "elbow", {"gap": 0.008})], "rich", 1, seed, RAGGED, inexact=0.02
        )

    first, again, other = make(3), make(3), make(4)
    assert first.columns.keys() == again.columns.keys()
    for name, values in first.columns.items():
        assert values.tobytes() == again.columns[name].tobytes()
    assert first.columns["time"].tobytes() != other.columns["time"].tobytes()
    assert not np.allclose(first.true["q"][:300], other.true["q"][:300], atol=1e-3)


def test_noise_is_what_the_robot_draws():
    recorded = plant(LEVER, [], "slow", 4, 5, FULL)
    level = robot_noise("lever")
    for j, c in enumerate(MEASURED):
        error = recorded.columns[f"{c}.{JOINT}"] - recorded.true[c][:, 0]
        resolution = FULL.resolution if c in ("q", "theta") else 0.0
        expected = np.hypot(level[c], resolution / np.sqrt(12))
        assert np.std(error) == pytest.approx(expected, rel=0.08), (j, c)  # 2000 samples: 1.6 % is one sigma
    steps = recorded.columns[f"q.{JOINT}"] / FULL.resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_inexact_machines_deviate_within_their_range_and_keep_to_their_seed():
    robot = read_robot(GIMBAL)
    for seed in range(20):
        real = deviating(robot, 0.02, np.random.default_rng(seed))
        for key, weight in (("stiffness", 1), ("motor_inertia", 1), ("damping", 3), ("motor_damping", 3)):
            error = np.abs(getattr(real, key) / getattr(robot, key) - 1) / weight
            assert error.min() >= 0.01 - 1e-12 and error.max() <= 0.03 + 1e-12
        for a, b in zip(real.bodies, robot.bodies, strict=True):
            assert 0.01 - 1e-12 <= abs(a.mass / b.mass - 1) <= 0.03 + 1e-12
            assert a.inertia[0, 0] != b.inertia[0, 0]
        np.testing.assert_array_equal(real.kp, robot.kp)  # the controller is what it was told
    pair = [plant(GIMBAL, [], "rich", 0.2, seed, PERFECT, inexact=0.02, plant_seed=9).real for seed in (1, 2)]
    np.testing.assert_array_equal(pair[0].stiffness, pair[1].stiffness)


def test_sensor_sets_drop_channels():
    def channels(sensors):
        recorded = plant(CRANE, [], "slow", 0.2, 1, sensors)
        assert next(iter(recorded.columns)) == "time"
        return {name.split(".")[0] for name in recorded.columns} - {"time", "q_ref", "theta_ref", "tau_ff"}

    assert channels(FULL) == {"q", "dq", "theta", "dtheta", "tau_t", "tau_m"}
    assert channels(ENCODERS) == {"q", "theta", "tau_m"}
    assert channels(MOTOR_ONLY) == {"theta", "dtheta", "tau_m"}
    assert channels(NO_COMMAND) == {"q", "dq", "theta", "dtheta", "tau_t"}


@pytest.mark.parametrize("late", [False, True])
def test_ragged_time(late):
    sensors = replace(PERFECT, ragged=Ragged(sampled_late=late))
    recorded = plant(LEVER, [], "rich", 4, 5, sensors)
    even = plant(LEVER, [], "rich", 4, 5, PERFECT)
    time = recorded.columns["time"]
    step = np.diff(time)
    assert step.min() > 0.79 * 0.002 and 0.199 < step.max() < 0.21 and np.sum(step > 0.1) == 1
    lost = np.mean([np.isnan(v).mean() for name, v in recorded.columns.items() if name != "time"])
    assert lost == pytest.approx(0.004, rel=0.5)  # about 65 lost cells
    q = recorded.columns[f"q.{JOINT}"][:-1]
    time = time[:-1]  # a late last sample lies beyond the even ones
    truly = np.interp(
        time if late else np.floor(time * 500 + 1e-9) / 500, even.columns["time"], even.columns[f"q.{JOINT}"]
    )
    assert np.nanmax(np.abs(q - truly)) < 5e-5  # linear interpolation over 2 ms; wrong times would show 1e-3


def test_tables_are_written_with_empty_cells(tmp_path):
    recorded = plant(LEVER, [], "slow", 2, 5, RAGGED)
    for suffix in ("parquet", "csv"):
        recorded.write(tmp_path / f"r.{suffix}")
    parquet = pyarrow.parquet.read_table(tmp_path / "r.parquet")
    csv = pyarrow.csv.read_csv(tmp_path / "r.csv")
    assert parquet.column_names == csv.column_names == list(recorded.columns)
    missing = int(np.isnan(recorded.columns[f"q.{JOINT}"]).sum())
    assert missing > 0
    assert parquet[f"q.{JOINT}"].null_count == csv[f"q.{JOINT}"].null_count == missing
    with pytest.raises(ValueError, match=r"expected \.parquet or \.csv"):
        recorded.write(tmp_path / "r.mat")


def test_a_current_shows_what_the_drive_does_and_not_what_lies_behind_it():
    gain, limit = 0.2, 9.0
    behind = [Planted("torque_gain", JOINT, {"gain": gain}), Planted("torque_offset", JOINT, {"offset": 3.0})]
    clipped = [Planted("torque_saturation", JOINT, {"limit": limit})]
    sensors = replace(FROM_CURRENT, noise=PERFECT.noise, resolution=0.0)
    for effects, expected in (
        (behind, lambda tau: (tau - 3.0) / (1 + gain)),
        (clipped, lambda tau: np.clip(tau, -limit, limit)),
    ):
        recorded = plant(LEVER, effects, "steps", 3, 2, sensors, rate=1000)
        assert "tau_m.swing" not in recorded.columns
        per_tick = expected(recorded.true["tau"][:, 0])
        mean = (per_tick[1:] + per_tick[:-1]) / 2  # over the half ticks before and after a sample
        np.testing.assert_allclose(recorded.columns["tau_motor.swing"][1:], mean, atol=1e-9)
