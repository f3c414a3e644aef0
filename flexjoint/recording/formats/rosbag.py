"""Bags of ROS 2 (a folder with metadata.yaml; SQLite or MCAP inside) and of ROS 1 (.bag)."""

from __future__ import annotations

from pathlib import Path

from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.core.running.progress import Report, silent
from flexjoint.recording.formats.ros_messages import EVERY, Messages, kind_of
from flexjoint.recording.logs.log import Log, unreadable
from flexjoint.recording.messages import refusal, shown

KIND = "bag of ROS"
SUFFIXES = (".bag", ".db3")


def is_folder(path: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return (path / "metadata.yaml").is_file()


def read(path: Path, report: Report = silent) -> Log:
    """A log of the messages about joints; reports the share of them that is read.

    Raises RecordingError with what is wrong with the bag, MissingExtraError where rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "ros") from None
    if path.suffix == ".db3":
        if not is_folder(path.parent):
            raise refusal(path, "its metadata.yaml is not beside it; give the folder that ros2 bag wrote")
        path = path.parent
    messages, others = Messages(), set()
    try:
        # bags that carry no definitions of their messages are read with those of ROS 2
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            wanted = [c for c in bag.connections if kind_of(c.msgtype) is not None]
            others |= {c.topic for c in bag.connections if kind_of(c.msgtype) is None}
            unknown = [c for c in wanted if c.msgtype not in bag.typestore.fielddefs]
            if unknown:
                raise refusal(
                    path,
                    f"{shown(unknown[0].topic)}: the bag holds no definition of"
                    f" {shown(unknown[0].msgtype)}; record it"
                    " as MCAP (ros2 bag record --storage mcap), which carries it",
                )
            count = max(1, sum(c.msgcount for c in wanted))
            for k, (connection, arrival, data) in enumerate(
                bag.messages(connections=wanted) if wanted else ()
            ):
                if k % EVERY == 0:
                    report(min(1.0, k / count), "reading")
                kind = kind_of(connection.msgtype)
                if kind is not None:
                    message = bag.deserialize(data, connection.msgtype)
                    messages.add(connection.topic, kind, message, arrival)
    except FlexJointError:
        raise
    except Exception as error:  # the library raises errors of its storages, which have no common base
        raise unreadable(str(path), KIND, error) from None
    return messages.log(str(path), KIND, others)
