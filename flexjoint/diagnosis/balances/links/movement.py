"""Movements of links about the motion along which balances are evaluated, and the torques that these take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.effects import Drive


@dataclass(frozen=True)
class Movement:
    """dq, dq' and dq'' (N,) of a link."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True)
class Numbers:
    """The numbers of the robot on which links move: actuators by joint, what the mass matrix (n, n) is more
    than the nominal one, in the mean posture, and the scales of the motors' balances by joint."""

    drives: tuple[Drive, ...]
    heavier: np.ndarray | None = None  # nothing
    scales: tuple[float, ...] = ()  # 1 each

    def scale(self, joint: int) -> float:
        return self.scales[joint] if self.scales else 1.0


def torque(motion: Motion, joint: int, i: int, movement: Movement, numbers: Numbers) -> np.ndarray:
    """(N,) what a movement of link i takes, to first order, in the balance that carries a joint's load."""
    rigid = motion.rigid
    scale = numbers.scale(joint) if motion.robot.joints[joint].rigid else 1.0
    mass = rigid.mass[:, joint, i] + (0.0 if numbers.heavier is None else numbers.heavier[joint, i])
    load = mass * movement.a + rigid.by_v[:, joint, i] * movement.v + rigid.by_q[:, joint, i] * movement.q
    return np.asarray(scale * load)


def pull(drive: Drive, movement: Movement) -> np.ndarray:
    """(N,) the torque by which a link's spring resists its movement, and pulls at its motor."""
    return np.asarray(drive.K * movement.q + drive.D * movement.v)


def add(by_row: dict[int, np.ndarray], row: int, series: np.ndarray) -> None:
    """Add a series (N,) to that of a row, in place."""
    by_row[row] = by_row[row] + series if row in by_row else series
