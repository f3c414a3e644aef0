"""Delimited text of any program: delimiters, decimals, comments, names; RTDE and libfranka by their"
" columns."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.logs import JOINTS, assert_is, motion, write_csv

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.text import plain
from flexjoint.recording import table
from flexjoint.recording.formats import text, ur_rtde
from flexjoint.recording.importing import import_log, open_log, read
from flexjoint.recording.logs import mapping

M = motion()
COLUMNS = {"time": M.time, "pos_1": M.q[:, 0], "pos_2": M.q[:, 1]}
BY_ORDER = mapping.parse({"joints": list(JOINTS), "channels": {"q": "pos"}})


DELIMITERS = [(",", False), (";", False), (";", True), ("\t", False), (" ", False)]


@pytest.mark.parametrize(("delimiter", "comma"), DELIMITERS)
def test_delimiters_and_decimals(tmp_path: Path, delimiter: str, comma: bool) -> None:
    path = write_csv(tmp_path / "log.csv", COLUMNS, delimiter, comma)
    assert_is(import_log(path, BY_ORDER).recording, "q", M.q)


def test_a_table_of_numpy_has_its_names_behind_a_hash(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    np.savetxt(path, np.column_stack(list(COLUMNS.values())), header="time pos_1 pos_2", fmt="%.17g")
    assert_is(import_log(path, BY_ORDER).recording, "q", M.q)


def test_columns_without_names_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    np.savetxt(path, np.column_stack(list(COLUMNS.values())), fmt="%.17g")
    keys = {"joints": list(JOINTS), "time": "column_1", "channels": {"q": ["column_2", "column_3"]}}
    assert_is(import_log(path, mapping.parse(keys)).recording, "q", M.q)


def test_words_and_names_that_stand_twice(tmp_path: Path) -> None:
    rows = [f"{t},{a},{b},running" for t, a, b in zip(M.time, *M.q.T, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,q,q,state", *rows]))
    log = open_log(path)
    assert list(log.signals) == ["time", "q", "q#2"] and log.notes == ("not numbers, and not used: state",)


def test_a_table_of_flexjoint_is_read_as_it_is_and_may_be_in_degrees(tmp_path: Path) -> None:
    columns = {"time": M.time, "q.shoulder": np.degrees(M.q[:, 0]), "q.elbow": np.degrees(M.q[:, 1])}
    path = write_csv(tmp_path / "log.csv", columns)
    assert read(path).account == () and read(path).recording.joints == JOINTS
    got = import_log(path, mapping.parse({"angles": "deg"}))
    assert_is(got.recording, "q", M.q)
    table.write(got.recording, tmp_path / "out.parquet")
    again = import_log(tmp_path / "out.parquet")
    assert_is(again.recording, "q", M.q)
    assert "rad: flexjoint's own table" in plain(again.account)


# --- RTDE ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("delimiter", [",", " "])  # ur_rtde writes commas, record.py blanks
def test_rtde_by_its_documented_columns(tmp_path: Path, delimiter: str) -> None:
    """Written after the layout of record.py: no library writes it without a robot."""
    names = ("actual_q", "actual_qd", "target_q", "actual_current", "target_moment")
    rng = np.random.default_rng(1)
    values = {name: np.cumsum(rng.normal(0.0, 1e-3, (M.time.size, 6)), axis=0) for name in names}
    values["actual_qd"] = np.gradient(values["actual_q"], M.time, axis=0)
    columns = {"timestamp": M.time + 1000.0}
    columns |= {f"{name}_{k}": values[name][:, k] for name in names for k in range(6)}
    path = write_csv(tmp_path / "robot_data.csv", columns, delimiter)
    got = read(path)
    recording = got.recording
    assert recording.joints[:3] == ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    assert recording.get("q", "wrist_3_joint") == pytest.approx(values["actual_q"][:, 5])
    assert recording.get("q_ref", "elbow_joint") == pytest.approx(values["target_q"][:, 2])
    assert recording.get("current", "elbow_joint") == pytest.approx(values["actual_current"][:, 2])
    said = plain(got.account)
    assert "Universal Robots RTDE" in said and "target_moment is computed by the controller" in said
    keys = mapping.parse({"torque_constant": 0.1, "gear_ratio": 101.0})
    torque = import_log(path, keys).recording.get("tau_motor", "elbow_joint")
    assert torque == pytest.approx(10.1 * values["actual_current"][:, 2])


def test_a_file_that_ur_rtde_itself_wrote() -> None:
    """written/README.md says what was sent: six decimals are written, rows are repeated and left out, and in
    some rows the stamp is of one package and a value of the next."""
    path = Path(__file__).parent / "written" / "ur_rtde.csv"
    got = read(path)
    recording = got.recording
    joints = ur_rtde.JOINTS
    assert recording.joints == joints and recording.period == pytest.approx(0.008, rel=1e-6)
    assert any("repeat the row before" in note for note in recording.notes)
    first = float(path.read_text().splitlines()[1].split(",")[0])
    t = recording.time - recording.time[0] + first - 1000.0
    for j, joint in enumerate(joints):
        angle = (1.0 + 0.3 * j) * t + j
        expected = {
            "q": 0.4 * np.sin(angle),
            "q_ref": 0.4 * np.sin(angle),
            "dq": 0.4 * (1.0 + 0.3 * j) * np.cos(angle),
            "current": 0.5 * np.cos(angle),
            "temperature": np.full(t.size, 30.0 + j),
        }
        for channel, values in expected.items():
            off = np.abs(recording.get(channel, joint) - values)
            assert np.mean(off < 2e-6) > 0.9, (channel, joint)
            assert np.max(off) < 0.008 * 2.5**2 * 0.5  # what a package of 8 ms later may differ by


# --- libfranka ----------------------------------------------------------------------------------------------
def test_a_file_that_libfranka_itself_wrote() -> None:
    """written/README.md says what was put in; six digits are written, of torques up to 16 N m."""
    path = Path(__file__).parent / "written" / "libfranka.csv"
    joints = [f"fr3_joint{k}" for k in range(1, 8)]
    got = import_log(path, mapping.parse({"joints": joints}))
    assert got.recording.period == pytest.approx(1e-3) and got.recording.time.size == 150
    t = got.recording.time - got.recording.time[0]
    for j, joint in enumerate(joints):
        speed = 2.0 + 0.5 * j
        angle = speed * t + j
        sent = {
            "q": 0.4 * np.sin(angle),
            "q_ref": 0.4 * np.sin(angle) + 0.001 * (j + 1),
            "dq": 0.4 * speed * np.cos(angle),
            "tau_t": 10.0 * np.cos(angle) + j,
        }
        for channel, values in sent.items():
            digit = 5e-5 if channel == "tau_t" else 5e-6  # half the last of six, above ten and above one
            assert got.recording.get(channel, joint) == pytest.approx(values, abs=1.01 * digit)
    said = plain(got.account)
    assert "not used: success_rate" in said and "without gravity and friction" in said
    with pytest.raises(RecordingError, match="does not say of which joints; give --joints"):
        read(path)


# --- what is wrong ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"time,q\n", "got fewer than two lines"),
        (
            b"time,q\n1,2,3\n4,5,6\n",
            "cannot be read as delimited text: CSV parse error: Expected 2 columns, got 3",
        ),
        (b"\xff\xfet\x00i\x00", "cannot be read as delimited text"),
        (b"a,b\nx,y\nu,v\n", "holds no column of numbers"),
        (b"time,q\n" + b"1" * 300_000, "a line of more than"),
    ],
)
def test_unusable_text_is_refused_in_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=said) as error:
        import_log(path)
    assert "\n" not in str(error.value)


TEXTS = st.text("0123456789.,;\t -+eEnaN#%\"'qtime_\n\r[]é", max_size=300).map(str.encode)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=200) | TEXTS)
def test_whatever_a_text_file_holds_it_is_read_or_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(content)
        try:
            import_log(path, mapping.parse({"rate": 100.0, "joints": ["a"]}))
        except FlexJointError as error:
            assert "\n" not in str(error) and len(str(error)) <= 300


CELLS = st.one_of(
    st.floats(width=32), st.sampled_from(["", "nan", "x", "1e400", "-", "0x1", "1,5", "inf"]), st.integers()
)


@settings(max_examples=60, deadline=None)
@given(
    names=st.lists(
        st.sampled_from(["time", "q.a", "theta.a", "dq.a", "tau_motor.a", "q_1", "q_2", ""]),
        min_size=1,
        max_size=5,
    ),
    cells=st.lists(CELLS, min_size=1, max_size=12),
    rows=st.integers(1, 120),
)
def test_whatever_a_table_holds_it_is_a_recording_or_refused(
    names: list[str], cells: list[object], rows: int
) -> None:
    lines = [",".join(names)]
    for k in range(rows):
        own = [
            k / 100 if name == "time" else cells[(k * len(names) + j) % len(cells)]
            for j, name in enumerate(names)
        ]
        lines.append(",".join(map(str, own)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_text("\n".join(lines))
        try:
            got = import_log(path).recording
        except FlexJointError as error:
            assert "\n" not in str(error) and len(str(error)) <= 300
        else:
            assert np.all(np.diff(got.time) > 0.0)
            assert not any(np.any(np.isinf(values)) for values in got.columns.values())


# --- in parts -----------------------------------------------------------------------------------------------
KINDS = {  # of cells, by what they are in the first rows, in most and in the last ones
    "whole_then_not": ("1", "2.5", "3"),
    "never_whole": ("1.5", "2.25", "1e3"),
    "whole": ("1", "2", "9007199254740993"),
    "whole_beyond": ("1", "2", "99999999999999999999"),
    "empty_first": ("", "1.5", "2"),
    "empty_always": ("", "nan", ""),
    "whole_with_empty": ("1", "", "3"),
    "word_late": ("1", "2", "running"),
    "word_first": ("idle", "2", "3"),
    "date": ("2026-11-24", "2026-11-24 10:00:00", "2026-11-24 10:00:00.25"),
    "date_then_number": ("2026-11-24", "5", "6"),
    "truth": ("1", "true", "0"),
}


@pytest.mark.parametrize("delimiter", [",", " "])
def test_a_text_that_is_read_in_parts_is_the_one_that_is_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, delimiter: str
) -> None:
    filled = {k: v for k, v in KINDS.items() if delimiter == "," or ("" not in v and "date" not in k)}
    places = [0] * 20 + [1] * 60 + [2] * 10
    rows = [delimiter.join(cells[k] for cells in filled.values()) for k in places]
    rows.insert(60, "")
    path = tmp_path / "log.txt"
    path.write_text("\n".join([delimiter.join(filled), *rows]), encoding="utf-8-sig")
    at_once = open_log(path)
    monkeypatch.setattr(text, "PART", 300)
    in_parts = open_log(path)
    assert (in_parts.notes, list(in_parts.signals)) == (at_once.notes, list(at_once.signals))
    for name, signal in at_once.signals.items():
        got = in_parts.signals[name].values
        assert got.dtype == signal.values.dtype, name
        assert got.tobytes() == signal.values.tobytes(), name


def test_a_part_is_no_more_than_was_asked_for_and_the_rest_of_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"0123456789\n" * 100)
    monkeypatch.setattr(text, "PART", 50)
    parts = list(text._parts(path))
    assert b"".join(parts) == path.read_bytes()
    assert all(part.endswith(b"\n") and len(part) <= 61 for part in parts)


def test_a_column_of_parquet_is_that_of_its_name_alone(tmp_path: Path) -> None:
    columns = [pa.array(M.time), pa.array(M.q[:, 0]), pa.array(M.q[:, 1]), pa.array([1.0] * M.time.size)]
    path = tmp_path / "log.parquet"
    pa.parquet.write_table(pa.table(columns, ["time", "a", "a.b", "a.b"]), path)
    log = open_log(path)
    assert np.array_equal(log.signals["a"].values[:, 0], M.q[:, 0])
    assert np.all(log.signals["a.b"].values == 1.0)  # of two with one name the last
