"""Small robots for the tests of the model and its simulation, built from text."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from flexjoint.effects import Planned, catalogue
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build

_LINK = (
    '<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
    '<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>'
)
_JOINT = (
    '<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
    '<origin xyz="{origin}"/><axis xyz="{axis}"/></joint>'
)

# (joint, axis, place in the parent, centre of mass, mass, inertia): arms that hang at q = 0
PENDULUM = [("joint", "1 0 0", "0 0 0.8", "0 0 -0.26", 2.4, 0.05)]
PLANAR = [
    ("hip", "0 1 0", "0 0 1", "0.01 0 -0.2", 3.2, 0.06),
    ("knee", "0 1 0", "0 0 -0.4", "0 0 -0.17", 1.5, 0.025),
]
SPATIAL = [
    ("yaw", "0 0 1", "0 0 0.4", "0 0.01 0.08", 2.5, 0.02),
    ("roll", "1 0 0", "0 0 0.15", "0 0 -0.18", 1.9, 0.04),
    ("pitch", "0 1 0", "0 0 -0.38", "0.01 0 -0.14", 0.9, 0.012),
]
DRIVES: dict[str, dict[str, float]] = {
    "joint": {"stiffness": 340, "damping": 0.9, "motor_inertia": 0.12, "motor_damping": 4, "torque_limit": 45,
              "kp": 1100, "kd": 12},
    "hip": {"stiffness": 800, "damping": 1.6, "motor_inertia": 0.24, "motor_damping": 12, "torque_limit": 110,
            "kp": 2600, "kd": 30},
    "knee": {"stiffness": 420, "damping": 1.0, "motor_inertia": 0.13, "motor_damping": 8, "torque_limit": 60,
             "kp": 1500, "kd": 15},
    "yaw": {"stiffness": 500, "damping": 1.1, "motor_inertia": 0.15, "motor_damping": 8, "torque_limit": 60,
            "kp": 1700, "kd": 18},
    "roll": {"stiffness": 480, "damping": 1.0, "motor_inertia": 0.14, "motor_damping": 7, "torque_limit": 60,
             "kp": 1600, "kd": 17},
    "pitch": {"stiffness": 210, "damping": 0.5, "motor_inertia": 0.07, "motor_damping": 5, "torque_limit": 28,
              "kp": 800, "kd": 8},
}  # fmt: skip
WORDS: dict[str, dict[str, Any]] = {
    "base_tilt": {"roll": 0.1, "pitch": -0.2},
    "payload": {"mass": 0.5, "position": (0.1, 0.05, -0.1)},
    "rough_spot": {"position": 0.4, "width": 0.2},
    "end_stop": {"position": 0.2, "stiffness": 500.0},
    "torque_saturation": {"limit": 9.0},
    "torque_speed_limit": {"stall": 12.0},
}


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="arms")  # gone when the tests end


def make(links: list[tuple[Any, ...]], changes: dict[str, dict[str, Any]] | None = None, **top: Any) -> Robot:
    """A robot of these links; `changes` edits a joint's entry (None: passive), `top` the file's top level."""
    parts, parent = ['<robot name="arm"><link name="base"/>'], "base"
    if top.get("base") == "floating":
        body = _LINK.format(name="trunk", com="0 0 0.05", mass=4.0, i=0.1)
        parts, parent = [f'<robot name="arm">{body}'], "trunk"
    for name, axis, origin, com, mass, inertia in links:
        parts.append(_LINK.format(name=f"{name}_link", com=com, mass=mass, i=inertia))
        parts.append(_JOINT.format(name=name, parent=parent, child=f"{name}_link", origin=origin, axis=axis))
        parent = f"{name}_link"
    text = "".join(parts) + "</robot>"
    folder = Path(_temporary().name)
    urdf = folder / f"{crc32(text.encode())}.urdf"
    urdf.write_text(text, encoding="utf-8")
    joints = {}
    for name, *_ in links:
        edit = (changes or {}).get(name, {})
        if edit is not None:
            joints[name] = {**DRIVES[name], **edit}
    file = {"name": "arm", "urdf": str(urdf), "joints": joints, **top}
    return build(robot_schema.parse(file, "arm"), folder / "arm.yaml")


def one_of_each(joint: str) -> list[Planned]:
    """Every effect of the catalogue that a joint with a spring can have, once, on the joint or the whole
    robot, at sizes that matter."""
    out = []
    for name, effect in catalogue().items():
        if effect.for_rigid:
            continue
        values = {p.name: p.value for p in effect.params if p.size == 1}
        out.append(Planned.of(name, None if effect.whole_robot else joint, {**values, **WORDS.get(name, {})}))
    return out


def waves(n: int, steps: int, rate: float, size: float = 6.0) -> np.ndarray:
    """(steps, n) smooth torques that differ between joints."""
    t = np.arange(steps)[:, None] / rate
    k = np.arange(n)
    return size * np.sin(2 * np.pi * (1.1 + 0.7 * k) * t + 0.4 * k) / (1.0 + k)
