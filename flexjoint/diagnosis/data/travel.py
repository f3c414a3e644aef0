"""How far two columns say that a joint moved, span by span: what tells their signs and units apart from
offsets, noise and drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.recording.table import Recording

SPAN = 0.05  # s over which a position changes and a velocity is integrated
PERIODS = 4.0  # sampling periods that a span has at least
VELOCITIES = ("dq", "dtheta", "dtheta_ref")
LEAST = 10  # spans


@dataclass(frozen=True)
class Slope:
    """How far one column moves for what another moves, and how alike they are (correlation, with sign)."""

    slope: float
    alike: float


def slope(recording: Recording, joint: str, one: str, other: str) -> Slope | None:
    """Of the travel of `one` against that of `other`; None where either is absent or stands still."""
    if not (recording.has(one, joint) and recording.has(other, joint)):
        return None
    edges = np.arange(recording.time[0], recording.time[-1], max(SPAN, PERIODS * recording.period))
    if edges.size < LEAST + 1:
        return None
    y, x = (_travel(recording, channel, joint, edges) for channel in (one, other))
    spread_x, spread_y = float(np.sqrt(x @ x)), float(np.sqrt(y @ y))
    if spread_x == 0.0 or spread_y == 0.0:
        return None
    alike = float(x @ y) / (spread_x * spread_y)
    return Slope(float(np.copysign(spread_y / spread_x, alike)), alike)


def extent(recording: Recording, joint: str, channel: str) -> float:
    """The range of a position, without its rarest samples."""
    values = recording.get(channel, joint)
    return float(np.subtract(*np.nanpercentile(values, [99.5, 0.5])))


def _travel(recording: Recording, channel: str, joint: str, edges: np.ndarray) -> np.ndarray:
    """(M,) what a position changes, or a velocity adds up to, from edge to edge."""
    time, values = recording.time, recording.get(channel, joint)
    known = np.isfinite(values)
    t, x = time[known], values[known]
    if channel in VELOCITIES:
        x = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))])
    return np.diff(np.interp(edges, t, x))
