"""`flexjoint diagnose` on stamps as real loggers leave them: once each a traceback."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from planting import FULL, ROBOTS, plant
from support.diagnose_cases import as_recording
from support.thorough import thorough

from flexjoint.cli.main import main
from flexjoint.recording.table import Recording, write

SECONDS, PIECES = 40.0, 10


@cache
def measured() -> Recording:
    """A healthy lever, 40 s at 500 Hz."""
    return as_recording(plant(ROBOTS / "lever.yaml", [], "rich", SECONDS, 5, FULL))


def joined() -> np.ndarray:
    """Ten pieces whose stamps go on 0.3 ms after the piece before: two torques within a tick of 1 ms."""
    time = measured().time.copy()
    for begin in np.linspace(0, time.size, PIECES + 1).astype(int)[1:-1]:
        time[begin:] -= 0.0017
    return time


def restarted() -> np.ndarray:
    """Ten pieces that each begin at 0."""
    time = measured().time.copy()
    edges = np.linspace(0, time.size, PIECES + 1).astype(int)
    for begin, end in itertools.pairwise(edges):
        time[begin:end] -= time[begin]
    return time


def doubled() -> np.ndarray:
    time = measured().time.copy()
    rows = np.arange(100, time.size, 400)
    time[rows] = time[rows - 1]
    return time


def paused() -> np.ndarray:
    time = measured().time.copy()
    time[time.size // 2 :] += 1e5
    return time


def early() -> np.ndarray:
    time = measured().time.copy()
    time[5000] -= 0.0015
    return time


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (joined, "another phase from 9 rows (the first is row 2001): 10 pieces are put one after the other"),
        pytest.param(
            restarted,
            "steps back in 9 rows (the first is row 2001): 10 pieces are put one after the other",
            marks=thorough,
        ),
        pytest.param(
            doubled, "50 rows left out whose time stamp is early, late or that of a neighbour", marks=thorough
        ),
        pytest.param(early, "1 row left out whose time stamp is early", marks=thorough),
        pytest.param(paused, "shortened to 1 s each", marks=thorough),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_stamps_of_a_logger_are_repaired_with_a_note(
    tmp_path: Path, stamps: Callable[[], np.ndarray], said: str
) -> None:
    path, out = tmp_path / "rec.parquet", tmp_path / "out.json"
    write(Recording(stamps(), measured().columns), path)
    robot = str(ROBOTS / "lever.yaml")
    arguments = ["diagnose", str(path), "--robot", robot, "--json", str(out), "--quiet", "--no-refine"]
    assert main(arguments) == 0
    diagnosis = json.loads(out.read_text())
    assert diagnosis["verdict"] == "healthy", diagnosis["reason"]
    assert any(said in note for note in diagnosis["notes"]), diagnosis["notes"]
