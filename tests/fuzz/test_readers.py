"""Every reader with the bytes of good files changed: refused in words, or read; no traceback, no crash."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import math
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io
import yaml
from fuzz.hostile import fuzz, mutated, only_refusals
from hypothesis import given
from hypothesis import strategies as st
from support import fake_diagnosis
from support.robots.robot_files import MJCF, URDF, content

from flexjoint.cli.simulation import theta_d
from flexjoint.core.errors import RobotWarning
from flexjoint.diagnosis.followup import experiment
from flexjoint.diagnosis.followup.fleet import roster
from flexjoint.diagnosis.result.known import known_of
from flexjoint.recording import table as recording
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.importing import import_log
from flexjoint.recording.logs import mapping
from flexjoint.robot import payload, robot
from flexjoint.robot.robot import Robot
from flexjoint_benchmark import BenchmarkError
from flexjoint_benchmark.folder import SEAL
from flexjoint_benchmark.score import score

YAML = yaml.safe_dump(content(lock=["wrist"], contacts=[], effects=[{"effect": "backlash", "joint": "elbow", "gap": 0.01}])).encode()  # fmt: skip  # noqa: E501
TABLE = {
    "time": np.arange(60) / 250.0,
    "q.elbow": np.sin(np.arange(60) / 9.0),
    "theta.elbow": np.sin(np.arange(60) / 9.0) + 0.01,
    "tau_m.elbow": np.cos(np.arange(60) / 9.0),
}
CSV = "\n".join([",".join(TABLE), *(",".join(f"{x:.6g}" for x in row) for row in zip(*TABLE.values(), strict=True))]).encode()  # fmt: skip  # noqa: E501
SDF = """<sdf version="1.9"><model name="arm"><pose>0 0 1 0.1 0 0</pose>
<frame name="mark" attached_to="a"><pose relative_to="b">0 0 0.2 0 0.3 0</pose></frame>
<link name="a"><inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia>
</inertial></link>
<link name="b"><pose relative_to="j">0 0.1 0 0 0 0</pose><inertial><pose>0 0 0.1 0 0 0</pose><mass>1</mass>
<inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>
<joint name="j" type="revolute"><pose relative_to="a">0 0 0.5 0 0 0</pose><parent>a</parent><child>b</child>
<axis><xyz expressed_in="mark">0 1 0</xyz><limit><lower>-1</lower><upper>1</upper><effort>30</effort></limit>
<dynamics><damping>0.1</damping><friction>0.2</friction></dynamics></axis></joint></model></sdf>"""
POSES = b"time,q.shoulder,q.elbow\n0,0.1,0.2\n1,-0.1,0.3\n2.5,0,1.4\n"
MAPPING = b"""time: stamp
time_unit: ms
joints: [shoulder, elbow]
rename: {j1: shoulder, j2: elbow}
angles: deg
gear_ratio: [100, 50.5]
torque_constant: {shoulder: 0.1, elbow: 0.2}
channels: {q: actual_q, current: {from: [c1, c2], unit: A, sign: -1, offset: 0.5}}
"""
LIST = b"""recording,machine,robot,time,temperature,event
a.csv,one,arm.yaml,2026-11-24T06:00,21.5,
20261125_0700.csv,one,arm.yaml,,,
,one,,2026-11-26,,new gear
"""
CASES = b'{"schema": 1, "seed": 1, "cases": {"c1": {"robot": "r.yaml", "recording": "r.parquet", "joints": ["elbow"]}}, "effects": {"backlash": {"parameters": ["gap"]}}}'  # noqa: E501
ANSWERS = b'{"schema": 1, "tool": "t", "answers": {"c1": {"findings": [{"effect": "backlash", "joint": "elbow", "probability": 0.9, "parameters": {"gap": {"value": 0.01, "std": 0.001}}, "indistinguishable": [{"effect": "end_stop", "joint": "elbow"}]}], "seconds": 3.2}}}'  # noqa: E501
TRUTH = {"c1": {"part": "clean", "joints": ["elbow"], "truth": [{"effect": "backlash", "joint": "elbow", "parameters": {"gap": 0.01}}]}}  # fmt: skip  # noqa: E501
DIAGNOSIS = b'{"schema": 1, "verdict": "causes", "findings": [{"effect": "backlash", "joint": "elbow", "parameters": {"gap": {"value": 0.01}}, "indistinguishable": [{"effect": "end_stop", "joint": "elbow"}]}], "comparison": {"noise_floor": {"rms": {"q.elbow": 0.0001}}}}'  # noqa: E501

KNOWN = b'{"schema": 1, "verdict": "causes", "findings": [{"effect": "backlash", "joint": "elbow", "probability": 0.9, "parameters": {"gap": {"value": 0.01, "std": 0.001}}}], "remaining": [], "level": {"after": 1.5}, "trace": [{"stage": "search"}]}'  # noqa: E501


def parquet() -> bytes:
    sink = io.BytesIO()
    pa.parquet.write_table(pa.table(TABLE), sink)
    return sink.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("files")
    (made / "arm2.urdf").write_text(URDF)
    return made


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return fake_diagnosis.arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotWarning)
        yield


@pytest.mark.parametrize(
    ("suffix", "good"),
    [("urdf", URDF), ("xml", MJCF.format(free="")), ("sdf", SDF)],
    ids=["urdf", "mjcf", "sdf"],
)
@fuzz(100)
@given(data=st.data())
def test_a_description(folder: Path, suffix: str, good: str, data: st.DataObject) -> None:
    path = folder / f"arm.{suffix}"
    path.write_bytes(data.draw(mutated(good.encode())))
    with only_refusals():
        loaded = robot.load(path)
        assert np.all(np.isfinite([body.mass for body in loaded.model.inertias]))
        assert loaded.mass >= 0.0


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@fuzz(100)
@given(data=st.data())
def test_a_recording(folder: Path, suffix: str, data: st.DataObject) -> None:
    path = folder / f"table.{suffix}"
    path.write_bytes(data.draw(mutated(CSV if suffix == "csv" else parquet())))
    with only_refusals():
        read = on_regular_clock(recording.read(path))
        assert np.all(np.diff(read.time) > 0.0) and not any(
            np.any(np.isinf(v)) for v in read.columns.values()
        )


def log(suffix: str) -> bytes:
    """A log of another program, in a format of `flexjoint import`."""
    if suffix == "txt":
        return CSV.replace(b",", b" ")
    sink = io.BytesIO()
    if suffix == "npz":
        np.savez(sink, time=TABLE["time"], q=TABLE["q.elbow"])
    elif suffix == "mat":
        scipy.io.savemat(sink, {"time": TABLE["time"], "log": {"q": TABLE["q.elbow"]}})
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(sink, "w") as file:
            file.update({"time": TABLE["time"], "q": TABLE["q.elbow"]})
    return sink.getvalue()


@pytest.mark.parametrize("suffix", ["txt", "npz", "mat", "h5"])
@fuzz(40)
@given(data=st.data())
def test_a_log(folder: Path, suffix: str, data: st.DataObject) -> None:
    path = folder / f"log.{suffix}"
    path.write_bytes(data.draw(mutated(log(suffix))))
    with only_refusals():
        read = import_log(path, mapping.parse({"joints": ["elbow"]})).recording
        assert np.all(np.diff(read.time) > 0.0)


Reader = Callable[[Path, Robot], object]  # of a file; the robot is what it is of


def read_robot(path: Path, _arm: Robot) -> None:
    robot.load(path)


def read_poses(path: Path, arm: Robot) -> None:
    assert np.all(np.isfinite(theta_d.read_poses(path, arm).q))


def read_diagnosis(path: Path, arm: Robot) -> None:
    experiment.read(path, arm)


def read_known(path: Path, arm: Robot) -> None:
    known_of(arm, path)


def read_mapping(path: Path, _arm: Robot) -> None:
    mapping.read(path)


def read_list(path: Path, _arm: Robot) -> None:
    assert all(math.isfinite(one.time) for one in roster.read(path, path.with_name("arm.yaml")).entries)


@pytest.mark.parametrize(
    ("name", "good", "read"),
    [
        pytest.param("robot.yaml", YAML, read_robot, id="robot file"),
        pytest.param("poses.csv", POSES, read_poses, id="table of poses"),
        pytest.param("diagnosis.json", DIAGNOSIS, read_diagnosis, id="diagnosis"),
        pytest.param("known.json", KNOWN, read_known, id="what a check is made against"),
        pytest.param("map.yaml", MAPPING, read_mapping, id="mapping"),
        pytest.param("list.csv", LIST, read_list, id="list of a fleet"),
    ],
)
@fuzz(60)
@given(data=st.data())
def test_a_file(folder: Path, arm: Robot, name: str, good: bytes, read: Reader, data: st.DataObject) -> None:
    path = folder / name
    path.write_bytes(data.draw(mutated(good)))
    with only_refusals():
        read(path, arm)


@fuzz(60)
@given(data=st.data())
def test_a_benchmark(folder: Path, data: st.DataObject) -> None:
    for name, good in {"cases.json": CASES, "answers.json": ANSWERS, "truth.sealed": sealed()}.items():
        changed = data.draw(st.booleans())
        (folder / name).write_bytes(data.draw(mutated(good)) if changed else good)
    with contextlib.suppress(BenchmarkError), only_refusals():
        str(score(folder, folder / "answers.json"))


def sealed() -> bytes:
    return SEAL.encode() + base64.b64encode(zlib.compress(json.dumps({"cases": TRUTH}).encode()))


@fuzz(60)
@given(text=mutated(b"a.csv:elbow=1.5,0,0,0.1").map(lambda data: data.decode("utf-8", "replace")))
def test_a_known_payload(text: str) -> None:
    with only_refusals():
        payload.parse([text], ["a.csv"])


@fuzz(100)
@given(
    steps=st.lists(
        st.one_of(
            st.sampled_from([0.001, 0.001, 0.001, 0.0, -0.001, 1e-9, 0.0004, 0.5, 2.0, 1e5, 1e9]),
            st.floats(-0.01, 0.01),
        ),
        min_size=50,
        max_size=150,
    ),
    unit=st.sampled_from([1.0, 1.0, 1e3, 1e6, 1e9]),
    whole=st.booleans(),
    start=st.sampled_from([0.0, 1.7e9, -5.0]),
)
def test_time_stamps(steps: list[float], unit: float, whole: bool, start: float) -> None:
    """Whatever a logger stamped: refused, or made into times that increase, no work growing with them."""
    time = (start + np.cumsum(steps)) * unit
    if whole:
        time = np.round(np.clip(time, -4e18, 4e18)).astype(np.int64)
    with only_refusals():
        read = on_regular_clock(recording.make(time, {("q", "elbow"): np.sin(np.arange(len(steps)) / 9.0)}))
        assert np.all(np.diff(read.time) > 0.0) and np.all(np.isfinite(read.time))
        assert read.duration <= 20.0 * len(steps) * max(read.period, 1.0)


def test_what_was_changed_was_good(folder: Path, arm: Robot) -> None:
    """Else the tests above would change what is refused anyway."""
    (folder / "good.yaml").write_bytes(YAML)
    assert robot.load(folder / "good.yaml").joint_names == ("shoulder", "elbow")
    (folder / "good.sdf").write_text(SDF)
    assert robot.load(folder / "good.sdf").joint_names == ("j",)
    for name, data in (("good.csv", CSV), ("good.parquet", parquet())):
        (folder / name).write_bytes(data)
        assert recording.read(folder / name).joints == ("elbow",)
    for suffix in ("txt", "npz", "mat", "h5"):
        (folder / f"good.{suffix}").write_bytes(log(suffix))
        assert import_log(folder / f"good.{suffix}", {"joints": ["elbow"]}).recording.joints == ("elbow",)
    (folder / "good.json").write_bytes(DIAGNOSIS)
    (folder / "poses.csv").write_bytes(POSES)
    assert theta_d.read_poses(folder / "poses.csv", arm).q.shape == (3, 2)
    assert len(experiment.read(folder / "good.json", arm).ties) == 1
    (folder / "known.json").write_bytes(KNOWN)
    assert len(known_of(arm, folder / "known.json").causes) == 1
    (folder / "good_map.yaml").write_bytes(MAPPING)
    assert set(mapping.read(folder / "good_map.yaml").channels) == {"q", "current"}
    (folder / "good_list.csv").write_bytes(LIST)
    assert len(roster.read(folder / "good_list.csv").entries) == 2
    for name, data in (("cases.json", CASES), ("answers.json", ANSWERS), ("truth.sealed", sealed())):
        (folder / name).write_bytes(data)
    assert score(folder, folder / "answers.json").rows[0].right == 1
