"""Messages of ROS about joints, whatever file they come from, to signals.

sensor_msgs/JointState: position [rad or m], velocity, effort [N m or N], by joint; a joint state that is
published for the arm and the gripper apart makes two signals. control_msgs/JointTrajectoryControllerState and
DynamicJointState, of ros2_control. std_msgs/Float64MultiArray: commands, which a mapping has to name.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexjoint.recording.logs.log import Documented, Log, Signal, named
from flexjoint.recording.messages import refusal

STATE = "sensor_msgs/JointState"
CONTROLLER = "control_msgs/JointTrajectoryControllerState"
DYNAMIC = "control_msgs/DynamicJointState"
ARRAY = "std_msgs/Float64MultiArray"
SUPPORTED = (STATE, CONTROLLER, DYNAMIC, ARRAY)
ANGLE = "REP 103: radians; of joints that slide metres"
EFFORT = "JointState.effort is in N m; if the driver publishes currents, say so with unit: A in a mapping"
MEANINGS = {  # by message and field
    (STATE, "position"): Documented("q", "rad", ANGLE),
    (STATE, "velocity"): Documented("dq", "rad/s", ANGLE),
    (STATE, "effort"): Documented("tau_motor", "N m", EFFORT, "link"),
    (DYNAMIC, "position"): Documented("q", "rad", ANGLE),
    (DYNAMIC, "velocity"): Documented("dq", "rad/s", ANGLE),
    (DYNAMIC, "effort"): Documented("tau_motor", "N m", EFFORT, "link"),
    (CONTROLLER, "reference.positions"): Documented("q_ref", "rad", ANGLE),
    (CONTROLLER, "desired.positions"): Documented("q_ref", "rad", ANGLE),
    (CONTROLLER, "output.effort"): Documented("tau_m", "N m", "the controller's output", "link"),
}
EVERY = 1000  # messages between two reports
POINTS = ("reference", "desired", "feedback", "actual", "output")  # of a controller's state, by its versions
VALUES = ("positions", "velocities", "effort")


@dataclass
class _Stream:
    """The samples of one field of one topic for one set of joints."""

    kind: str
    joints: tuple[str, ...]
    stamps: list[int] = field(default_factory=list)
    arrivals: list[int] = field(default_factory=list)
    rows: list[np.ndarray] = field(default_factory=list)


class Messages:
    """Collects messages; `log` makes signals of them."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, str, frozenset[str] | int], _Stream] = {}

    def add(self, topic: str, kind: str, message: Any, arrival: int) -> None:
        """One message of a supported kind (`kind_of`), with its time of arrival [ns]."""
        stamp = _stamp(message)
        if kind == STATE:
            names = tuple(map(str, message.name))
            for name in ("position", "velocity", "effort"):
                self._add(topic, name, kind, names, getattr(message, name), stamp, arrival)
        elif kind == CONTROLLER:
            names = tuple(map(str, message.joint_names))
            for point in POINTS:
                for value in VALUES if hasattr(message, point) else ():
                    values = getattr(getattr(message, point), value)
                    self._add(topic, f"{point}.{value}", kind, names, values, stamp, arrival)
        elif kind == DYNAMIC:
            found: dict[str, dict[str, float]] = {}
            for joint, values in zip(message.joint_names, message.interface_values, strict=False):
                for name, value in zip(values.interface_names, values.values, strict=False):
                    found.setdefault(str(name), {})[str(joint)] = float(value)
            for name, by_joint in found.items():
                self._add(topic, name, kind, tuple(by_joint), list(by_joint.values()), stamp, arrival)
        elif kind == ARRAY:
            self._add(topic, "data", kind, (), message.data, stamp, arrival)

    def _add(
        self, topic: str, name: str, kind: str, joints: tuple[str, ...], values: Any, stamp: int, arrival: int
    ) -> None:
        row = np.asarray(values, dtype=float)
        if row.ndim != 1 or not row.size or (joints and row.size != len(joints)):
            return  # a field that the publisher leaves empty
        key = (topic, name, frozenset(joints) if joints else row.size)
        stream = self._streams.setdefault(key, _Stream(kind, joints))
        if joints != stream.joints:  # the same joints in another order
            row = row[[joints.index(joint) for joint in stream.joints]]
        stream.stamps.append(stamp)
        stream.arrivals.append(arrival)
        stream.rows.append(row)

    def log(self, source: str, kind: str, others: Iterable[str]) -> Log:
        """The log of all messages; `others` are topics that are not read. RecordingError where there is"
        " none."""
        left = sorted(set(others))
        if not self._streams:
            raise refusal(
                source,
                f"holds no message about joints ({', '.join(SUPPORTED)}); its topics are"
                f" {named(left) or 'none'}",
            )
        signals: dict[str, Signal] = {}
        documented: dict[str, Documented] = {}
        notes = [f"topics not read: {named(left)}"] if left else []
        states = any(stream.kind == STATE for stream in self._streams.values())
        late: list[str] = []
        for (topic, field_name, _), stream in self._streams.items():
            name = own = f"{topic}.{field_name}"
            count = 1
            while own in signals:
                count += 1
                own = f"{name}#{count}"
            if len(set(stream.joints)) != len(stream.joints):
                raise refusal(source, f"{name}: a message names a joint twice: {named(stream.joints)}")
            stamped = all(stream.stamps)
            late += [] if stamped else [own]
            stamps = np.array(stream.stamps if stamped else stream.arrivals, dtype=np.int64)
            signals[own] = Signal(np.stack(stream.rows), (), stream.joints, stamps)
            meaning = MEANINGS.get((stream.kind, field_name))
            if meaning is not None and not (stream.kind == DYNAMIC and states):
                documented[own] = meaning
        if late:
            notes.append(f"without stamps in their headers, times of arrival are used: {named(late)}")
        return Log(source, kind, signals, documented, time_unit="ns", notes=tuple(notes))


def kind_of(name: str) -> str | None:
    """The supported kind of a message's type, `sensor_msgs/msg/JointState` of ROS 2 or that of ROS 1."""
    short = name.replace("/msg/", "/")
    return short if short in SUPPORTED else None


def _stamp(message: Any) -> int:
    """The stamp of a message's header [ns], 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return 0
    seconds = getattr(stamp, "sec", None)
    nanoseconds = getattr(stamp, "nanosec", None)
    if seconds is None or nanoseconds is None:
        return 0
    return int(seconds) * 10**9 + int(nanoseconds)
