"""The recording table: what is read, what is refused and in which words; round trips; arbitrary input."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.recording import table as recording
from flexjoint.recording.table import LARGEST, MEASURED, MINIMUM_SAMPLES, UNITS, Recording

# files of a few kB each: a hundred examples take a second or two
examples = settings(
    max_examples=100, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


def columns(**given: object) -> dict[str, object]:
    """Two seconds of one joint at 100 Hz; columns by name with an underscore for the dot."""
    time = np.arange(200) / 100
    out: dict[str, object] = {"time": time, "q.elbow": 0.3 * np.sin(time), "theta.elbow": 0.31 * np.sin(time)}
    out.update({name.replace("__", "."): values for name, values in given.items()})
    return {name: values for name, values in out.items() if values is not None}


def parquet(folder: Path, table: Mapping[str, object]) -> Path:
    path = folder / "rec.parquet"
    pa.parquet.write_table(pa.table(dict(table)), path)
    return path


def message(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        recording.read(path)
    text = str(error.value)
    assert str(path) in text and "\n" not in text
    return text


# --- reading --------------------------------------------------------------------------------------------
def test_a_table_becomes_a_recording(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns()))
    assert read.joints == ("elbow",)
    assert (read.duration, read.period) == pytest.approx((1.99, 0.01))
    assert read.has("q", "elbow") and not read.has("dq", "elbow")
    np.testing.assert_array_equal(read.get("q", "elbow"), 0.3 * np.sin(read.time))


def test_joints_may_hold_dots_and_the_channel_ends_at_the_first(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns(q__arm__elbow=np.zeros(200))))
    assert read.joints == ("elbow", "arm.elbow")


def test_empty_cells_are_missing_samples(tmp_path: Path) -> None:
    path = tmp_path / "rec.csv"
    rows = [f"{k / 100},{'' if k % 3 else k},{'nan' if k % 5 else k / 2}" for k in range(100)]
    path.write_text("\n".join(["time,q.elbow,theta.elbow", *rows]))
    read = recording.read(path)
    assert np.count_nonzero(np.isnan(read.get("q", "elbow"))) == 66
    assert np.count_nonzero(np.isnan(read.get("theta", "elbow"))) == 80


def test_integer_columns_are_numbers(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns(q__elbow=list(range(200)))))
    assert read.get("q", "elbow").dtype == float


def test_every_channel_of_the_format_has_a_unit_and_measured_ones_are_channels() -> None:
    assert set(MEASURED) <= set(UNITS)
    assert len(UNITS) == 13  # docs/reference/formats.md


def test_an_unknown_channel_lists_those_that_were_measured(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns()))
    with pytest.raises(FlexJointError, match=r"'tau_t\.elbow'.*q\.elbow, theta\.elbow"):
        read.get("tau_t", "elbow")


def test_between_takes_the_start_and_leaves_the_stop(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns())).between(0.5, 1.0)
    assert read.time[0] == 0.5 and read.time[-1] == 0.99 and read.get("q", "elbow").shape == (50,)


# --- refusing -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"time": None}, r"first column must be `time` \[s\], got 'q.elbow'"),
        ({"time": [0.0] * 200}, "increase strictly, but 199 of 200 rows have the stamp of another row"),
        ({"time": [*range(20)] * 10}, "from 19 to 0 s in row 21, .*; sort or clean"),
        ({"time": [*range(180), *[None] * 20]}, "time is not a number in row 181 and 20 rows in all"),
        ({"time": [1e300 * k for k in range(200)]}, "time reaches 1.99e.302, expected seconds below 1e.10"),
        ({"q__elbow": [1e20] * 200}, r"q.elbow reaches 1e.20 rad, beyond 1e.09: no sensor shows that"),
        ({"q__elbow": [1e300] * 200}, r"q.elbow reaches 1e.300 rad"),
        ({"q__elbow": [None] * 200}, "q.elbow holds 0 numbers in 200 rows; leave a channel out"),
        ({"q__elbow": [float("nan")] * 200}, "q.elbow holds 0 numbers in 200 rows"),
        ({"q__elbow": [float("inf")] * 200}, "q.elbow holds infinite values; leave such cells empty"),
        ({"q__elbow": ["a"] * 200}, "q.elbow holds string, expected numbers"),
        ({"q__elbow": [True] * 200}, "q.elbow holds bool, expected numbers"),
        ({"torque__elbow": [1.0] * 200}, "unknown channel 'torque'.*valid: .*tau_m, tau_motor"),
        ({"thetas__elbow": [1.0] * 200}, "unknown channel 'thetas' .did you mean 'theta'"),
        ({"q": [1.0] * 200}, "column 'q' is not <channel>.<joint>, e.g. q.elbow"),
        ({"q.": [1.0] * 200}, "column 'q.' is not <channel>.<joint>"),
    ],
)
def test_a_bad_table_is_refused_in_words(tmp_path: Path, given: dict[str, object], said: str) -> None:
    path = parquet(tmp_path, columns(**given))
    with pytest.raises(RecordingError, match=said):
        recording.read(path)
    message(path)


def test_a_table_without_channels_is_refused(tmp_path: Path) -> None:
    assert "no channel beside time" in message(parquet(tmp_path, {"time": np.arange(100.0)}))


def test_too_few_samples_are_refused(tmp_path: Path) -> None:
    short = {"time": np.arange(10.0), "q.elbow": np.arange(10.0)}
    assert f"at least {MINIMUM_SAMPLES} samples, got 10" in message(parquet(tmp_path, short))


def test_a_repeated_column_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rec.csv"
    path.write_text("time,q.elbow,q.elbow\n" + "\n".join(f"{k},1,2" for k in range(60)))
    assert "q.elbow appears twice" in message(path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("rec.csv", b"", "is empty; expected a table with a time column"),
        ("rec.parquet", b"", "is empty"),
        ("rec.parquet", b"time,q.elbow\n1,2\n", "cannot be read as parquet"),
        ("rec.csv", b"PAR1\x00\xff\xfe", "rec.csv"),
        ("rec.csv", b"time,q.elbow\n1\n2,3\n", "cannot be read as csv"),
        ("rec.xlsx", b"PK", "expected a .csv or .parquet file, got .xlsx"),
        ("rec", b"time", "expected a .csv or .parquet file, got no suffix"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert said in message(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert "does not exist; give a .csv or .parquet file" in message(tmp_path / "none.csv")
    assert "does not exist" in message(tmp_path)


# --- round trips and arbitrary input ----------------------------------------------------------------------
names = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), min_size=1, max_size=8)
numbers = st.floats(allow_nan=True, allow_infinity=False, width=64)
readings = st.one_of(st.floats(-LARGEST, LARGEST), st.just(float("nan")))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    rows = draw(st.integers(MINIMUM_SAMPLES, MINIMUM_SAMPLES + 20))
    steps = draw(st.lists(st.floats(1e-6, 1e3), min_size=rows, max_size=rows))
    keys = draw(
        st.lists(st.tuples(st.sampled_from(sorted(UNITS)), names), min_size=1, max_size=4, unique=True)
    )
    table = {}
    for key in keys:
        values = np.array(draw(st.lists(readings, min_size=rows, max_size=rows)))
        values[:4] = draw(st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4))  # some numbers in any case
        table[key] = values
    return recording.make(np.cumsum(steps), table)


@examples
@given(recordings(), st.sampled_from([".csv", ".parquet"]))
def test_what_is_written_is_read_again(written: Recording, suffix: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"rec{suffix}"
        recording.write(written, path)
        read = recording.read(path)
    np.testing.assert_array_equal(read.time, written.time)
    assert set(read.columns) == set(written.columns)
    for key, values in written.columns.items():
        np.testing.assert_array_equal(read.columns[key], values)


def refuses_politely(read: Callable[[Path], object], name: str, content: bytes) -> None:
    """Reading gives a value or a FlexJointError in one line, nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        try:
            read(path)
        except FlexJointError as error:
            assert "\n" not in str(error)


