"""Channels that are held, stuck, saturated, without sign or filtered: found, noted and not used; right ones
never."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.core.errors import RecordingError
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.diagnosis.signals.signals import prepare
from flexjoint.recording import table as recording
from flexjoint.recording.checks import check
from flexjoint.recording.readings.channels import inspected, lag_of
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import load, robots_folder

CASE = Case("lever", "rich", 31)  # one joint, 12 s at 500 Hz, all channels
JOINT = "swing"


@cache
def measured() -> Recording:
    return as_recording(CASE.with_causes(), "rec")


def changed(**columns: np.ndarray | None) -> Recording:
    """The recording with other columns of its joint; None: without."""
    table = measured()
    out = dict(table.columns)
    for channel, values in columns.items():
        out.pop((channel, JOINT), None)
        if values is not None:
            out[channel, JOINT] = values
    return replace(table, columns=out)


def looked_at(table: Recording) -> Recording:
    return inspected(nominal(CASE.robot), table)


def diagnosed(table: Recording) -> Diagnosis:
    return diagnose(nominal(CASE.robot), [table], refine=False, workers=1)


# --- what is right ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "case", [CASE, Case("crane", "rich", 24, "noisy_feedback"), Case("turret", "rich", 23, "ragged")], ids=str
)
def test_good_channels_stay_as_they_are(case: Case) -> None:
    table = as_recording(case.with_causes(), "rec")
    assert inspected(nominal(case.robot), table) is table


@pytest.mark.parametrize("name", ["rec_A", "rec_B", "rec_C"])
def test_channels_of_a_real_robot_stay_as_they_are(name: str) -> None:
    table = recording.read(robots_folder() / "kr300" / "recordings" / f"{name}.parquet")
    assert inspected(load("kr300"), table) is table


# --- rates of their own -----------------------------------------------------------------------------------
@pytest.mark.parametrize("channel", ["q", "tau_t"])
@pytest.mark.parametrize("held", [False, True], ids=["empty cells", "repeated samples"])
def test_a_channel_at_a_fifth_of_the_rate_is_used_at_its_own(channel: str, held: bool) -> None:
    table = measured()
    values, rows = table.get(channel, JOINT), np.arange(table.time.size)
    slow = values[rows // 5 * 5] if held else np.where(rows % 5 == 0, values, np.nan)
    result = diagnosed(changed(**{channel: slow}))
    assert result.verdict == "healthy", result.reason  # once refused: no usable data beside gaps
    said = f"rec: {channel}.{JOINT} repeats each sample 5 times: read as a channel of 100 Hz"
    assert (said in result.notes) == held


def test_the_noise_of_a_slow_channel_has_the_density_of_its_own_rate() -> None:
    """What a filter over several of its samples leaves of it, predicted and counted."""
    rng, noise = np.random.default_rng(1), 1e-3
    table = measured()
    rows = np.arange(table.time.size)
    slow = np.where(rows % 5 == 0, 0.4 * np.sin(table.time) + noise * rng.standard_normal(rows.size), np.nan)
    readings = prepare(nominal(CASE.robot), changed(q=slow))
    t = readings.time
    kernel = np.exp(-0.5 * (np.arange(-40, 41) * readings.period / readings.sigma) ** 2)
    kernel /= np.sum(kernel)
    left = np.convolve(readings.q[0] - 0.4 * np.sin(t), kernel, mode="same")[readings.valid]
    expected = readings.noise["q"][0] * np.sqrt(np.sum(kernel**2))
    # 2400 samples hold some 120 independent values of the filter's length: 6.5 % standard error
    assert np.std(left) == pytest.approx(expected, rel=0.2)


# --- stuck and saturated ----------------------------------------------------------------------------------
def test_a_stuck_encoder_is_not_used_where_it_is_stuck() -> None:
    q = measured().get("q", JOINT).copy()
    q[2000:2600] = q[2000]
    table = looked_at(changed(q=q))
    lost = np.flatnonzero(np.isnan(table.get("q", JOINT)))
    assert lost[0] == 2000 and lost[-1] == 2599 and lost.size == 600
    (note,) = table.notes
    assert note.startswith("q.swing stays at -0.0376305 from 4 to 5.198 s while theta.swing moves by 0.472")
    assert diagnosed(changed(q=q)).verdict == "healthy"


def test_an_encoder_that_is_stuck_throughout_is_no_channel() -> None:
    table = looked_at(changed(q=np.full(measured().time.size, 0.3)))
    assert not table.has("q", JOINT)
    assert "q.swing has too few samples left and is not used" in table.notes


def test_a_motor_that_stands_still_is_no_stuck_encoder() -> None:
    """Both sides come to rest within 0.4 s, rest without any noise while the references ask for it, and start
    again."""
    table = measured()
    pace = np.interp(
        np.arange(table.time.size), [0, 1900, 2100, 2600, 2800, table.time.size], [1, 1, 0, 0, 1, 1]
    )
    place = np.minimum(np.cumsum(pace), table.time.size - 1)
    held = {key: np.interp(place, np.arange(values.size), values) for key, values in table.columns.items()}
    rest = replace(table, columns=held)
    assert np.ptp(rest.get("q", JOINT)[2101:2600]) == 0.0
    assert not any("stuck" in note for note in looked_at(rest).notes)


@pytest.mark.parametrize("channel", ["q", "theta"])
def test_an_encoder_that_sticks_alone_is_not_used_where_it_does(channel: str) -> None:
    """Nothing beside it shows the motion."""
    table = measured()
    stuck = table.get(channel, JOINT).copy()
    stuck[2000:2400] = stuck[2000]
    seen = looked_at(replace(table, columns={(channel, JOINT): stuck}))
    assert np.flatnonzero(np.isnan(seen.get(channel, JOINT))).tolist() == list(range(2000, 2400))
    assert (
        f"{channel}.swing stays at" in seen.notes[0] and "stuck or at the end of its range" in seen.notes[0]
    )


def test_an_encoder_at_the_ends_of_its_range_is_not_used_there() -> None:
    theta = measured().get("theta", JOINT)
    low, high = np.quantile(theta, [0.1, 0.9])
    table = replace(measured(), columns={("theta", JOINT): np.clip(theta, low, high)})
    clipped = (theta <= low) | (theta >= high)
    lost = np.isnan(looked_at(table).get("theta", JOINT))
    assert np.mean(lost[clipped]) > 0.7 and not np.any(lost[~clipped])


def test_an_encoder_that_never_changes_is_noted() -> None:
    table = replace(measured(), columns={("theta", JOINT): np.full(measured().time.size, 0.3)})
    (note,) = looked_at(table).notes
    assert note.startswith(
        "theta.swing is 0.3 throughout: the joint stands still or is locked, or its encoder"
    )


def test_a_saturated_torque_sensor_is_not_used_at_the_end_of_its_range() -> None:
    tau = measured().get("tau_t", JOINT)
    largest = float(np.percentile(np.abs(tau), 95))
    table = looked_at(changed(tau_t=np.clip(tau, -largest, largest)))
    np.testing.assert_array_equal(np.isnan(table.get("tau_t", JOINT)), np.abs(tau) >= largest)
    assert "tau_t.swing stays at" in table.notes[0] and "the end of its range" in table.notes[0]


# --- signs and filters ------------------------------------------------------------------------------------
def test_torques_without_sign_are_refused_and_those_of_one_sign_are_not() -> None:
    tau = measured().get("tau_m", JOINT)
    check(nominal(CASE.robot), changed(tau_m=None, tau_motor=tau))
    wrong = changed(tau_m=None, tau_motor=np.abs(tau))
    for use in (lambda: check(nominal(CASE.robot), wrong), lambda: excerpts(nominal(CASE.robot), [wrong])):
        with pytest.raises(
            RecordingError, match=r"tau_motor\.swing has one sign only, .* record it with its sign"
        ):
            use()


@pytest.mark.parametrize("constant", [0.004, 0.008, 0.02])
def test_the_lag_of_a_filtered_velocity_is_measured(constant: float) -> None:
    """dv/dt = (dq/dt - v) / T, stepped exactly at 500 Hz on a rate that is held between samples: that is
    the rate of half a period before, so that the lag is T less half a period."""
    table = measured()
    q, period = table.get("q", JOINT), table.period
    decay = np.exp(-period / constant)
    true = lfilter([1.0 - decay], [1.0, -decay], np.gradient(q, table.time))
    filtered = true + 4e-3 * np.random.default_rng(1).standard_normal(q.size)
    lag = lag_of(table.time, q, filtered)
    assert lag == pytest.approx(constant - 0.5 * period, rel=0.05)
    seen = looked_at(changed(dq=filtered))
    assert not seen.has("dq", JOINT)
    assert seen.notes == (
        f"dq.swing lags the derivative of q.swing by {1e3 * lag:.2g} ms: a sensor lag, as of a velocity"
        " that is filtered with this time constant; it is not used",
    )


def test_a_velocity_without_lag_stays() -> None:
    table = measured()
    assert lag_of(table.time, table.get("q", JOINT), table.get("dq", JOINT)) is None
    assert lag_of(table.time, table.get("q", JOINT), np.zeros(table.time.size)) is None
