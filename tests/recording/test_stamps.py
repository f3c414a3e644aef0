"""Time stamps as loggers write them: what is repaired, with which note, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.messages import LONGEST_LINE
from flexjoint.recording import table as recording
from flexjoint.recording.clock import without_pauses
from flexjoint.recording.stamps import PAUSE
from flexjoint.recording.table import Recording, make

PERIOD = 0.002
COUNT = 600
CLOCK = PERIOD * np.arange(COUNT)


def position(count: int = COUNT) -> np.ndarray:
    """A number of its own in each row, so that rows can be followed."""
    return np.arange(count) / 1000.0


def stamped(time: np.ndarray, name: str = "rec") -> Recording:
    return make(time, {("q", "elbow"): position(len(time))}, name)


def kept(read: Recording) -> np.ndarray:
    """Numbers of the rows that are left."""
    return np.rint(read.get("q", "elbow") * 1000.0).astype(int)


def test_stamps_that_increase_stay_as_they_are() -> None:
    rng = np.random.default_rng(1)
    for time in (CLOCK, CLOCK + 0.3 * PERIOD * rng.random(COUNT), np.cumsum(rng.exponential(0.002, COUNT))):
        read = stamped(time)
        assert read.time is time and read.notes == ()


# --- single stamps ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("off", [-5.0, -1.3, -1.0, -0.97, -0.6, 0.6, 0.97, 1.0, 1.3, 5.0])
def test_a_row_with_an_early_or_late_stamp_is_left_out(off: float) -> None:
    time = CLOCK.copy()
    time[200] += off * PERIOD
    read = stamped(time)
    assert list(kept(read)) == [*range(200), *range(201, COUNT)]
    np.testing.assert_array_equal(read.time, np.delete(CLOCK, 200))
    assert read.notes == (
        "1 row left out whose time stamp is early, late or that of a neighbour (the first is row 201)",
    )


def test_a_stamp_of_zero_amid_the_others_is_left_out() -> None:
    time = CLOCK + 1000.0
    time[300] = 0.0
    assert list(kept(stamped(time))) == [*range(300), *range(301, COUNT)]


def test_rows_that_repeat_the_one_before_are_left_out() -> None:
    rows = np.sort(np.concatenate([np.arange(COUNT), np.arange(10, 400, 7)]))
    tau = np.where(rows % 2 == 0, rows, np.nan)
    read = make(CLOCK[rows], {("q", "elbow"): position()[rows], ("tau_t", "elbow"): tau}, "rec")
    np.testing.assert_array_equal(read.time, CLOCK)
    assert read.notes == ("56 rows left out that repeat the row before",)


def test_rows_of_one_time_and_other_channels_are_one_row() -> None:
    nothing = np.full(COUNT, np.nan)
    q, tau = np.stack([position(), nothing]).T.ravel(), np.stack([nothing, 3.0 * position()]).T.ravel()
    read = make(np.repeat(CLOCK, 2), {("q", "elbow"): q, ("tau_t", "elbow"): tau}, "rec")
    np.testing.assert_array_equal(read.time, CLOCK)
    np.testing.assert_array_equal(read.get("tau_t", "elbow"), 3.0 * position())
    np.testing.assert_array_equal(read.get("q", "elbow"), position())
    assert read.notes == ("600 rows joined with the row before, of the same time and other channels",)


def test_rows_out_of_order_are_sorted() -> None:
    order = np.arange(COUNT)
    order[[100, 101, 300, 301]] = [101, 100, 301, 300]
    read = stamped(CLOCK[order])
    np.testing.assert_array_equal(read.time, CLOCK)
    assert list(kept(read)[99:103]) == [99, 101, 100, 102]
    assert read.notes == ("4 rows out of order sorted by time",)


def test_rows_without_a_stamp_are_left_out_where_they_are_few() -> None:
    time = CLOCK.copy()
    time[[5, 70]] = np.nan
    read = stamped(time)
    assert read.time.size == COUNT - 2 and read.notes == ("2 rows without a time stamp left out",)
    time[100:200] = np.nan
    with pytest.raises(RecordingError, match="time is not a number in row 6 and 102 rows in all"):
        stamped(time)


# --- pieces -----------------------------------------------------------------------------------------------
def test_pieces_that_each_begin_at_zero_are_put_one_after_the_other() -> None:
    read = stamped(np.concatenate([CLOCK[:200]] * 3))
    assert kept(read).size == COUNT
    steps = np.diff(read.time)
    np.testing.assert_allclose(steps[[199, 399]], PAUSE)
    np.testing.assert_allclose(np.delete(steps, [199, 399]), PERIOD)
    assert read.notes == (
        "time steps back in 2 rows (the first is row 201): 3 pieces are put one after the other, 1 s apart",
    )


@pytest.mark.parametrize("slip", [0.4, 0.85, 0.999, 1.0])
def test_pieces_joined_less_than_a_period_apart_are_put_apart(slip: float) -> None:
    """Two torque samples within one tick of the controller: a traceback once."""
    time = CLOCK.copy()
    time[200:] -= slip * PERIOD
    read = stamped(time)
    assert np.diff(read.time)[199] == pytest.approx(PAUSE)
    assert "goes on with another phase from 1 row (the first is row 201): 2 pieces" in read.notes[0]


def test_pieces_shorter_than_a_recording_are_refused() -> None:
    with pytest.raises(RecordingError, match=r"goes from 0.058 to 0 s in row 31.*sort or clean"):
        stamped(np.concatenate([CLOCK[:30]] * 20))


# --- bursts -----------------------------------------------------------------------------------------------
def test_stamps_of_arrival_in_bursts_become_an_even_clock() -> None:
    rng = np.random.default_rng(2)
    last = np.minimum(5 * (np.arange(COUNT) // 5) + 4, COUNT - 1)
    late = 2e-4 * rng.random(COUNT)[last]
    read = stamped(CLOCK[last] + late)
    np.testing.assert_allclose(read.time, CLOCK, atol=2e-4)
    np.testing.assert_allclose(np.diff(read.time), PERIOD, rtol=1e-3)
    assert (
        "480 rows share the stamp of another, as in bursts" in read.notes[0] and "(500 Hz)" in read.notes[0]
    )


def test_bursts_on_no_even_clock_are_refused() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(RecordingError, match="no even clock explains the stamps; log a time for each sample"):
        stamped(np.repeat(np.cumsum(rng.exponential(0.01, 120)), 5))


# --- units ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("unit", "factor", "begin"),
    [
        ("nanoseconds", 1_000_000_000, 0),
        ("nanoseconds", 1_000_000_000, 1_763_900_000_123_456_789),  # since 1970: the usual form of ROS
        ("microseconds", 1_000_000, 0),
        ("microseconds", 1_000_000, 1_763_900_000_123_456),
        ("milliseconds", 1000, 1_763_900_000_123),
    ],
)
def test_whole_numbers_of_a_unit_become_seconds_exactly(
    tmp_path: Path, unit: str, factor: int, begin: int
) -> None:
    ticks = np.arange(COUNT) * factor // 500 + begin
    for suffix in (".parquet", ".csv"):
        path = tmp_path / f"rec{suffix}"
        table = pa.table({"time": ticks, "q.elbow": position()})
        write = pa.parquet.write_table if suffix == ".parquet" else pa.csv.write_csv
        write(table, path)
        read = recording.read(path)
        np.testing.assert_array_equal(read.time, np.arange(COUNT) / 500)
        assert read.notes == (f"time holds whole numbers, read as {unit} from the first stamp (500 Hz)",)


def test_dates_are_stamps(tmp_path: Path) -> None:
    ticks = pa.array(np.arange(COUNT) * 2000 + 1_763_900_000_000_000).cast(pa.timestamp("us"))
    pa.parquet.write_table(pa.table({"time": ticks, "q.elbow": position()}), tmp_path / "rec.parquet")
    np.testing.assert_array_equal(recording.read(tmp_path / "rec.parquet").time, np.arange(COUNT) / 500)


@pytest.mark.parametrize("step", [25_000, 50_000_000, 10**12])
def test_whole_numbers_of_no_plausible_unit_are_refused(step: int) -> None:
    with pytest.raises(RecordingError, match=r"neither seconds nor.*give time in seconds"):
        stamped(np.arange(COUNT) * step)


def test_whole_numbers_of_seconds_stay_so() -> None:
    """A table of poses, a row a second: only an epoch tells milliseconds."""
    read = stamped(np.arange(COUNT))
    assert read.notes == () and read.time[-1] == COUNT - 1


# --- pauses -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("pause", [5.0, 1000.0, 1e5])
def test_a_pause_is_shortened_to_one_that_separates(pause: float) -> None:
    time = CLOCK.copy()
    time[300:] += pause
    shorter = without_pauses(stamped(time))
    assert np.diff(shorter.time)[299] == pytest.approx(PAUSE, abs=1.5 * PERIOD)
    place = shorter.time / PERIOD  # the clock keeps its phase
    np.testing.assert_allclose(place, np.round(place), atol=1e-6)
    assert f"pauses of {pause + PERIOD:.4g} s in all" in shorter.notes[0]
    assert without_pauses(shorter) is shorter


def test_a_recording_without_long_pauses_is_itself() -> None:
    time = CLOCK.copy()
    time[300:] += 0.9
    read = stamped(time)
    assert without_pauses(read) is read


def test_more_gaps_than_samples_are_refused() -> None:
    time = CLOCK.copy()
    time += 0.5 * (np.arange(COUNT) // 3)
    with pytest.raises(RecordingError, match="with gaps between nearly all"):
        without_pauses(stamped(time))


# --- anything ---------------------------------------------------------------------------------------------
stamps = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 0.001, 0.002, 1.0, 1e9, 1e18, float("nan")]),
    st.integers(0, 50).map(lambda k: k / 500),
)
tables = st.one_of(
    st.lists(stamps, min_size=50, max_size=120).map(np.array),
    st.lists(st.integers(-(2**63), 2**63 - 1), min_size=50, max_size=80).map(lambda x: np.array(x, np.int64)),
    # a clock of which some stamps are anything, or some pieces are moved
    st.tuples(
        st.integers(60, 200),
        st.sampled_from([1e-3, 2e-3, 1.0]),
        st.lists(st.tuples(st.integers(0, 199), stamps), max_size=8),
        st.lists(st.tuples(st.integers(0, 199), st.floats(-2.0, 2.0)), max_size=3),
    ).map(lambda drawn: damaged(*drawn)),
)


def damaged(
    count: int, period: float, single: list[tuple[int, float]], moved: list[tuple[int, float]]
) -> np.ndarray:
    time = period * np.arange(count)
    for row, by in moved:
        time[row % count :] += by
    for row, stamp in single:
        time[row % count] = stamp
    return time


@settings(max_examples=400, derandomize=True, deadline=None)
@given(tables, st.booleans())
def test_any_stamps_become_increasing_seconds_or_one_line(time: np.ndarray, still: bool) -> None:
    values = np.zeros(len(time)) if still else position(len(time))
    try:
        read = make(time, {("q", "elbow"): values}, "rec")
        assert np.all(np.diff(read.time) > 0.0) and np.all(np.isfinite(read.time))
        assert read.time.shape == read.get("q", "elbow").shape
        assert np.all(np.isfinite(read.get("q", "elbow")))
        if not np.array_equal(read.time, np.asarray(time, dtype=float)):
            assert read.notes  # never silently
        again = make(read.time, read.columns, "rec")
        shorter = without_pauses(again)
        assert np.all(np.diff(shorter.time) > 0.0)
    except FlexJointError as error:
        assert "\n" not in str(error) and len(str(error)) <= LONGEST_LINE
