"""Limits of a robot that poses at rest break: which joint, which poses, by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import ModelError
from flexjoint.model.dynamics import FlexibleJointModel

ROUND_OFF = 1e-12


@dataclass(frozen=True)
class Violation:
    """One limit of one joint that some poses break.

    kind: `motor torque` (beyond torque_limit), `reachable torque` (command effects such as a saturation give
    less than is needed), `deflection` (beyond max_deflection) or `joint range` (beyond the URDF's limits).
    poses (k,) are the rows concerned, counted from 0; values and excess (k,) what was needed there and by how
    much that is too much, both in `unit`.
    """

    kind: str
    joint: str
    poses: np.ndarray
    values: np.ndarray
    excess: np.ndarray
    unit: str

    @property
    def worst(self) -> int:
        """The pose that is furthest beyond."""
        return int(self.poses[np.argmax(self.excess)])

    def __str__(self) -> str:
        k = int(np.argmax(self.excess))
        others = f"; {len(self.poses)} poses in all" if len(self.poses) > 1 else ""
        return (
            f"{self.kind} of {self.joint}: pose {self.poses[k]} needs {self.values[k]:.5g} {self.unit},"
            f" {self.excess[k]:.3g} {self.unit} too much{others}"
        )


def beyond(kind: str, joint: str, values: np.ndarray, low: float, high: float, unit: str) -> list[Violation]:
    """The violation of low <= values (N,) <= high; empty where there is none."""
    excess = np.maximum(values - high, low - values)
    poses = np.flatnonzero(excess > ROUND_OFF * (1.0 + np.abs(values)))
    return [Violation(kind, joint, poses, values[poses], excess[poses], unit)] if poses.size else []


def checked_deflections(model: FlexibleJointModel, given: Mapping[str, float]) -> dict[str, float]:
    """The largest deflections by joint; raises UnknownNameError or ModelError."""
    for name, limit in given.items():
        model.robot.joint(name)
        if not limit > 0.0:
            raise ModelError(f"max_deflection of {name}: expected a number > 0 [rad], got {limit}")
    return dict(given)
