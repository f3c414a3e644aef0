"""Which format a log has, and its way from a path to a recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flexjoint.core.errors import RecordingError
from flexjoint.core.running.progress import Report, part, silent
from flexjoint.recording import table
from flexjoint.recording.formats import (
    hdf5,
    lerobot,
    libfranka,
    matlab,
    mcap,
    npz,
    pace,
    parquet,
    rosbag,
    text,
    ur_rtde,
)
from flexjoint.recording.logs import mapping as mappings
from flexjoint.recording.logs.conversion import Imported, converted
from flexjoint.recording.logs.log import Log
from flexjoint.recording.logs.mapping import EMPTY, MappingFile
from flexjoint.recording.messages import refusal, shown
from flexjoint.robot.robot import Robot

BY_SUFFIX: dict[str, Callable[[Path], Log]] = {
    suffix: module.read
    for module in (text, parquet, npz, matlab, hdf5, mcap, rosbag, pace)
    for suffix in module.SUFFIXES
}
TABLES = (".csv", ".parquet")
READING = 0.9  # share of the time of importing messages


def open_log(source: str | os.PathLike[str], episode: int | None = None, report: Report = silent) -> Log:
    """The log at a path, as it is; RecordingError says what is wrong, MissingExtraError which package is
    needed. Messages of ROS, which are read one by one, are reported."""
    path = Path(source)
    _check_there(path)
    if path.is_dir() and rosbag.is_folder(path):
        return rosbag.read(path, report)
    if (path.is_dir() or path.suffix == ".parquet") and lerobot.folder_of(path) is not None:
        return lerobot.read(path, episode)
    if path.is_dir():
        raise refusal(path, "is a folder, expected a bag of ROS 2 (metadata.yaml) or a LeRobot dataset", " ")
    suffix = path.suffix.lower()
    if suffix not in BY_SUFFIX:
        raise refusal(
            path, f"expected one of {', '.join(BY_SUFFIX)}, or a folder; got {shown(suffix) or 'no suffix'}"
        )
    if path.stat().st_size == 0:
        raise refusal(path, "is empty", " ")
    for module in (mcap, rosbag):
        if suffix in module.SUFFIXES:
            return module.read(path, report)
    return BY_SUFFIX[suffix](path)


def import_log(
    source: str | os.PathLike[str],
    mapping: MappingFile | Mapping[str, Any] | str | os.PathLike[str] = EMPTY,
    robot: Robot | None = None,
    progress: Report | None = None,
) -> Imported:
    """The recording of a log of any format, with an account of what was understood (docs/howto/importing.md).

    Args:
        source: a file, or the folder of a bag or dataset.
        mapping: what the log and its format do not say: a mapping file, or its keys
            (docs/reference/formats.md).
        robot: names joints in its order where the log names none, leaves out those that it does not have, and
            gives gear ratios and torque constants that nobody else states.
        progress: called with a share in [0, 1] and what is being done.

    Raises RecordingError where the log is unusable or leaves a doubt, with the option that answers it;
    MissingExtraError where the format's library is not installed.
    """
    if isinstance(mapping, str | os.PathLike):
        mapping = mappings.read(mapping)
    elif not isinstance(mapping, MappingFile):
        mapping = mappings.parse(mapping)
    report = progress or silent
    report(0.0, "reading")

    def opened() -> Log:
        log = open_log(source, mapping.episode, part(report, 0.0, READING))
        report(READING, "converting")
        return log

    imported = converted(opened(), mapping, robot)  # no name keeps the log: it leaves memory on the way
    report(1.0, "")
    return imported


def read(
    source: str | os.PathLike[str], mapping: MappingFile | None = None, robot: Robot | None = None
) -> Imported:
    """A recording of a path: flexjoint's own tables as they are where nothing is stated of them, other logs
    imported."""
    path = Path(source)
    if (mapping is None or mapping == EMPTY) and path.suffix in TABLES and not _foreign(path):
        return Imported(table.read(path), ())
    return import_log(path, mapping or EMPTY, robot)


def logs_in(source: str | os.PathLike[str]) -> tuple[Path, ...]:
    """The logs of a path: of a folder that is no log itself all files in it that could be one, by name.

    Raises RecordingError for a folder without any."""
    path = Path(source)
    if not path.is_dir() or rosbag.is_folder(path) or lerobot.folder_of(path) is not None:
        return (path,)
    found = tuple(sorted(p for p in path.iterdir() if p.is_file() and p.suffix.lower() in BY_SUFFIX))
    if not found:
        raise refusal(path, f"is a folder without a log ({', '.join(BY_SUFFIX)})", " ")
    return found


def _foreign(path: Path) -> bool:
    """Whether a CSV or Parquet file shows that it is another program's log."""
    if path.suffix == ".parquet":
        return lerobot.folder_of(path) is not None
    names = text.header(path) if path.is_file() else []
    return ur_rtde.is_one(names) or libfranka.is_one(names)


def _check_there(path: Path) -> None:
    try:
        there = path.exists()
    except (OSError, ValueError):  # a name too long, or with a zero byte
        there = False
    if not there:
        raise RecordingError(f"log {shown(path, 160)} does not exist; give the path of a file or folder")
