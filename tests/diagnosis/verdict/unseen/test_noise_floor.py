"""What noise leaves in a simulation, against closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from flexjoint.diagnosis.verdict.unseen.noise_floor import noise_floor
from flexjoint.recording import table
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

INERTIA, RATE, NOISE, WINDOW = 0.2, 100.0, 0.05, 0.5  # kg m^2, Hz, N m, s
SECONDS = 120.0  # 240 windows: an RMS of so many walks is known to 5 %


def turntable() -> Robot:
    """One rigid joint about the vertical: nothing but an inertia."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), INERTIA * np.eye(3)), pin.SE3.Identity())
    return Robot.from_model(model)


def driven(torque: str, noise: float) -> Recording:
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    omega = 2.0 * np.pi * 0.4
    angle, speed = 0.8 * np.sin(omega * time), 0.8 * omega * np.cos(omega * time)
    rng = np.random.default_rng(4)
    columns = {
        ("q", "table"): angle,
        ("dq", "table"): speed,
        (torque, "table"): -INERTIA * omega**2 * angle + noise * rng.standard_normal(time.size),
    }
    return table.make(time, columns, "turntable")


def test_noise_of_a_torque_walks_in_the_speed() -> None:
    """Each sample of white noise pushes the speed by noise * period / inertia, and k of them by sqrt(k) times
    that: over a window of n samples RMS sqrt(n / 2)."""
    floor = noise_floor(turntable(), driven("tau_motor", NOISE))
    push = NOISE / RATE / INERTIA

    assert floor["rms"]["dq.table"] < 0.01 * push
    assert floor["simulated"]["dq.table"] == pytest.approx(push * np.sqrt(WINDOW * RATE / 2.0), rel=0.15)


def test_a_command_is_known_and_moves_nothing() -> None:
    """Recorded at each tick, however rough it is."""
    robot = turntable()
    known = driven("tau_m", NOISE)
    assert robot.rates.control > RATE  # not at each tick: of what is not recorded the mean is not known
    ticks = np.arange(0.0, SECONDS, 1.0 / robot.rates.control)
    held = known.get("tau_m", "table")[np.minimum((ticks * RATE).astype(int), known.time.size - 1)]
    columns = {key: np.interp(ticks, known.time, values) for key, values in known.columns.items()}
    every = table.make(ticks, {**columns, ("tau_m", "table"): held}, "every tick")

    walked = noise_floor(robot, known)["simulated"]["dq.table"]
    assert noise_floor(robot, every)["simulated"]["dq.table"] < 0.01 * walked
