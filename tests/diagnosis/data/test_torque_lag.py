"""Torques that are filtered: a lag of the reading, found with its time constant, and of nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planting import Planted, plant, robot_file
from planting.machine.sensing import SensorSet
from scipy.signal import lfilter
from support.diagnose_cases import as_recording, summary
from support.thorough import exhaustive, thorough

from flexjoint.diagnosis.data.check import check_data
from flexjoint.diagnosis.data.torques.lag import advanced, torque_lag
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.recording import table
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, load, robots_folder

NAME = "dirty_drawn_12_of6_rigid_5"  # six rigid joints
MOTOR = SensorSet(channels=("theta", "tau_motor"))
SECONDS = 16.0


@cache
def robot() -> Robot:
    return load(robot_file(NAME))


@cache
def recorded(rate: float = 250.0, *, rubbing: bool = True) -> Recording:
    """Motor encoders and currents only; three joints with friction that the model lacks."""
    causes = [
        Planted("motor_coulomb_friction", "joint_1", {"level": 24.0}),
        Planted("motor_viscous_friction", "joint_2", {"coefficient": 22.0}),
        Planted("motor_coulomb_friction", "joint_3", {"level": 0.84}),
    ]
    made = plant(robot_file(NAME), causes if rubbing else [], "rich", SECONDS, 5, MOTOR, rate=rate)
    return as_recording(made)


def filtered(recording: Recording, constant: float) -> Recording:
    """Every torque through T dy/dt = x - y, exact where x goes straight between samples."""
    step = recording.period / constant
    decay = np.exp(-step)
    now, last = 1.0 - (1.0 - decay) / step, (1.0 - decay) / step - decay
    return with_torques(recording, [now, last], [1.0, -decay])


def with_torques(recording: Recording, top: list[float], bottom: list[float]) -> Recording:
    columns = dict(recording.columns)
    for key, x in recording.columns.items():
        if key[0] == "tau_motor":
            columns[key] = x[0] + lfilter(top, bottom, x - x[0])
    return replace(recording, columns=columns)


@thorough
@pytest.mark.parametrize("rate", [125.0, 250.0])
@pytest.mark.parametrize("constant", [0.02, 0.005])
def test_the_time_constant_of_filtered_torques_is_found(constant: float, rate: float) -> None:
    lag = torque_lag(robot(), filtered(recorded(rate), constant))
    assert lag is not None
    # the torque is a mean over its control period, and a cubic smooths it: together some 0.2 ms
    assert lag.seconds == pytest.approx(constant, abs=4.0 * lag.std + 3e-4)
    assert lag.joints == robot().joint_names and len(lag.shown_by) >= 4


@thorough
def test_a_lag_is_found_beside_noise_that_hides_it_at_every_instant() -> None:
    noisy, rng = dict(filtered(recorded(125.0, rubbing=False), 0.006).columns), np.random.default_rng(4)
    for key, x in noisy.items():
        if key[0] == "tau_motor":
            noisy[key] = x + 0.08 * np.std(x) * rng.standard_normal(x.size)
    lag = torque_lag(robot(), replace(recorded(125.0), columns=noisy))
    assert lag is not None
    assert abs(lag.seconds - 0.006) < 4.0 * lag.std
    assert lag.std < 0.0005


@thorough
def test_a_moving_average_lags_by_half_its_length() -> None:
    length = 5  # samples of 4 ms
    lag = torque_lag(robot(), with_torques(recorded(), [1.0 / length] * length, [1.0]))
    assert lag is not None
    assert lag.seconds == pytest.approx(0.008, abs=4.0 * lag.std + 3e-4)


@thorough
def test_right_torques_do_not_lag() -> None:
    for rate in (125.0, 250.0):
        assert torque_lag(robot(), recorded(rate)) is None
        assert torque_lag(robot(), recorded(rate, rubbing=False)) is None


@pytest.mark.parametrize("name", ["A", "B", "C"])
def test_torques_of_a_real_robot_do_not_lag(name: str) -> None:
    recording = table.read(robots_folder() / "kr300" / "recordings" / f"rec_{name}.parquet")
    assert torque_lag(load(robots_folder() / "kr300" / "kr300.yaml"), recording) is None


@thorough
def test_a_torque_that_acts_late_is_no_lag_of_its_reading() -> None:
    """A command comes before the torque that acts, an encoder that lags after it: the other way round."""
    early = dict(recorded().columns)
    for key, x in recorded().columns.items():
        if key[0] == "tau_motor":
            early[key] = np.interp(recorded().time + 8e-3, recorded().time, x)
    assert torque_lag(robot(), replace(recorded(), columns=early)) is None


def test_readings_are_advanced_by_their_lag() -> None:
    right, wrong = recorded(), filtered(recorded(), 0.01)
    lag = torque_lag(robot(), wrong)
    assert lag is not None
    made = advanced(wrong, lag)
    key = ("tau_motor", "joint_2")
    errors = [np.std((x.columns[key] - right.columns[key])[50:-50]) for x in (wrong, made)]
    assert errors[1] < 0.25 * errors[0]


@exhaustive
def test_filtered_torques_do_not_end_in_wrong_names() -> None:
    """Without this the diagnosis named two periodic disturbances and an eccentric encoder."""
    recording = filtered(recorded(), 0.01)
    found = diagnose(robot(), [recording], refine=False, workers=1)
    true = {("motor_coulomb_friction", "joint_1"), ("motor_viscous_friction", "joint_2")}
    true.add(("motor_coulomb_friction", "joint_3"))
    assert {(f.effect, f.joint) for f in found.likely()} == true, summary(found)
    (note,) = (note for note in found.notes if "tau_motor of 6 joints lags" in note)
    assert "sensor lag" in note and "the readings are used advanced by it" in note
    assert any("tau_motor of 6 joints lags" in note for note in check_data(robot(), recording).notes)
