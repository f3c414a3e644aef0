"""LeRobot datasets: two that lerobot itself wrote, and small ones after the layout of info.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from support.logs import JOINTS, assert_is, motion

from flexjoint.core.errors import RecordingError
from flexjoint.core.text import plain
from flexjoint.recording.importing import import_log, open_log, read
from flexjoint.recording.logs import mapping

M = motion(3.0, 60.0)
DEGREES = mapping.parse({"angles": "deg", "episode": 1})
WRITTEN = Path(__file__).parent / "written"
ARM = ("shoulder_pan", "shoulder_lift", "elbow_flex")


def test_datasets_that_lerobot_itself_wrote() -> None:
    """written/README.md says what was put in, as float32: 40 deg are kept to 4e-6 deg."""
    for folder in ("lerobot_v2.1", "lerobot_v3.0"):
        for episode, frames in enumerate((60, 80)):
            got = import_log(WRITTEN / folder, mapping.parse({"angles": "deg", "episode": episode}))
            recording = got.recording
            assert recording.joints == ARM and recording.period == pytest.approx(0.02)
            assert recording.time == pytest.approx(np.arange(frames) / 50, abs=1e-12)
            for j, joint in enumerate(ARM):
                sent = 40.0 * np.sin((2.0 + j) * recording.time + j + episode)
                assert recording.get("q", joint) == pytest.approx(np.radians(sent), abs=1e-7)
                assert recording.get("q_ref", joint) == pytest.approx(np.radians(sent + 1.0), abs=1e-7)
        with pytest.raises(RecordingError, match="has 2 episodes; choose one with --episode NUMBER"):
            import_log(WRITTEN / folder)
        with pytest.raises(RecordingError, match=r"q \(observation.state\) reaches 40: degrees, or radians"):
            import_log(WRITTEN / folder, mapping.parse({"episode": 0}))


def test_one_episode_of_lerobot_by_its_own_file() -> None:
    path = WRITTEN / "lerobot_v2.1" / "data" / "chunk-000" / "episode_000001.parquet"
    recording = read(path, mapping.parse({"angles": "deg"})).recording
    sent = 40.0 * np.sin(4.0 * recording.time + 3.0)
    assert recording.get("q", "elbow_flex") == pytest.approx(np.radians(sent), abs=1e-7)


def dataset(folder: Path, version: int, names: Any) -> Path:
    """Two episodes, the second one the motion in degrees."""
    feature = {"dtype": "float32", "shape": [2], "names": names}
    info = {"codebase_version": f"v{version}.0", "fps": 60, "total_episodes": 2,
            "features": {"observation.state": feature, "action": feature}}  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for episode, q in enumerate((0.0 * M.q, np.degrees(M.q))):
        count = len(q)
        tables.append(
            pa.table(
                {
                    "observation.state": pa.array(q.tolist(), pa.list_(pa.float64(), 2)),
                    "action": pa.array((q + 1.0).tolist(), pa.list_(pa.float64())),
                    "timestamp": pa.array(np.float32(np.arange(count) / 60)),
                    "frame_index": np.arange(count),
                    "episode_index": np.full(count, episode),
                }
            )
        )
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if version == 2:
        for episode, table in enumerate(tables):
            pa.parquet.write_table(table, data / f"episode_{episode:06d}.parquet")
    else:
        pa.parquet.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    return folder


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("names", [[f"{name}.pos" for name in JOINTS], {"motors": list(JOINTS)}])
def test_one_episode_of_a_dataset(tmp_path: Path, version: int, names: Any) -> None:
    folder = dataset(tmp_path / "set", version, names)
    got = import_log(folder, DEGREES)
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "q_ref", np.radians(np.degrees(M.q) + 1.0))
    assert got.recording.time == pytest.approx(M.time, abs=1e-12)
    assert "LeRobot dataset" in plain(got.account)


def test_a_single_episode_by_its_own_file(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "set", 2, list(JOINTS))
    path = folder / "data" / "chunk-000" / "episode_000001.parquet"
    assert_is(read(path, mapping.parse({"angles": "deg"})).recording, "q", M.q)
    with pytest.raises(RecordingError, match=r"reaches 51.*Give --degrees or --radians"):
        read(path)


def test_what_a_dataset_leaves_open_is_asked_for(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "set", 3, None)
    with pytest.raises(RecordingError, match=r"has 2 episodes; choose one with --episode NUMBER"):
        import_log(folder)
    with pytest.raises(RecordingError, match="has no episode 7; it has 2, from 0 on"):
        open_log(folder, 7)
    with pytest.raises(RecordingError, match="does not say of which joints"):
        import_log(folder, DEGREES)
    (folder / "meta" / "info.json").write_text("[1")
    with pytest.raises(RecordingError, match="cannot be read as LeRobot dataset"):
        open_log(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(
        RecordingError, match=r"is a folder, expected a bag of ROS 2 .metadata.yaml. or a LeRobot"
    ):
        open_log(tmp_path / "empty")
