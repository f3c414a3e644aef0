"""Every section of docs/howto/importing.md: its mapping reads a log of its format; no format lacks one."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io
import yaml
from recording.formats import test_lerobot, test_ros
from support.logs import JOINTS, Motion, motion, write_csv
from support.pages import DOCS

from flexjoint.recording import formats
from flexjoint.recording.importing import import_log
from flexjoint.recording.logs import mapping
from flexjoint.recording.table import Recording

PAGE = (DOCS / "howto" / "importing.md").read_text(encoding="utf-8")
M = motion()
RATIO = np.array([100.0, 50.0])
SECTIONS = {
    title: yaml.safe_load(block)
    for title, block in re.findall(r"^### (.+?)\n.*?^```yaml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
}


def of_mcap(folder: Path) -> Path:
    test_ros.write_mcap(folder / "log.mcap")
    return folder / "log.mcap"


def of_bag(folder: Path) -> Path:
    test_ros.test_a_bag_of_ros_1(folder)  # writes it
    return folder / "log.bag"


def of_lerobot(folder: Path) -> Path:
    return test_lerobot.dataset(folder / "set", 3, list(JOINTS))


def of_rtde(folder: Path) -> Path:
    return Path(__file__).parent / "written" / "ur_rtde.csv"


def of_libfranka(folder: Path) -> Path:
    columns = {"time": 1e3 * M.time, "success_rate": np.ones(M.time.size)}
    columns |= {f"state.q[{k}]": M.q[:, k % 2] for k in range(7)}
    return write_csv(folder / "franka.csv", columns)


def of_matlab(folder: Path) -> Path:
    scipy.io.savemat(folder / "log.mat", {"log": {"t": M.time, "pos": np.degrees(M.q).T}})
    return folder / "log.mat"


def of_numpy(folder: Path) -> Path:
    np.savez(folder / "log.npz", clock=M.time, motor_pos=M.q * RATIO / (2.0 * np.pi))
    return folder / "log.npz"


def of_hdf5(folder: Path) -> Path:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    with h5py.File(folder / "log.h5", "w") as file:
        file["run/stamp"], file["run/position"] = 1e3 * M.time, M.q
    return folder / "log.h5"


def of_pace(folder: Path) -> Path:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    torch.save({"time": torch.tensor(M.time), "dof_pos": torch.tensor(M.q)}, folder / "log.pt")
    return folder / "log.pt"


def of_table(folder: Path) -> Path:
    amperes = 1e3 * M.tau / (0.1 * RATIO * np.array([1.0, -1.0]))
    columns = {f"pos_{k + 1}": np.degrees(M.q[:, k]) for k in range(2)}
    columns |= {f"cur_{k + 1}": amperes[:, k] for k in range(2)}
    pa.parquet.write_table(pa.table(columns), folder / "log.parquet")
    return write_csv(folder / "log.csv", columns)


WRITERS: dict[str, tuple[Callable[[Path], Path], tuple[str, ...]]] = {
    "MCAP": (of_mcap, ("mcap", "ros_messages")),
    "Bags of ROS": (of_bag, ("rosbag",)),
    "LeRobot": (of_lerobot, ("lerobot",)),
    "Universal Robots RTDE": (of_rtde, ("ur_rtde",)),
    "libfranka": (of_libfranka, ("libfranka",)),
    "MATLAB": (of_matlab, ("matlab",)),
    "NumPy": (of_numpy, ("npz",)),
    "HDF5": (of_hdf5, ("hdf5",)),
    "PACE": (of_pace, ("pace",)),
    "Any other table": (of_table, ("text", "parquet")),
}


def test_every_format_has_a_section() -> None:
    assert list(SECTIONS) == list(WRITERS)
    modules = {path.stem for path in Path(str(formats.__file__)).parent.glob("*.py")} - {"__init__"}
    assert modules == {module for _, some in WRITERS.values() for module in some}


def positions(recording: Recording) -> np.ndarray:
    channel = "q" if ("q", recording.joints[0]) in recording.columns else "theta"
    joints = JOINTS if set(recording.joints) == set(JOINTS) else recording.joints
    return np.stack([recording.get(channel, joint) for joint in joints], axis=1)


@pytest.mark.parametrize("title", WRITERS)
def test_the_mapping_of_a_section_reads_such_a_log(title: str, tmp_path: Path) -> None:
    write, _ = WRITERS[title]
    keys = mapping.parse(SECTIONS[title])
    given = import_log(write(tmp_path), keys).recording
    expected = expected_of(title, given.time)
    assert given.time.size == len(expected)
    # six decimals are what ur_rtde writes, and one row in ten may mix two of its packages
    assert np.mean(np.abs(positions(given) - expected) < 2e-6) > (0.9 if "RTDE" in title else 0.999)
    if title == "Any other table":
        torque = np.stack([given.get("tau_motor", joint) for joint in JOINTS], axis=1)
        assert torque == pytest.approx(M.tau, rel=1e-9)
        assert positions(import_log(tmp_path / "log.parquet", keys).recording) == pytest.approx(M.q)


def expected_of(title: str, time: np.ndarray) -> np.ndarray:
    if title == "Universal Robots RTDE":
        t = time - 1000.0
        return 0.4 * np.sin(np.outer(t, 1.0 + 0.3 * np.arange(6)) + np.arange(6))
    if title == "libfranka":
        return np.stack([M.q[:, k % 2] for k in range(7)], axis=1)
    moved: Motion = motion(3.0, 60.0) if title == "LeRobot" else M
    return moved.q
