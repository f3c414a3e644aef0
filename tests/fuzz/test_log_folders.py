"""Logs of messages and data sets, bytes of one of their files changed: refused in words, or read."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from fuzz.hostile import fuzz, mutated, only_refusals
from hypothesis import given
from hypothesis import strategies as st
from recording.formats import test_lerobot, test_ros
from recording.formats.test_howto import of_bag, of_mcap, of_pace
from support.logs import JOINTS

from flexjoint.recording.importing import import_log
from flexjoint.recording.logs import mapping

MAPPING = {"joints": list(JOINTS), "angles": "deg"}
FORMATS = ("mcap", "ros 1", "SQLITE3", "MCAP", "lerobot 2", "lerobot 3", "pace")


def written(kind: str, folder: Path) -> Path:
    """A good log of a kind in a folder: its path, which may be a folder's."""
    if kind.startswith("lerobot"):
        return test_lerobot.dataset(folder / "set", int(kind[-1]), list(JOINTS))
    if kind in ("SQLITE3", "MCAP"):
        test_ros.test_a_bag_of_ros_2(folder, kind)  # writes it
        return folder / "bag"
    return {"mcap": of_mcap, "ros 1": of_bag, "pace": of_pace}[kind](folder)


@pytest.fixture(scope="module", params=FORMATS)
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(request.param, tmp_path_factory.mktemp("log"))


def read(path: Path) -> None:
    said = {**MAPPING, "episode": 1} if path.name == "set" else MAPPING
    recording = import_log(path, mapping.parse(said)).recording
    assert np.all(np.diff(recording.time) > 0.0)


@fuzz(15)
@given(data=st.data())
def test_a_log_of_messages_or_a_data_set(
    log: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    place = tmp_path_factory.getbasetemp() / "changed" / log.name
    shutil.rmtree(place.parent, ignore_errors=True)
    place.parent.mkdir()
    (shutil.copytree if log.is_dir() else shutil.copy)(log, place)
    files = sorted(p for p in place.rglob("*") if p.is_file()) or [place]
    changed = data.draw(st.sampled_from(files))
    changed.write_bytes(data.draw(mutated(changed.read_bytes())))
    with only_refusals():
        read(place)


def test_what_was_changed_was_good(log: Path) -> None:
    read(log)
