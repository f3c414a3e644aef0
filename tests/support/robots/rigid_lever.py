"""The lever of the planting with a rigid joint, as a file: an arm with motor encoder and current only."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from planting import ROBOTS


def rigid_lever(
    folder: Path,
    listed: Sequence[dict[str, Any]] = (),
    name: str = "lever_rigid",
    damping: float = 9.0,
    known: float = 0.1,
) -> Path:
    """Its robot file in a folder; `damping` [N m s/rad] of the motor, and the share to which that is `known`;
    `listed` are effects of the nominal model."""
    data = yaml.safe_load((ROBOTS / "lever.yaml").read_text())
    data["joints"]["swing"] |= {"stiffness": float("inf"), "damping": 0.0, "kp": 600.0, "kd": 30.0}
    data["joints"]["swing"]["motor_damping"] = damping
    data["tolerance"] = {"inertial": 0.02, "stiffness": 0.02, "damping": known, "torque": 0.01}
    data["effects"] = list(listed)
    shutil.copyfile(ROBOTS / "lever.urdf", folder / "lever.urdf")
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path
