"""Files of arrays: .npz, .mat, HDF5 and PACE's .pt, each written by its own library."""

from __future__ import annotations

import io
import pickle
import tempfile
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from support.logs import JOINTS, assert_is, motion

from flexjoint.core.errors import FlexJointError, MissingExtraError, RecordingError
from flexjoint.core.text import plain
from flexjoint.recording.importing import import_log, open_log
from flexjoint.recording.logs import mapping

M = motion()


# --- npz ----------------------------------------------------------------------------------------------------
def test_an_npz_with_the_names_of_channels_needs_no_mapping(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(
        path, time=M.time, q=M.q, dq=M.dq, tau_motor=M.tau.T, joint_names=np.array(JOINTS), gains=[1, 2, 3]
    )
    got = import_log(path)
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "dq", M.dq)
    assert_is(got.recording, "tau_motor", M.tau)  # (2, N) is turned
    assert "not over time, and not used: gains" in plain(got.account)


def test_a_log_is_in_memory_twice_at_most(tmp_path: Path) -> None:
    """Once as read and once as converted; a third copy was held by the steps between."""
    path, rows = tmp_path / "log.npz", 100_000
    time = np.arange(rows) / 1000.0
    arrays = {name: np.sin(time[:, np.newaxis] + np.arange(5.0)) for name in ("q", "theta", "q_ref", "tau_m")}
    np.savez(path, time=time, **arrays)
    keys = mapping.parse({"joints": list("abcde"), "angles": "deg"})
    tracemalloc.start()
    import_log(path, keys)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.0 * sum(array.nbytes for array in arrays.values())


def test_an_npz_with_pickles_is_refused_and_nothing_of_it_runs(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "ran",))

    path = tmp_path / "log.npz"
    np.savez(path, time=M.time, evil=np.array([Evil()], dtype=object))
    (tmp_path / "ran").unlink(missing_ok=True)
    with pytest.raises(RecordingError, match="holds pickled objects, which could run code"):
        import_log(path)
    assert not (tmp_path / "ran").exists()


WHOLE = io.BytesIO()
np.savez(WHOLE, time=M.time[:80], q=M.q[:80], names=np.array(JOINTS))


@settings(max_examples=80, deadline=None)
@given(
    at=st.integers(0, len(WHOLE.getvalue()) - 1), piece=st.binary(min_size=1, max_size=8), cut=st.booleans()
)
def test_whatever_is_broken_in_an_npz_it_is_read_or_refused(at: int, piece: bytes, cut: bool) -> None:
    content = WHOLE.getvalue()
    content = content[:at] if cut else content[:at] + piece + content[at + len(piece) :]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        path.write_bytes(content)
        try:
            import_log(path)
        except FlexJointError as error:
            assert "\n" not in str(error) and len(str(error)) <= 300


SHAPES = st.lists(st.integers(0, 70), max_size=3)
KINDS = st.sampled_from(["f8", "f4", "i8", "u1", "?", "c16", "U3", "M8[s]"])


@settings(max_examples=80, deadline=None)
@given(
    st.dictionaries(st.sampled_from(["time", "q", "t", "theta", "joints", "x/q"]), st.tuples(SHAPES, KINDS))
)
def test_whatever_arrays_an_npz_holds_it_is_read_or_refused(arrays: dict[str, tuple[list[int], str]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        np.savez(path, **{name: np.ones(shape, dtype=kind) for name, (shape, kind) in arrays.items()})  # type: ignore[arg-type]
        try:
            import_log(path)
        except FlexJointError as error:
            assert "\n" not in str(error)


# --- mat ----------------------------------------------------------------------------------------------------
STRUCT = {
    "time": M.time,
    "pos_deg": np.degrees(M.q),
    "torque_Nm": M.tau.T,
    "names": np.array(JOINTS, dtype=object),
}
KEYS = {"joints": list(JOINTS), "channels": {"theta": "rec.pos_deg", "tau_motor": "rec.torque_Nm"}}


def test_a_mat_with_a_struct(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"rec": STRUCT, "note": "monday"})
    got = import_log(path, mapping.parse(KEYS))
    assert_is(got.recording, "theta", M.q)
    assert_is(got.recording, "tau_motor", M.tau)
    assert "deg: its name says so" in plain(got.account) and "N m: its name says so" in plain(got.account)


def test_a_broken_mat_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"rec": STRUCT})
    whole = path.read_bytes()
    for content in (b"not a mat file", whole[:1000], whole[:200] + b"\xff" * 400 + whole[600:]):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=r"cannot be read as|holds no array") as error:
            open_log(path)
        assert "\n" not in str(error.value)


# --- HDF5 ---------------------------------------------------------------------------------------------------
def test_an_hdf5_by_the_paths_of_its_data_sets(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["run/time"] = M.time
        file["run/q"] = M.q
        file["run/tau_motor"] = M.tau
        file["run/joint_names"] = [name.encode() for name in JOINTS]
        file["run/elsewhere"] = h5py.ExternalLink("/etc/passwd", "/x")
        raw = file.create_dataset(
            "run/raw", (len(M.time),), "f8", external=[("/etc/passwd", 0, 8 * len(M.time))]
        )
        assert raw.external
    got = import_log(path)
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "tau_motor", M.tau)
    assert "run/raw" not in open_log(path).signals


def test_a_mat_of_version_7_3_is_an_hdf5(tmp_path: Path) -> None:
    """MATLAB writes HDF5 behind a header of 512 bytes, arrays transposed; h5py writes the same."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["rec/time"] = M.time[np.newaxis]
        file["rec/pos_deg"] = np.degrees(M.q).T
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(head.ljust(512, b"\x00"))
    keys = {"joints": list(JOINTS), "channels": {"theta": "rec/pos_deg"}}
    assert_is(import_log(path, mapping.parse(keys)).recording, "theta", M.q)


def test_a_broken_hdf5_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "log.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + b"\x00" * 100)
    with pytest.raises(RecordingError, match="cannot be read as HDF5 file"):
        open_log(path)


# --- PACE ---------------------------------------------------------------------------------------------------
def test_a_trajectory_of_pace(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    path = tmp_path / "chirp.pt"
    content = {"time": M.time, "dof_pos": M.q, "des_dof_pos": M.q + 0.01}
    torch.save({name: torch.from_numpy(array) for name, array in content.items()}, path)
    got = import_log(path, mapping.parse({"joints": list(JOINTS)}))
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "q_ref", M.q + 0.01)


def test_a_pt_file_that_would_run_code_is_refused(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")

    class Evil:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "ran",))

    path = tmp_path / "chirp.pt"
    torch.save({"time": Evil()}, path)
    (tmp_path / "ran").unlink(missing_ok=True)
    with pytest.raises(RecordingError, match="holds more than tensors, which could run code"):
        open_log(path)
    path.write_bytes(pickle.dumps({"time": [1.0]})[:-3])
    with pytest.raises(RecordingError):
        open_log(path)
    assert not (tmp_path / "ran").exists()


# --- libraries that are not there ---------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [
        ("log.h5", "h5py", "hdf5"),
        ("log.pt", "torch", "torch"),
        ("log.mcap", "mcap.reader", "ros"),
        ("log.bag", "rosbags.highlevel", "ros"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, extra: str
) -> None:
    monkeypatch.setitem(__import__("sys").modules, module, None)
    monkeypatch.setitem(__import__("sys").modules, module.split(".", maxsplit=1)[0], None)
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(MissingExtraError, match=rf"pip install 'flexjoint\[{extra}\]'"):
        open_log(tmp_path / name)
