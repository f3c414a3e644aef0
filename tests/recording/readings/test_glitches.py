"""Single readings that failed: found, noted and not used; motion, impacts and noise never."""

from __future__ import annotations

import numpy as np
import pytest
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.recording import table
from flexjoint.recording.readings.glitches import without_glitches
from flexjoint.recording.table import Recording

ROBOTS = ("lever", "crane", "turret", "gimbal")


def recorded(robot: str, excitation: str = "rich") -> Recording:
    return as_recording(Case(robot, excitation, 3).with_causes())


def failing(recording: Recording, channel: str, joint: str, rows: list[int], value: float) -> Recording:
    columns = dict(recording.columns)
    columns[channel, joint] = columns[channel, joint].copy()
    columns[channel, joint][rows] = value
    return table.make(recording.time, columns, "failing")


@pytest.mark.parametrize("rows", [[700], [700, 701], [700, 701, 702], [300, 1500, 1501]])
@pytest.mark.parametrize("channel", ["q", "theta"])
@pytest.mark.parametrize("value", [-3.0, 9.0])
def test_readings_that_failed_become_empty_cells(channel: str, rows: list[int], value: float) -> None:
    recording = failing(recorded("crane"), channel, "elbow", rows, value)
    kept = without_glitches(nominal("crane"), recording)
    assert np.flatnonzero(np.isnan(kept.get(channel, "elbow"))).tolist() == rows
    assert f"{channel}.elbow is off by up to" in kept.notes[0] and f"in {len(rows)} samples" in kept.notes[0]


def test_a_torque_of_exactly_nothing_among_others_failed() -> None:
    recording = failing(recorded("crane"), "tau_t", "shoulder", [900, 901], 0.0)
    kept = without_glitches(nominal("crane"), recording)
    assert np.flatnonzero(np.isnan(kept.get("tau_t", "shoulder"))).tolist() == [900, 901]


@pytest.mark.parametrize("excitation", ["rich", "slow", "steps"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_nothing_fails_where_robots_move_and_stop(robot: str, excitation: str) -> None:
    recording = recorded(robot, excitation)
    assert without_glitches(nominal(robot), recording) is recording


def test_a_body_that_is_hit_moves_on_otherwise() -> None:
    """A speed that changes at once, by as much as a motion has, and a step of four samples and more."""
    recording = recorded("turret")
    time, angle = recording.time, recording.get("theta", "turn")
    for changed in (angle + 3.0 * np.abs(time - 5.0), angle + 0.3 * (time > 5.0)):
        hit = table.make(time, {("theta", "turn"): changed}, "hit")
        assert without_glitches(nominal("turret"), hit) is hit
    long = failing(recording, "theta", "turn", list(range(700, 708)), 9.0)
    assert without_glitches(nominal("turret"), long) is long


def test_a_robot_that_mostly_stands_has_no_failing_readings() -> None:
    """Its usual noise is none: what moves is not held against that."""
    time = 0.01 * np.arange(3000)
    moves = np.where(time > 25.0, 1.0 - np.cos(np.clip(time - 25.0, 0.0, None)), 0.0)
    stands = table.make(time, {("theta", "turn"): moves, ("tau_motor", "turn"): moves}, "stands")
    assert without_glitches(nominal("turret"), stands) is stands


@thorough
def test_a_healthy_robot_of_which_some_readings_failed_is_healthy() -> None:
    """Three zeros among 2400 angles of an arm had left 98 % of a joint's torque unexplained."""
    recording = failing(recorded("gimbal", "steps"), "theta", "tilt", [900, 2000, 3100], 3.0)
    found = diagnose(nominal("gimbal"), [recording])
    assert found.verdict == "healthy", [str(f) for f in found.findings]
    assert any("readings that failed" in note for note in found.notes)
