"""Variants of the nominal robots as real ones are described: joints that are taken for rigid, numbers that
are trusted to some per cent.

`dirty_crane_rigid_5` is the crane with rigid joints, its numbers known to 5 %; `flexible` keeps the springs,
`mixed` those of the inner half of the joints.
"""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import yaml

from ..machine.chain import body_load, mass_matrix, read_bodies

NAME = re.compile(r"dirty_(.+)_(flexible|mixed|rigid)_(\d+)")
DAMPING = 3.0  # times less is known of damping than of the other numbers
TORQUE = 0.02  # share of a joint's torque below which a cause does not matter to its owner
DAMPED = 0.7  # damping ratio of a rigid joint under its controller


def base_of(name: str) -> str:
    """The robot that a dirty one is a variant of; raises ValueError for other names."""
    return _parts(name)[0]


def _parts(name: str) -> tuple[str, str, int]:
    match = NAME.fullmatch(name)
    if match is None:
        raise ValueError(
            f"{name!r} is no dirty robot; such are dirty_crane_rigid_5, dirty_drawn_12_of6_mixed_10"
        )
    return match[1], match[2], int(match[3])


def dirty_robot(name: str, base: Path) -> Path:
    """YAML file of a variant of the robot whose file is `base`, its URDF beside it."""
    _, kind, percent = _parts(name)
    path = _folder() / f"{name}.yaml"
    if not path.exists():
        data = yaml.safe_load(base.read_text())
        urdf = base.parent / data["urdf"]
        shutil.copyfile(urdf, path.with_suffix(".urdf"))
        bodies = read_bodies(urdf)
        inner = {"flexible": len(bodies), "mixed": (len(bodies) + 1) // 2, "rigid": 0}[kind]
        inertia = _inertia(bodies)
        for k, body in enumerate(bodies):
            if k >= inner:
                _stiffen(data["joints"][body.joint], inertia[k])
        known = percent / 100
        tolerance = {"inertial": known, "stiffness": known, "damping": DAMPING * known, "torque": TORQUE}
        path.write_text(
            yaml.safe_dump(
                {**data, "name": name, "urdf": f"{name}.urdf", "tolerance": tolerance}, sort_keys=False
            )
        )
    return path


def _stiffen(joint: dict[str, float], inertia: float) -> None:
    """Make a joint rigid; its controller then moves the link's inertia [kg m^2] as well."""
    joint["stiffness"], joint["damping"] = float("inf"), 0.0
    joint["kd"] = float(2 * DAMPED * np.sqrt(joint["kp"] * (joint["motor_inertia"] + inertia)))


def _inertia(bodies: list) -> np.ndarray:
    """(n,) inertia about every joint at q = 0 [kg m^2]."""
    q = ca.SX.sym("q", len(bodies))
    matrix = ca.Function("m", [q], [mass_matrix(bodies, [body_load(b) for b in bodies], q)])
    return np.diag(np.array(matrix(np.zeros(len(bodies)))))


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="dirty_robots_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
