"""MCAP files and bags of ROS, written by the libraries mcap and rosbags."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Of
from typing import Any

import numpy as np
import pytest
from support.logs import JOINTS, assert_is, motion

from flexjoint.core.errors import RecordingError
from flexjoint.core.text import plain
from flexjoint.recording.formats import mcap
from flexjoint.recording.formats.ros_messages import CONTROLLER, DYNAMIC, STATE, Messages
from flexjoint.recording.importing import import_log, open_log
from flexjoint.recording.logs.conversion import converted

M = motion()
START = 1_700_000_000_000_000_000  # ns
SEPARATOR = "=" * 80
JOINT_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def stamp(k: int) -> tuple[int, dict[str, int]]:
    ns = START + round(float(M.time[k]) * 1e9)
    return ns, {"sec": ns // 10**9, "nanosec": ns % 10**9}


def assert_is_the_motion(path: Path, **given: Any) -> str:
    got = import_log(path, **given)
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "dq", M.dq)
    assert_is(got.recording, "tau_motor", M.tau)
    assert got.recording.time == pytest.approx(M.time, abs=1e-9)
    return plain(got.account)


# --- MCAP ---------------------------------------------------------------------------------------------------
def write_mcap(path: Path) -> None:
    mcap_ros2 = pytest.importorskip("mcap_ros2.writer", reason="mcap-ros2-support is not installed")
    with path.open("wb") as file, mcap_ros2.Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        words = writer.register_msgdef("std_msgs/msg/String", "string data\n")
        for k in range(M.time.size):
            ns, header = stamp(k)
            order = [0, 1] if k % 2 else [1, 0]  # a driver may name joints in any order
            message = {
                "header": {"stamp": header, "frame_id": ""},
                "name": [JOINTS[i] for i in order],
                "position": M.q[k][order].tolist(),
                "velocity": M.dq[k][order].tolist(),
                "effort": M.tau[k][order].tolist(),
            }
            writer.write_message("/joint_states", schema, message, ns + 300_000)
            if k % 10 == 0:
                writer.write_message("/rosout", words, {"data": "x"}, ns)


def test_an_mcap_with_joint_states(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap")
    said = assert_is_the_motion(tmp_path / "log.mcap")
    assert "MCAP, messages of ROS 2" in said and "topics not read: /rosout" in said
    assert "JointState.effort is in N m; if the driver publishes currents, say so" in said


def test_messages_that_are_read_tell_how_far_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap, "EVERY", 20)
    write_mcap(tmp_path / "log.mcap")
    told: list[float] = []
    import_log(tmp_path / "log.mcap", progress=lambda share, _what: told.append(share))
    assert told == sorted(told) and told[0] == 0.0 and told[-1] == 1.0
    assert len(told) > 5


def test_a_broken_mcap_is_refused(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap")
    whole = (tmp_path / "log.mcap").read_bytes()
    rng = np.random.default_rng(3)
    for k in range(12):
        at = int(rng.integers(0, len(whole)))
        content = whole[:at] if k % 2 else whole[:at] + bytes(64) + whole[at + 64 :]
        (tmp_path / "log.mcap").write_bytes(content)
        try:
            open_log(tmp_path / "log.mcap")
        except RecordingError as error:
            assert "\n" not in str(error)
    (tmp_path / "log.mcap").write_bytes(b"no mcap")
    with pytest.raises(RecordingError, match="cannot be read as MCAP"):
        open_log(tmp_path / "log.mcap")


def test_an_mcap_of_another_encoding_is_refused(tmp_path: Path) -> None:
    writers = pytest.importorskip("mcap.writer", reason="mcap is not installed")
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = writers.Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/JointState", "jsonschema", b"{}")
        channel = writer.register_channel("/joint_states", "json", schema)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(RecordingError, match="/joint_states is encoded as json, expected cdr of ROS 2"):
        open_log(tmp_path / "log.mcap")


# --- bags ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_bag_of_ros_2(tmp_path: Path, storage: str) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header, time = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    folder = tmp_path / "bag"
    plugin = getattr(rosbag2.StoragePlugin, storage)
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(M.time.size):
            ns, at = stamp(k)
            message = state(header(time(**at), ""), list(JOINTS), M.q[k], M.dq[k], M.tau[k])
            writer.write(topic, ns + 200_000, store.serialize_cdr(message, state.__msgtype__))
    assert "bag of ROS" in assert_is_the_motion(folder)
    if storage == "SQLITE3":
        assert_is_the_motion(next(folder.glob("*.db3")))


def test_a_bag_of_ros_1(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    state, header, time = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with rosbag1.Writer(tmp_path / "log.bag") as writer:
        topic = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(M.time.size):
            ns, at = stamp(k)
            message = state(header(k, time(**at), ""), list(JOINTS), M.q[k], M.dq[k], M.tau[k])
            writer.write(topic, ns, store.serialize_ros1(message, state.__msgtype__))
    assert_is_the_motion(tmp_path / "log.bag")


def test_broken_bags_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n\x00\x00")
    (tmp_path / "alone.db3").write_bytes(b"SQLite format 3\x00")
    for name, said in (
        ("bag", "cannot be read as"),
        ("log.bag", "cannot be read as"),
        ("alone.db3", "metadata.yaml"),
    ):
        with pytest.raises(RecordingError, match=said) as error:
            open_log(tmp_path / name)
        assert "\n" not in str(error.value)


# --- messages, whatever file they come from -----------------------------------------------------------------
def header_of(k: int) -> Of:
    return Of(stamp=Of(**stamp(k)[1]))


def test_a_controllers_state_gives_references_and_outputs() -> None:
    messages = Messages()
    for k in range(M.time.size):
        point = Of(positions=M.q[k], velocities=[], effort=[])
        output = Of(positions=[], velocities=[], effort=M.tau[k])
        message = Of(header=header_of(k), joint_names=list(JOINTS), reference=point, output=output)
        messages.add("/arm/controller_state", CONTROLLER, message, stamp(k)[0])
        state = Of(header=header_of(k), name=list(JOINTS), position=M.q[k], velocity=[], effort=[])
        messages.add("/joint_states", STATE, state, stamp(k)[0])
    recording = converted(messages.log("x.mcap", "MCAP", ())).recording
    assert_is(recording, "q_ref", M.q)
    assert_is(recording, "tau_m", M.tau)


def test_dynamic_joint_states_are_used_where_there_is_no_joint_state() -> None:
    def filled(with_state: bool) -> Messages:
        messages = Messages()
        for k in range(M.time.size):
            values = [
                Of(interface_names=["position", "effort", "mode"], values=[*row, 1.0])
                for row in zip(M.q[k], M.tau[k], strict=True)
            ]
            message = Of(header=header_of(k), joint_names=list(JOINTS), interface_values=values)
            messages.add("/dynamic_joint_states", DYNAMIC, message, stamp(k)[0])
            if with_state:
                state = Of(
                    header=header_of(k), name=list(JOINTS), position=M.q[k] + 0.1, velocity=[], effort=[]
                )
                messages.add("/joint_states", STATE, state, stamp(k)[0])
        return messages

    alone = converted(filled(False).log("x.mcap", "MCAP", ())).recording
    assert_is(alone, "q", M.q)
    assert_is(alone, "tau_motor", M.tau)
    assert_is(converted(filled(True).log("x.mcap", "MCAP", ())).recording, "q", M.q + 0.1)


def test_an_arm_and_a_gripper_on_one_topic_are_two_signals_and_arrivals_stand_for_stamps() -> None:
    messages = Messages()
    for k in range(M.time.size):
        state = Of(
            header=Of(stamp=Of(sec=0, nanosec=0)), name=list(JOINTS), position=M.q[k], velocity=[], effort=[]
        )
        messages.add("/joint_states", STATE, state, stamp(k)[0])
        if k % 2 == 0:
            gripper = Of(header=header_of(k), name=["finger"], position=[0.01], velocity=[], effort=[])
            messages.add("/joint_states", STATE, gripper, stamp(k)[0])
    log = messages.log("x.mcap", "MCAP", ())
    assert list(log.signals) == ["/joint_states.position", "/joint_states.position#2"]
    assert "times of arrival are used: /joint_states.position" in log.notes[0]
    recording = converted(log).recording
    assert recording.joints == (*JOINTS, "finger")
    assert_is(recording, "q", M.q)


def test_a_log_without_messages_about_joints_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"holds no message about joints.*its topics are /tf"):
        Messages().log("x.mcap", "MCAP", ["/tf"])
