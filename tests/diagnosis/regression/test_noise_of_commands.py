"""A law by which a motor gives less torque than is recorded lets less of the record's noise through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.robots.rigid_lever import rigid_lever

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, effect
from flexjoint.recording.table import Recording
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot

NOISE = 4.0  # N m
TORQUE = ("tau_motor", "swing")


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, Recording]:
    """A rigid lever, and what it does, with a torque without noise."""
    path = rigid_lever(tmp_path_factory.mktemp("rigid"))
    sensors = SensorSet(channels=("theta", "tau_motor"), noise={"theta": 2e-5, "tau_motor": 0.0})
    return robot.load(path), as_recording(plant(path, [], "rich", 16.0, 5, sensors, rate=250.0))


def energy(machine: tuple[Robot, Recording], torque: np.ndarray, *effects: Planned) -> float:
    """Of a set of effects, where this torque (N,) was recorded with noise."""
    arm, recording = machine
    noise = NOISE * np.random.default_rng(3).standard_normal(torque.size)
    columns = {**recording.columns, TORQUE: torque + noise}
    return fit(Problem(balances_of(arm, replace(recording, columns=columns))), effects).energy


def test_a_motor_that_saturates_fits_no_better_than_one_that_does_not(
    machine: tuple[Robot, Recording],
) -> None:
    """By half the torque at its largest; the noise is the same."""
    true = machine[1].columns[TORQUE]
    saturation = 0.7 / float(np.max(np.abs(true)))
    recorded = true / np.sqrt(1.0 - (saturation * true) ** 2)
    plain = energy(machine, true)
    law = energy(machine, recorded, effect("magnetic_saturation", "swing", saturation=saturation))
    assert law == pytest.approx(plain, rel=0.02)


def test_a_gain_fits_no_better_than_none(machine: tuple[Robot, Recording]) -> None:
    true = machine[1].columns[TORQUE]
    plain, law = energy(machine, true), energy(machine, true / 0.7, effect("torque_gain", "swing", gain=-0.3))
    assert law == pytest.approx(plain, rel=0.02)
