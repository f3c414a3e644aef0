"""A folder of logs stands for the logs in it; one that is a log itself stays one."""

from __future__ import annotations

from pathlib import Path

import pytest

from flexjoint.core.errors import RecordingError
from flexjoint.recording.importing import logs_in


def test_a_folder_stands_for_its_logs_by_name(tmp_path: Path) -> None:
    for name in ("b.csv", "a.parquet", "notes.txt.md", "c.PARQUET"):
        (tmp_path / name).touch()
    (tmp_path / "older").mkdir()
    assert [path.name for path in logs_in(tmp_path)] == ["a.parquet", "b.csv", "c.PARQUET"]
    assert logs_in(tmp_path / "b.csv") == (tmp_path / "b.csv",)
    with pytest.raises(RecordingError, match="folder without a log"):
        logs_in(tmp_path / "older")
    assert logs_in(tmp_path / "none") == (tmp_path / "none",)  # who reads it says that it is not there


def test_a_bag_is_one_log(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / "part.mcap").touch()
    assert logs_in(tmp_path) == (tmp_path,)
