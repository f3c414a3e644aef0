"""Friction that a rest has built up, encoders that ripple: their physics, and their diagnosis."""

from __future__ import annotations

import numpy as np
import pytest
from support.diagnose_cases import Case, as_recording, nominal, summary
from support.robots.arms import make
from support.thorough import sample, thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

INERTIA, MOTOR, DAMPING = 0.05, 0.12, 4.0  # of the arm about its axis, its motor, and the motor's damping
LEVEL, DISTANCE = 3.0, 0.06
TURNTABLE = [("joint", "0 0 1", "0 0 0.8", "0 0 0.1", 2.4, INERTIA)]  # no gravity about its axis
PERIOD = 1.0 / 500.0


def turntable() -> Robot:
    rates = {"physics": 500, "control": 500}
    return make(TURNTABLE, {"joint": {"stiffness": float("inf"), "damping": 0.0}}, rates=rates)


def test_what_a_rest_built_up_holds_and_then_wears_off_with_travel() -> None:
    """The work that it takes over a travel X is level d (1 - exp(-X/d)): what the motor's energy lacks."""
    law = effect("breakaway_friction", "joint", level=LEVEL, distance=DISTANCE)
    model = FlexibleJointModel(turntable(), [law])
    held = rollout(model, model.rest(), np.full((500, 1), 0.99 * LEVEL), RunOptions(rate=1000.0))
    assert np.ptp(held.q) == 0.0, "below the level nothing moves"
    torque, rate = 5.0, 4000.0
    moved = rollout(model, model.rest(), np.full((2000, 1), torque), RunOptions(rate=rate))
    travel, speed = moved.q[:, 0] - moved.q[0, 0], moved.v[:, 0]
    lost = np.concatenate([[0.0], np.cumsum(DAMPING * (0.5 * (speed[1:] + speed[:-1])) ** 2)]) / rate
    kinetic = 0.5 * (INERTIA + MOTOR) * speed**2
    rubbed = torque * travel - lost - kinetic
    expected = LEVEL * DISTANCE * (1.0 - np.exp(-travel / DISTANCE))
    assert travel[-1] > 5.0 * DISTANCE
    # the level of a step is that at its start: first order in the step, 2e-4 of the whole at 4 kHz
    np.testing.assert_allclose(rubbed, expected, atol=2e-3 * LEVEL * DISTANCE)


def recorded_turntable(level: float, seed: int) -> Recording:
    """An independent simulation: one body with dry friction as a set, 20 kHz, torque by a PD law sampled at
    500 Hz, positions with white noise."""
    rng = np.random.default_rng(seed)
    fine, substeps, inertia = PERIOD / 40, 40, INERTIA + MOTOR
    time = np.arange(0.0, 12.0, PERIOD)
    wanted = 0.5 * np.sin(0.9 * time) ** 3 + 0.2 * np.sin(2.1 * time) * np.minimum(1.0, time / 4.0)
    position, speed, left = 0.0, 0.0, 1.0
    theta, tau = np.empty_like(time), np.empty_like(time)
    for k, at in enumerate(wanted):
        theta[k] = position
        tau[k] = 60.0 * (at - position) - 0.5 * speed
        for _ in range(substeps):
            free = speed + fine * (tau[k] - DAMPING * speed) / inertia
            stop = fine * level * left / inertia
            speed = np.sign(free) * max(0.0, abs(free) - stop)
            position += fine * speed
            left *= np.exp(-abs(speed) * fine / DISTANCE)
    columns = {("theta", "joint"): theta + 2e-6 * rng.standard_normal(theta.size), ("tau_m", "joint"): tau}
    return recording.make(time, columns, "turntable")


@thorough
def test_friction_after_a_rest_is_named_and_measured() -> None:
    found = diagnose(turntable(), [recorded_turntable(LEVEL, 5)])
    assert [(f.effect, f.joint) for f in found.findings] == [("breakaway_friction", "joint")], summary(found)
    numbers = found.findings[0].parameters
    # seen only while it wears off, within the first centimetres of travel
    assert numbers["level"].value == pytest.approx(LEVEL, rel=0.1)
    assert numbers["distance"].value == pytest.approx(DISTANCE, rel=0.15)


def test_without_it_nothing_is_named() -> None:
    found = diagnose(turntable(), [recorded_turntable(0.0, 6)])
    assert found.verdict == "healthy" and not found.findings, summary(found)


@thorough
@pytest.mark.parametrize("channel", sample(["theta", "q"], one_in=2))
def test_an_encoder_that_ripples_is_named_and_measured(channel: str) -> None:
    """The ripple is added to a planted recording's own column: as an encoder adds it to what is there."""
    case = Case("crane", "rich", 41)
    recorded = case.with_causes()
    column = f"{channel}.elbow"
    angle = recorded.columns[column]
    recorded.columns[column] = angle + 2e-4 * np.sin(87.0 * angle + 1.0)
    found = diagnose(nominal("crane"), [as_recording(recorded, case.name)])
    assert [(f.effect, f.joint) for f in found.findings] == [("encoder_ripple", "elbow")], summary(found)
    numbers = found.findings[0].parameters
    assert numbers["channel"] == channel
    assert numbers["amplitude"].value == pytest.approx(2e-4, rel=0.05)
    assert numbers["cycles"].value == pytest.approx(87.0, abs=0.1)