@examples
@given(st.binary(max_size=200), st.sampled_from(["rec.csv", "rec.parquet"]))
def test_arbitrary_bytes_are_refused_politely(content: bytes, name: str) -> None:
    refuses_politely(recording.read, name, content)


cells = st.one_of(
    st.text(max_size=6),
    numbers.map(repr),
    st.integers().map(str),
    st.sampled_from(["", "NaN", "1e999", "true"]),
)
headers = st.one_of(
    st.sampled_from(["time", "q.elbow", "q", "q.", ".q", "tau_m.a.b", ""]), st.text(max_size=8)
)


@examples
@given(
    st.lists(headers, min_size=1, max_size=4), st.lists(st.lists(cells, min_size=1, max_size=4), max_size=70)
)
def test_arbitrary_tables_are_refused_politely(head: list[str], rows: list[list[str]]) -> None:
    text = "\n".join(",".join(line) for line in (["time", *head], *rows))
    refuses_politely(recording.read, "rec.csv", text.encode("utf-8", "replace"))


@examples
@given(recordings(), st.data())
def test_damaged_files_are_refused_politely(written: Recording, data: st.DataObject) -> None:
    """A file with some bytes overwritten or its end cut off: what a broken transfer leaves."""
    suffix = data.draw(st.sampled_from([".csv", ".parquet"]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"rec{suffix}"
        recording.write(written, path)
        content = bytearray(path.read_bytes())
    where = data.draw(st.integers(0, len(content) - 1))
    patch = data.draw(st.binary(max_size=8))
    content[where : where + len(patch)] = patch
    refuses_politely(
        recording.read, f"rec{suffix}", bytes(content[: data.draw(st.integers(0, len(content)))])
    )


# --- writing ----------------------------------------------------------------------------------------------
def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    read = recording.read(parquet(tmp_path, columns()))
    out = tmp_path / "folder" / "out.csv"
    recording.write(read, out)
    before = out.read_bytes()
    with pytest.raises(FlexJointError, match="cannot write"):
        recording.write(read, out / "below_a_file.csv")
    with pytest.raises(RecordingError, match=r"expected a \.csv or \.parquet name, got \.txt"):
        recording.write(read, tmp_path / "folder" / "out.txt")
    assert out.read_bytes() == before
    assert [path.name for path in out.parent.iterdir()] == ["out.csv"]


def test_a_recording_prints_what_it_holds_and_not_its_samples() -> None:
    time = np.arange(200) / 100
    joints = [f"joint_{k}" for k in range(200)]
    one = recording.make(
        time, {("q", "elbow"): np.sin(time), ("theta", "elbow\x1b[31m"): np.sin(time)}, "log"
    )
    many = recording.make(time, {("q", joint): np.sin(time) for joint in joints})

    assert str(one) == "log: 1.99 s at 100 Hz, 200 samples\njoints: elbow, elbow\\x1b[31m\nchannels: q, theta"
    assert len(str(many)) < 600


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_large_recording_is_written_in_parts_as_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    values = np.where(np.arange(200) < 90, np.nan, np.sin(np.arange(200.0)))  # the first part has no number
    made = recording.make(np.arange(200) / 250.0, {("q", "elbow"): values})
    made.write(tmp_path / f"at_once{suffix}")
    monkeypatch.setattr(recording, "ROWS_AT_ONCE", 80)
    made.write(tmp_path / f"in_parts{suffix}")
    whole, parts = (recording.read(tmp_path / f"{name}{suffix}") for name in ("at_once", "in_parts"))
    np.testing.assert_array_equal(parts.time, whole.time)
    np.testing.assert_array_equal(parts.get("q", "elbow"), whole.get("q", "elbow"))


def test_parts_are_the_groups_of_rows_that_parquet_makes_by_itself(tmp_path: Path) -> None:
    """So that a file has the same bytes whether it is written in parts or at once."""
    count = recording.ROWS_AT_ONCE + 10
    time, q = np.arange(count) / 1000.0, np.zeros(count)
    recording.make(time, {("q", "elbow"): q}).write(tmp_path / "in_parts.parquet")
    table = pa.table({"time": time, "q.elbow": q})
    pa.parquet.write_table(table, tmp_path / "at_once.parquet", compression="zstd")
    assert (tmp_path / "in_parts.parquet").read_bytes() == (tmp_path / "at_once.parquet").read_bytes()
