"""LeRobot datasets: a folder with meta/info.json and data/**/*.parquet, one episode of it.

Layout of versions 2 and 3 as the dataset's own info.json describes it: features with their names, fps, and
in each row episode_index and frame_index; an episode's time is frame_index / fps.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from flexjoint.core.errors import FlexJointError
from flexjoint.recording.logs.log import Documented, Log, Signal, unreadable
from flexjoint.recording.messages import refusal, shown
from flexjoint.recording.table import check_size

KIND = "LeRobot dataset"
LARGEST_INFO = 10_000_000  # bytes
OPEN = "LeRobot leaves the unit to the robot's driver: degrees, radians or shares of the range"
MEANINGS = {
    "observation.state": Documented("q", None, OPEN),
    "action": Documented("q_ref", None, OPEN),
}
EPISODE, FRAME = "episode_index", "frame_index"


def folder_of(path: Path) -> Path | None:
    """The dataset that a folder, or a Parquet file in it, belongs to; None of any other."""
    for folder in (path, *path.absolute().parents[:4]):
        if (folder / "meta" / "info.json").is_file():
            return folder
    return None


def read(path: Path, episode: int | None = None) -> Log:
    """A log of one episode; RecordingError says what is wrong with the dataset, or which episodes it has."""
    folder = folder_of(path)
    if folder is None:
        raise refusal(path, "has no meta/info.json; give the folder of a LeRobot dataset")
    info = _info(folder / "meta" / "info.json")
    files = sorted((folder / "data").rglob("*.parquet")) if path.is_dir() else [path]
    if not files:
        raise refusal(path, "has no Parquet file under data; download the dataset with its data")
    try:
        table = _episode(files, info, episode, path)
    except FlexJointError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise unreadable(str(path), KIND, error) from None
    features = info.get("features")
    signals = dict(_signals(table, features if isinstance(features, Mapping) else {}))
    fps = info.get("fps")
    rate = float(fps) if isinstance(fps, int | float) and fps > 0 else None
    if FRAME in table.column_names and rate is not None:
        frames = table.column(FRAME).to_numpy()
        signals["frame_index / fps"] = Signal((np.asarray(frames, dtype=float) / rate)[:, np.newaxis])
        clock: str | None = "frame_index / fps"
    else:
        clock = "timestamp" if "timestamp" in signals else None
    return Log(str(path), KIND, signals, MEANINGS, time=clock, time_unit="s", rate=rate)


def _info(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_INFO:
            raise refusal(path, f"more than {LARGEST_INFO} bytes; expected a short description")
        info = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise unreadable(str(path), KIND, error) from None
    if not isinstance(info, dict):
        raise refusal(path, f"expected a JSON object, got {type(info).__name__}")
    return info


def _episode(files: list[Path], info: Mapping[str, Any], episode: int | None, path: Path) -> pa.Table:
    """The rows of one episode, in order."""
    parts = []
    for file in files:
        with pa.parquet.ParquetFile(file) as opened:
            check_size(opened.metadata.num_rows, opened.metadata.num_columns, path)
            names = opened.schema_arrow.names
            if EPISODE not in names:
                raise refusal(file, f"has no column {EPISODE}, as expected of a LeRobot dataset")
            rows = opened.read([EPISODE]).column(EPISODE).to_numpy()
            there = np.unique(rows)
            if episode is None and len(files) == 1 and there.size == 1:
                episode = int(there[0])
            if episode is None:
                count = info.get("total_episodes", "several")
                raise refusal(path, f"has {count} episodes; choose one with --episode NUMBER")
            if episode in there:
                parts.append(opened.read().filter(pa.array(rows == episode)))
    if not parts:
        raise refusal(
            path, f"has no episode {episode}; it has {info.get('total_episodes', 'others')}, from 0 on"
        )
    table = pa.concat_tables(parts)
    return table.sort_by(FRAME) if FRAME in table.column_names else table


def _signals(table: pa.Table, features: Mapping[str, Any]) -> Iterator[tuple[str, Signal]]:
    for name in table.column_names:
        column = table.column(name).combine_chunks()
        kind = column.type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            values = np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False))[:, np.newaxis]
            yield name, Signal(values, (name,))
        elif (pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind)) and _numeric(kind.value_type):
            rows = column.to_pylist()
            if len({len(row) for row in rows if row is not None}) == 1 and None not in rows:
                values = np.array(rows, dtype=float)
                yield name, Signal(values, (), _names(features.get(name), values.shape[1]))


def _numeric(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _names(feature: Any, count: int) -> tuple[str, ...]:
    """Names of joints of a feature: a list, or a list under a key as `motors`; `elbow.pos` is the joint"
    " elbow."""
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping) and len(names) == 1:
        (names,) = names.values()
    if not isinstance(names, list) or len(names) != count or not all(isinstance(n, str) for n in names):
        return ()
    return tuple(shown(name.removesuffix(".pos")) for name in names)
