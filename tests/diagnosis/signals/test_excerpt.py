"""The part of a recording that is examined, where the whole is too large for a search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.signals import excerpt
from flexjoint.diagnosis.signals.excerpt import excerpts, expected_seconds, most_samples
from flexjoint.recording.table import Recording, read
from flexjoint.robot.robot import load, robots_folder

LEVER = nominal("lever")
(SWING,) = LEVER.joint_names


def moving(count: int, rate: float = 500.0, begin: float = 0.0, end: float = np.inf) -> Recording:
    """Both encoders of the lever, which moves from `begin` to `end` [s] and rests otherwise."""
    time = np.arange(count) / rate
    angle = np.where((time >= begin) & (time < end), np.sin(3.0 * (time - begin)), 0.0)
    return Recording(time, {("q", SWING): angle, ("theta", SWING): angle.copy()}, "log.csv")


def test_a_recording_that_a_search_can_take_is_left_alone() -> None:
    recording = moving(excerpt.LARGEST)
    kept, notes = excerpts(LEVER, [recording])
    assert kept[0] is recording and notes == ()


def test_samples_that_the_filter_smooths_away_are_left_out_first() -> None:
    recording = moving(2 * excerpt.LARGEST, rate=2000.0)
    (kept,), (note,) = excerpts(LEVER, [recording])
    np.testing.assert_array_equal(kept.time, recording.time[::2])
    np.testing.assert_array_equal(kept.get("q", SWING), recording.get("q", SWING)[::2])
    assert "log.csv" in note and "1000 Hz" in note


def test_no_more_than_the_filter_smooths_away() -> None:
    (kept,), _ = excerpts(LEVER, [moving(10 * excerpt.LARGEST, rate=1000.0)])
    assert kept.period == pytest.approx(1.0 / 500.0)


@pytest.mark.parametrize("begin", [0.0, 70.0, 420.0])
def test_of_a_long_recording_the_stretch_that_moves(begin: float) -> None:
    recording = moving(2 * excerpt.LARGEST, begin=begin, end=begin + 540.0)
    (kept,), (note,) = excerpts(LEVER, [recording])
    assert kept.time.size == excerpt.LARGEST
    inside = (kept.time >= begin) & (kept.time < begin + 540.0)
    assert np.mean(inside) > 0.94  # of 480 s, which begin at one of 50 places
    assert f"{kept.time[0]:.4g} to {kept.time[-1]:.4g} s" in note


@pytest.mark.parametrize("rate", [500.0, 2000.0])
def test_what_is_not_kept_leaves_memory(rate: float) -> None:
    (kept,), _ = excerpts(LEVER, [moving(2 * excerpt.LARGEST, rate)])
    assert all(values.base is None for values in (kept.time, *kept.columns.values()))


def test_the_first_of_stretches_that_are_as_lively() -> None:
    (kept,), _ = excerpts(LEVER, [moving(2 * excerpt.LARGEST, begin=0.0, end=0.0)])
    assert kept.time[0] == 0.0


def test_a_channel_in_rows_of_its_own_is_not_lost() -> None:
    """A torque that a slower logger wrote into every second row, beside rows that would be kept."""
    recording = moving(2 * excerpt.LARGEST, rate=2000.0)
    torque = np.full(recording.time.size, np.nan)
    torque[1::2] = 1.0
    both = Recording(recording.time, {**recording.columns, ("tau_t", SWING): torque}, "log.csv")
    (kept,), _ = excerpts(LEVER, [both])
    assert kept.time.size == excerpt.LARGEST and kept.period == pytest.approx(1.0 / 2000.0)
    assert np.mean(np.isfinite(kept.get("tau_t", SWING))) == pytest.approx(0.5)


def test_a_channel_that_is_missing_in_the_stretch_was_not_measured_there() -> None:
    recording = moving(2 * excerpt.LARGEST, begin=0.0, end=540.0)
    torque = np.where(recording.time > 600.0, 1.0, np.nan)
    (kept,), _ = excerpts(LEVER, [Recording(recording.time, {**recording.columns, ("tau_t", SWING): torque})])
    assert set(kept.columns) == set(recording.columns)


def test_recordings_share_what_a_search_takes() -> None:
    one = moving(excerpt.LARGEST)
    kept, notes = excerpts(LEVER, [one, one, moving(1000)])
    assert [r.time.size for r in kept] == [excerpt.LARGEST // 3, excerpt.LARGEST // 3, 1000]
    assert len(notes) == 2


def test_many_joints_count_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """As each one's tolerances leave traces in the samples of all."""
    gimbal = nominal("gimbal")
    time = np.arange(1000) / 500.0
    recording = Recording(time, {("q", name): np.sin(3.0 * time) for name in gimbal.joint_names})
    monkeypatch.setattr(excerpt, "LARGEST", 1800)
    for many, expected in ((3, 600), (2, 400)):
        monkeypatch.setattr(excerpt, "MANY", many)
        (kept,), _ = excerpts(gimbal, [recording])
        assert kept.time.size == expected


def test_a_joint_of_an_arm_takes_longer_than_one_alone() -> None:
    """Measured, processor time: 150 s for the KR300's ten seconds of six joints, 1.15e-3 s for each sample
    of 13 machines with one joint (docs/studies/real_machines.md)."""
    arm, rec = load("kr300"), read(robots_folder() / "kr300" / "recordings" / "rec_A.parquet")
    alone = moving(4000)

    assert 50.0 < expected_seconds(arm, [rec], 1) < 450.0
    assert 1.5 < expected_seconds(LEVER, [alone], 1) < 14.0
    assert expected_seconds(arm, [rec], 2) == 0.5 * expected_seconds(arm, [rec], 1)
    assert excerpt.LEAST < most_samples(arm, 60.0) < rec.time.size * 6 < most_samples(LEVER, 60.0)


@settings(deadline=None, max_examples=60)
@given(
    count=st.integers(60, 3000),
    rate=st.sampled_from((100.0, 250.0, 500.0, 999.0, 1000.0, 4000.0)),
    most=st.integers(60, 2000),
    lost=st.integers(1, 7),
)
def test_samples_are_the_recording_s_own(count: int, rate: float, most: int, lost: int) -> None:
    recording = moving(count, rate)
    recording.columns["q", SWING][::lost] = np.nan if lost > 1 else 0.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(excerpt, "LARGEST", most)
        (kept,), notes = excerpts(LEVER, [recording])
    assert kept.time.size <= max(most, 60) and (notes == ()) is (kept is recording)
    rows = np.searchsorted(recording.time, kept.time)
    np.testing.assert_array_equal(recording.time[rows], kept.time)
    assert np.all(np.diff(rows) == rows[1] - rows[0])
    for key, values in kept.columns.items():
        np.testing.assert_array_equal(recording.columns[key][rows], values)


@thorough
def test_a_cause_is_found_in_the_excerpt(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = as_recording(
        Case("lever", "rich", 5).with_causes(Planted("motor_coulomb_friction", SWING, {"level": 1.5}))
    )
    monkeypatch.setattr(excerpt, "LARGEST", recorded.time.size // 2)
    found = diagnose(LEVER, [recorded])
    assert [f.effect for f in found.findings] == ["motor_coulomb_friction"]
    assert any("too large for one search" in note for note in found.notes)
    assert found.residuals and np.ptp(found.residuals[0].time) < 0.6 * recorded.duration
