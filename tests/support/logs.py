"""A motion of two joints as other programs log it, and whether a recording is that motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from flexjoint.recording.table import Recording

JOINTS = ("shoulder", "elbow")
RATE = 250.0  # Hz


@dataclass(frozen=True)
class Motion:
    """time (N,) [s]; q, dq, tau (N, 2) [rad, rad/s, N m], as seen from the link."""

    time: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray


def motion(seconds: float = 2.0, rate: float = RATE) -> Motion:
    """Smooth, within one turn, with torques of both signs."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    speeds, phases = np.array([2.1, 5.3]), np.array([0.0, 1.0])
    angle = speeds * time[:, np.newaxis] + phases
    q = np.array([0.9, 0.5]) * np.sin(angle)
    dq = np.array([0.9, 0.5]) * speeds * np.cos(angle)
    return Motion(time, q, dq, 4.0 * np.sin(q) + 0.5 * dq)


def assert_is(recording: Recording, channel: str, expected: np.ndarray, rel: float = 1e-9) -> None:
    """That a channel of both joints is (N, 2) as expected."""
    for k, joint in enumerate(JOINTS):
        assert recording.get(channel, joint) == pytest.approx(expected[:, k], rel=rel, abs=rel)


def write_csv(path: Path, columns: dict[str, np.ndarray], delimiter: str = ",", comma: bool = False) -> Path:
    """A text file of columns with a line of names."""
    rows = [delimiter.join(columns)]
    for row in zip(*columns.values(), strict=True):
        line = delimiter.join(repr(float(value)) for value in row)
        rows.append(line.replace(".", ",") if comma else line)
    path.write_text("\n".join(rows) + "\n")
    return path
