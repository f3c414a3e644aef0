"""MCAP files with messages of ROS 2."""

from __future__ import annotations

from pathlib import Path

from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.core.running.progress import Report, silent
from flexjoint.recording.formats.ros_messages import EVERY, Messages, kind_of
from flexjoint.recording.logs.log import Log, unreadable
from flexjoint.recording.messages import refusal, shown

KIND = "MCAP, messages of ROS 2"
SUFFIXES = (".mcap",)


def read(path: Path, report: Report = silent) -> Log:
    """A log of the messages about joints; reports the share of the file that is read.

    Raises RecordingError with what is wrong with the file, MissingExtraError with what is not installed.
    """
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise MissingExtraError("mcap or mcap-ros2-support", "ros") from None
    messages, others = Messages(), set()
    decoders = DecoderFactory()
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            for k, (schema, channel, message) in enumerate(make_reader(file).iter_messages()):
                if k % EVERY == 0:
                    report(min(1.0, file.tell() / size), "reading")
                kind = kind_of(schema.name) if schema is not None else None
                decode = decoders.decoder_for(channel.message_encoding, schema) if kind is not None else None
                if kind is None:
                    others.add(channel.topic)
                elif decode is None:
                    raise refusal(
                        path,
                        f"{shown(channel.topic)} is encoded as {shown(channel.message_encoding)},"
                        f" expected cdr of ROS 2"
                        " with its message's definition; record it with ros2 bag",
                    )
                else:
                    messages.add(channel.topic, kind, decode(message.data), message.log_time)
    except FlexJointError:
        raise
    except Exception as error:  # the libraries of its compression raise errors without a common base
        raise unreadable(str(path), KIND, error) from None
    return messages.log(str(path), KIND, others)
