"""Spans in which motors are off and brakes hold a robot: found, noted, not used; rest under torque never."""

from __future__ import annotations

import numpy as np
import pytest
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.signals.signals import prepare
from flexjoint.recording import table
from flexjoint.recording.readings.brakes import held_by_brakes, without_brakes
from flexjoint.recording.table import Recording

TORQUES = ("tau_m", "tau_motor")


def recorded(robot: str, excitation: str = "rich") -> Recording:
    return as_recording(Case(robot, excitation, 3).with_causes())


def braked(
    recording: Recording, seconds: float, *, at_end: bool = False, load: float = 0.0, noise: float = 0.0
) -> Recording:
    """The recording with so many seconds before it, or behind it, in which it stands as at its start (end),
    with a torque of `load` times that of then and with noise, of so much of its RMS."""
    period, rng = recording.period, np.random.default_rng(1)
    count = round(seconds / period)
    columns = {}
    for (channel, joint), x in recording.columns.items():
        stands = np.full(count, x[-1] if at_end else x[0])
        if channel in TORQUES:
            stands = load * stands + noise * np.std(x) * rng.standard_normal(count)
        if channel in ("dq", "dtheta"):
            stands = np.zeros(count)
        columns[channel, joint] = np.concatenate([x, stands] if at_end else [stands, x])
    return table.make(np.arange(recording.time.size + count) * period, columns, "braked")


@pytest.mark.parametrize("at_end", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("robot", ["turret", "gimbal", "reach"])
def test_motors_that_are_off_are_found_and_their_torques_left_out(
    robot: str, noise: float, at_end: bool
) -> None:
    recording = braked(recorded(robot), 2.0, at_end=at_end, noise=noise)
    kept = without_brakes(nominal(robot), recording)
    off = np.all([np.isnan(x) for key, x in kept.columns.items() if key[0] in TORQUES], axis=0)
    stands = recording.time >= recording.time[-1] - 2.0 if at_end else recording.time < 2.0
    assert np.mean(off[stands]) > 0.95 and np.mean(off[~stands]) < 0.05
    (note,) = kept.notes
    assert "held by its brakes" in note


def test_brakes_that_open_after_the_motors_are_on_hold_the_robot_until_then() -> None:
    """For 0.25 s the motors carry half of the load, and the brakes the rest."""
    robot, period = nominal("gimbal"), recorded("gimbal", "steps").period
    ramp = round(0.25 / period)
    halfway = braked(recorded("gimbal", "steps"), ramp * period, load=0.5)
    kept = without_brakes(robot, braked(halfway, 1.0))
    off = np.isnan(kept.columns["tau_m", "tilt"])
    assert np.all(off[: round(1.0 / period) + ramp]) and np.mean(off) < 0.2


@pytest.mark.parametrize("robot", ["crane", "scara", "turret", "gimbal", "reach"])
def test_nothing_is_left_out_of_motors_that_hold_their_load(robot: str) -> None:
    """Nor of a SCARA at rest, of which gravity asks nothing, nor where a torque passes through zero."""
    recording = braked(recorded(robot), 2.0, load=1.0)
    assert without_brakes(nominal(robot), recording) is recording


def test_a_robot_that_gravity_does_not_load_stands_without_torque() -> None:
    recording = braked(recorded("scara"), 2.0)
    assert held_by_brakes(nominal("scara"), recording) == []


def test_a_gap_in_the_torques_is_no_brake() -> None:
    recording = braked(recorded("turret"), 2.0)
    columns = dict(recording.columns)
    for key in [key for key in columns if key[0] in TORQUES]:
        columns[key] = np.where(recording.time < 2.0, np.nan, columns[key])
    gap = table.make(recording.time, columns, "gap")
    assert held_by_brakes(nominal("turret"), gap) == []


@thorough
def test_a_healthy_robot_with_its_brakes_on_at_first_is_healthy() -> None:
    """As a friction of 7 N m at rest it had been named, at more than 99 %, of an arm of six joints."""
    found = diagnose(nominal("gimbal"), [braked(recorded("gimbal", "steps"), 3.0)])
    assert found.verdict == "healthy", [str(f) for f in found.findings]
    assert any("brakes" in note for note in found.notes)


@pytest.mark.parametrize("at_end", [False, True])
def test_no_torque_is_made_up_where_the_motors_are_off(at_end: bool) -> None:
    turret = nominal("turret")
    readings = prepare(turret, without_brakes(turret, braked(recorded("turret"), 2.0, at_end=at_end)))
    time = readings.time - readings.time[0]
    off = time > time[-1] - 1.95 if at_end else time < 1.95
    assert not np.any(readings.valid[off]) and np.mean(readings.valid[~off]) > 0.9
