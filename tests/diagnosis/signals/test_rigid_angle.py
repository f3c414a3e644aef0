"""A rigid joint has one angle, whichever side's encoder reads it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.robots.coupled_robots import coupled, swinging

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as make_recording
from flexjoint.simulation.simulate import simulate

ENCODERS = {"q": "link_encoder_offset", "theta": "motor_encoder_offset"}


def of_side(channel: str, *, step: float = 0.0) -> Recording:
    """What a rigid arm's controller logs: torques, and its encoders' angles under one of the two names."""
    robot = coupled(None, rigid=True)
    noise = {"theta": 2e-5, "tau_m": 0.01}
    run = simulate(FlexibleJointModel(robot, []), swinging(robot, 4.0), sample_rate=500.0, noise=noise)
    columns = {}
    for name in robot.joint_names:
        angle = run.measured.get("theta", name)
        columns[channel, name] = step * np.round(angle / step) if step else angle
        columns["tau_m", name] = run.measured.get("tau_m", name)
    return make_recording(run.measured.time, columns)


@cache
def problem(channel: str, step: float = 0.0) -> Problem:
    return Problem(balances_of(coupled(None, rigid=True), of_side(channel, step=step)))


def offset(channel: str, joint: str) -> Planned:
    return Planned.of(ENCODERS[channel], joint, {"offset": 0.01})


@pytest.mark.parametrize("step", [0.0, 1e-3], ids=["fine", "coarse"])
def test_the_name_of_the_angle_changes_no_residual_and_no_noise(step: float) -> None:
    link, motor = problem("q", step), problem("theta", step)
    assert np.array_equal(link.residual([]), motor.residual([]))
    assert np.array_equal(link.J, motor.J)
    assert link.noise_energy == motor.noise_energy


def test_the_links_encoder_gives_the_balance_its_noise() -> None:
    one = problem("q")
    balances = one.balances
    omega, gain = balances.filter.omega, balances.filter.gain
    spectrum = whitening._noise(balances, []).spectrum(omega, gain)
    # at the filter's end the angle's noise, 2e-5 rad, is far more in B q'' than the command's
    inertia = np.array([joint.drive.B for joint in one.robot.joints])
    fast = int(np.argmax(omega > 2.0 / one.readings.sigma))
    of_motor = 2e-5 * inertia * omega[fast] ** 2 * gain[fast]
    of_all = np.sqrt(np.real(np.diagonal(spectrum[fast])))
    assert np.all(of_all > 0.9 * of_motor)


@pytest.mark.parametrize("joint", coupled(None, rigid=True).joint_names)
def test_what_an_encoder_does_shows_on_either_side(joint: str) -> None:
    link = problem("q").moved([offset("q", joint)], [])
    motor = problem("theta").moved([offset("theta", joint)], [])
    assert np.array_equal(link, motor)
    assert np.any(link)


@pytest.mark.parametrize("channel", ["q", "theta"])
def test_only_the_encoder_that_is_there_may_be_wrong(channel: str) -> None:
    one = problem(channel)
    names = {candidate.effect.name for candidate in enumerate_candidates(one, frozenset())}
    other = "theta" if channel == "q" else "q"
    assert ENCODERS[channel] in names
    assert ENCODERS[other] not in names
