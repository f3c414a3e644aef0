"""Random trees of bodies: revolute and prismatic joints about any axis, flexible, rigid and passive ones."""

from __future__ import annotations

import math
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.robot.robot import Robot, build
from flexjoint.robot.schema import parse


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="trees")  # gone when the tests end


def random_tree(seed: int) -> Robot:
    """Two to eight joints without damping and gravity; even seeds float. Masses over two decades, stiffness
    over four."""
    rng = np.random.default_rng(seed)
    floating = seed % 2 == 0
    parts = [f'<robot name="tree{seed}">', _link("l0", rng) if floating else '<link name="l0"/>']
    joints: dict[str, Any] = {}
    count = int(rng.integers(2, 9))
    for k in range(1, count + 1):
        parent = int(rng.integers(max(0, k - 3), k))
        turns, axis, place = rng.random() < 0.85, rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
        axis /= np.linalg.norm(axis)
        kind = "continuous" if turns else "prismatic"
        limit = "" if turns else '<limit lower="-100" upper="100" effort="1e4" velocity="1e3"/>'
        parts += [
            _link(f"l{k}", rng),
            f'<joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>',
            f'<origin xyz="{_words(place)}"/><axis xyz="{_words(axis)}"/>{limit}</joint>',
        ]
        kind_of_drive = rng.random()
        if kind_of_drive < 0.1 and k < count:
            continue  # passive
        rigid = kind_of_drive < 0.2 and k < count
        joints[f"j{k}"] = {
            "stiffness": math.inf if rigid else 10.0 ** rng.uniform(2.0, 6.0),
            "damping": 0.0,
            "motor_inertia": 10.0 ** rng.uniform(-2.0, 0.5),
            "motor_damping": 0.0,
        }
    path = Path(_folder().name) / f"{seed}.urdf"
    path.write_text("".join(parts) + "</robot>", encoding="utf-8")
    file: dict[str, Any] = {"name": "tree", "urdf": str(path), "joints": joints, "gravity": [0, 0, 0]}
    if floating:
        file["base"] = "floating"
    return build(parse(file, "tree"), path.with_suffix(".yaml"))


def _link(name: str, rng: np.random.Generator) -> str:
    mass, length = 10.0 ** rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-1.3, -0.3)
    inertia = np.sort(mass * length**2 * rng.uniform(0.1, 0.4, 3))
    inertia[2] = min(inertia[2], inertia[0] + inertia[1])
    turned, centre = rng.uniform(-1.0, 1.0, 3), rng.uniform(-length, length, 3)
    return (
        f'<link name="{name}"><inertial><origin xyz="{_words(centre)}" rpy="{_words(turned)}"/>'
        f'<mass value="{mass}"/><inertia ixx="{inertia[0]}" iyy="{inertia[1]}" izz="{inertia[2]}" ixy="0"'
        ' ixz="0" iyz="0"/></inertial></link>'
    )


def _words(values: np.ndarray) -> str:
    return " ".join(str(float(value)) for value in values)
