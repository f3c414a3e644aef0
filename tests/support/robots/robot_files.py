"""Files of a small robot, whole or with changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

BODY = '<inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'  # fmt: skip # noqa: E501
URDF = f"""<robot name="arm2">
<link name="base"/>
<link name="upper">{BODY.format(com="0 0 -0.2", mass=2)}</link>
<link name="lower">{BODY.format(com="0 0 -0.1", mass=1)}</link>
<link name="hand">{BODY.format(com="0 0 -0.05", mass=0.5)}</link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.4"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="35" velocity="9"/></joint>
<joint name="wrist" type="revolute"><parent link="lower"/><child link="hand"/><origin xyz="0 0 -0.3"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="35" velocity="9"/></joint>
</robot>"""
JOINT = {"stiffness": 260, "damping": 0.7, "motor_inertia": 0.09, "motor_damping": 6, "torque_limit": 35}
MJCF = """<mujoco model="arm2"><worldbody>
<body name="upper">{free}<joint name="shoulder" type="hinge" axis="0 1 0"/>
  <inertial pos="0 0 -0.2" mass="2" diaginertia="0.02 0.02 0.02"/>
  <body name="lower" pos="0 0 -0.4"><joint name="elbow" type="hinge" axis="0 1 0"/>
    <inertial pos="0 0 -0.1" mass="1.5" diaginertia="0.02 0.02 0.02"/></body></body>
</worldbody></mujoco>"""


def content(**changes: Any) -> dict[str, Any]:
    """A whole robot file; a key that is None is left out."""
    out = {"name": "arm2", "urdf": "arm2.urdf", "joints": {"shoulder": dict(JOINT), "elbow": dict(JOINT)}}
    out.update(changes)
    return {key: value for key, value in out.items() if value is not None}


def file(folder: Path, **changes: Any) -> Path:
    (folder / "arm2.urdf").write_text(URDF)
    path = folder / "arm2.yaml"
    path.write_text(yaml.safe_dump(content(**changes)))
    return path
