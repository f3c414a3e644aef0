"""Models and random states that the tests of the rigid-body layer share."""

from __future__ import annotations

import importlib.metadata
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.rigidbody.numeric import PinBody
from flexjoint.rigidbody.symbolic import SymbolicBody

# Two orders of the same sums differ by round-off only: over 20 states of each model below, the largest
# difference measured is 1e-14 of the largest entry.
EXACT = 1e-12

URDFS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "talos": "talos_data/robots/talos_full_v2.urdf",
    "centauro": "centauro_description/urdf/centauro.urdf",
}
ONE_LINK = """<robot name="one"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
# a continuous joint about an axis of no frame: Python cannot make this joint type otherwise
SKEW_HINGE = """<robot name="skew"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.1 0.2 -0.3"/><mass value="1.5"/>
<inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="0.02" iyz="-0.03"/></inertial></link>
<joint name="skew" type="continuous"><origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/>
<parent link="base"/><child link="arm"/><axis xyz="1 2 3"/></joint></robot>"""


def random_placement(rng: np.random.Generator) -> pin.SE3:
    return pin.exp6(rng.normal(size=6))


def random_inertia(rng: np.random.Generator) -> pin.Inertia:
    """Of eight point masses: physical by construction."""
    mass, points = rng.uniform(0.1, 0.5, 8), 0.3 * rng.normal(size=(8, 3))
    center = mass @ points / mass.sum()
    about = points - center
    rotational = np.sum(mass[:, None, None] * [p @ p * np.eye(3) - np.outer(p, p) for p in about], axis=0)
    return pin.Inertia(mass.sum(), center, rotational)


def rrbot() -> pin.Model:
    """Two rods of 1 kg about +y, 0.9 m apart, centres of mass 0.45 m from their axes; upright at 0."""
    model = pin.Model()
    rod = pin.Inertia(1.0, np.array([0.0, 0.0, 0.45]), np.diag([1.01 / 12, 1.01 / 12, 0.02 / 12]))
    for name, height in (("joint1", 1.95), ("joint2", 0.9)):
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.1, height]))
        index = model.addJoint(model.njoints - 1, pin.JointModelRY(), placement, name)
        model.appendBodyToJoint(index, rod, pin.SE3.Identity())
        model.addJointFrame(index)
    return model


def every_joint() -> pin.Model:
    """A tree that holds each supported joint type once, with branches, general placements and armature."""
    rng = np.random.default_rng(5)
    model = pin.buildModelFromXML(SKEW_HINGE)
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    branches = [  # parent, type; joint 1 is the one of the URDF
        (1, pin.JointModelFreeFlyer()),
        (2, pin.JointModelRX()),
        (3, pin.JointModelRUBY()),
        (4, pin.JointModelSpherical()),
        (5, pin.JointModelPZ()),
        (3, pin.JointModelPlanar()),
        (7, pin.JointModelRevoluteUnaligned(axis)),
        (8, pin.JointModelTranslation()),
        (7, pin.JointModelRY()),
        (10, pin.JointModelPrismaticUnaligned(axis)),
        (2, pin.JointModelRUBX()),
        (12, pin.JointModelRZ()),
        (13, pin.JointModelPX()),
        (13, pin.JointModelPY()),
        (0, pin.JointModelRUBZ()),
    ]
    for parent, kind in branches:
        index = model.addJoint(parent, kind, random_placement(rng), kind.shortname())
        model.appendBodyToJoint(index, random_inertia(rng), random_placement(rng))
        model.addFrame(pin.Frame(f"tip{index}", index, random_placement(rng), pin.FrameType.OP_FRAME))
    model.armature = rng.uniform(0.05, 0.5, model.nv)
    return model


def mimicking() -> pin.Model:
    """A tree whose mimic joints follow a revolute, an unbounded, and a prismatic joint, ahead on the same
    branch or on another one; beside them joints that follow nothing."""
    rng = np.random.default_rng(6)
    model = pin.Model()
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    branches = [  # parent, type
        (0, pin.JointModelFreeFlyer()),
        (1, pin.JointModelRY()),
        (2, pin.JointModelRevoluteUnaligned(axis)),
        (3, pin.JointModelPX()),
        (1, pin.JointModelPrismaticUnaligned(axis)),
        (5, pin.JointModelRX()),
        (1, pin.JointModelRUBZ()),
        (7, pin.JointModelRZ()),
        (8, pin.JointModelRUBX()),
    ]
    for parent, kind in branches:
        index = model.addJoint(parent, kind, random_placement(rng), f"{kind.shortname()}{model.njoints}")
        model.appendBodyToJoint(index, random_inertia(rng), random_placement(rng))
        model.addJointFrame(index)
    for leader, follower, scale, offset in [(2, 3, -1.5, 0.2), (4, 5, 0.5, -0.1), (2, 6, 2.0, 0.0)]:
        model = pin.transformJointIntoMimic(model, leader, follower, scale, offset)
    model = pin.transformJointIntoMimic(model, 7, 9, 1.5, 0.4)
    model.armature = rng.uniform(0.05, 0.5, model.nv)
    return model


@cache
def robot(name: str) -> pin.Model:
    kind, _, base = name.partition("/")
    if kind == "mimicking":
        return mimicking()
    if kind == "one_link":
        return pin.buildModelFromXML(ONE_LINK)
    if kind == "rrbot":
        return rrbot()
    if kind == "every_joint":
        return every_joint()
    data = importlib.metadata.distribution("example-robot-data")
    path = Path(str(data.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / URDFS[kind]
    model = (
        pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
        if base == "floating"
        else pin.buildModelFromUrdf(str(path), mimic=base == "mimic")
    )
    model.armature = np.random.default_rng(0).uniform(0.0, 0.2, model.nv)
    return model


@cache
def symbolic(name: str) -> SymbolicBody:
    return SymbolicBody(robot(name))


ROBOTS = [
    "one_link",
    "rrbot",
    "ur5",
    "ur5/floating",
    "panda",
    "talos/floating",
    "centauro",
    "centauro/floating",
    "every_joint",
]
STATES = 3


def state(body: PinBody, seed: int) -> tuple[np.ndarray, ...]:
    """q, v, a or tau, and armature at random; rotations below half a turn."""
    rng = np.random.default_rng(seed)
    q = body.integrate(body.neutral, rng.uniform(-1.5, 1.5, body.nv))
    return q, *rng.normal(size=(2, body.nv)), rng.uniform(0.1, 1.0, body.nv)


def relative(got: ca.DM | np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest entry."""
    expected = np.asarray(expected)
    got = np.array(got).reshape(expected.shape)
    return float(np.max(np.abs(got - expected)) / max(np.max(np.abs(expected)), 1e-300))
