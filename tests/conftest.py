"""Fixtures of the tests of the command line."""

from __future__ import annotations

from pathlib import Path

import fake_diagnosis
import pytest

from flexjoint import recording
from flexjoint.robot import Robot


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """A robot of two joints, its YAML and URDF in the test's folder."""
    return fake_diagnosis.arm(tmp_path)


@pytest.fixture
def monday(tmp_path: Path) -> Path:
    """A good recording of that robot."""
    path = tmp_path / "monday.csv"
    recording.write(fake_diagnosis.signals(seconds=4.0), path)
    return path
