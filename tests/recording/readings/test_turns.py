"""Angles that a log wraps to one turn: continuous again; other jumps, gaps and travels are left alone."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.recording import table
from flexjoint.recording.readings.turns import ANGLES, TURN, unwrapped
from flexjoint.recording.table import Recording

TURRET = nominal("turret")


def turning(speed: float, start: float, count: int = 400) -> np.ndarray:
    """(N,) an angle at 100 Hz that turns at a mean speed [rad/s], there and back."""
    t = 0.01 * np.arange(count)
    return np.asarray(start + speed * 2.0 * np.sin(0.5 * t))


def logged(angle: np.ndarray, time: np.ndarray | None = None) -> Recording:
    t = 0.01 * np.arange(angle.size) if time is None else time
    return table.make(t, {("theta", "turn"): angle}, "log")


@given(speed=st.floats(0.1, 60.0), start=st.floats(-20.0, 20.0), low=st.sampled_from([-np.pi, 0.0]))
@settings(max_examples=50, deadline=None)
def test_a_wrapped_angle_is_continuous_again(speed: float, start: float, low: float) -> None:
    angle = turning(speed, start)
    wrapped = low + np.mod(angle - low, TURN)
    found = unwrapped(TURRET, logged(wrapped)).get("theta", "turn")
    assert np.allclose(found - found[0], angle - angle[0], atol=1e-9)


def test_an_angle_without_wraps_is_left_as_it_is() -> None:
    recording = logged(turning(3.0, 0.0))
    assert unwrapped(TURRET, recording) is recording


def test_a_jump_that_is_no_whole_turn_is_left_as_it_is() -> None:
    angle = turning(1.0, 0.0)
    angle[200:] += 4.0  # an encoder that lost its zero
    recording = logged(angle)
    assert unwrapped(TURRET, recording) is recording


def test_degrees_are_no_turns() -> None:
    """Of which a fast motion takes more than half of 2 pi in a sample; what they are is told later."""
    recording = logged(np.degrees(turning(6.0, 0.0)))
    assert np.max(np.abs(np.diff(recording.get("theta", "turn")))) > np.pi
    assert unwrapped(TURRET, recording) is recording


def test_what_changed_over_a_gap_is_left_as_it_is() -> None:
    angle, time = turning(1.0, 0.0), 0.01 * np.arange(400)
    time[200:] += 20.0
    angle[200:] += TURN
    recording = logged(angle, time)
    assert unwrapped(TURRET, recording) is recording


def test_empty_cells_stay_empty() -> None:
    angle = np.mod(turning(5.0, 1.0), TURN)
    angle[::7] = np.nan
    found = unwrapped(TURRET, logged(angle)).get("theta", "turn")
    known = ~np.isnan(found)
    assert np.array_equal(np.isnan(found), np.isnan(angle))
    assert np.allclose(found[known] - found[1], (turning(5.0, 1.0) - turning(5.0, 1.0)[1])[known])


def test_a_healthy_robot_whose_log_wraps_is_healthy() -> None:
    """Its pan turns about the vertical, where any zero is as good."""
    recording = as_recording(Case("gimbal", "rich", 3).with_causes())
    away = np.pi - float(np.mean(recording.get("theta", "pan")))
    columns = {
        key: np.mod(x + away + np.pi, TURN) - np.pi if key[1] == "pan" and key[0] in ANGLES else x
        for key, x in recording.columns.items()
    }
    wrapped = table.make(recording.time, columns, "wrapped")
    assert np.max(np.abs(np.diff(wrapped.get("theta", "pan")))) > 6.0

    found = diagnose(nominal("gimbal"), [wrapped])

    assert found.verdict == "healthy", [str(f) for f in found.findings]
    assert any("whole turns" in note for note in found.notes)
