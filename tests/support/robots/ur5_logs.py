"""Logs of the UR5 of example-robot-data with rigid joints: a motion, and the torques that it takes by the
dynamics of the planting, which shares no code with the package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from planting.machine.chain import Array, Body, body_load, inverse_dynamics, read_bodies

from flexjoint.recording.table import Recording, make
from flexjoint.robot.robot import Robot, load
from support.robots.example_robots import example_robot_data

URDF = "robots/ur_description/urdf/ur5_robot.urdf"
PAN, LIFT, ELBOW, WRIST_1, WRIST_2, WRIST_3 = NAMES = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
ROTOR = 0.2  # kg m^2 at the joint
CENTRE = np.array([0.0, -1.2, 1.2, -0.6, 0.5, 0.0])  # rad: an arm stretched forward
SECONDS, RATE = 10.0, 250.0
POSITION_NOISE, TORQUE_NOISE = 2e-5, 0.02  # rad; share of a joint's torque


@cache
def ur5(gear: float | None = None, constant: float | None = None) -> Robot:
    return load(
        f"package://example-robot-data/{URDF}", motor_inertia=ROTOR, gear_ratio=gear, torque_constant=constant
    )


@cache
def log(
    seed: int = 3,
    friction: float = 0.5,
    channel: str = "tau_motor",
    mass: float = 0.0,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    size: float = 1.0,
) -> Recording:
    """10 s of a smooth motion of all joints. `friction`: of Coulomb and, at 1 rad/s, viscous kind, as a share
    of the joint's torque. `mass` [kg] hangs at a place of the last link [m]. `size` scales
    the motion."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(SECONDS * RATE)) / RATE
    q, v, a = (np.zeros((time.size, len(NAMES))) for _ in range(3))
    q += CENTRE + rng.uniform(-0.3, 0.3, len(NAMES))
    for j in range(len(NAMES)):
        for w in 2.0 * np.pi * rng.uniform(0.08, 0.6, 5):
            swing, phase = size * rng.uniform(0.05, 0.25), rng.uniform(0.0, 2.0 * np.pi)
            q[:, j] += swing * np.sin(w * time + phase)
            v[:, j] += swing * w * np.cos(w * time + phase)
            a[:, j] -= swing * w**2 * np.sin(w * time + phase)
    tau = _dynamics(mass, place)(q, v, a) + ROTOR * a
    scale = np.maximum(np.sqrt(np.mean(tau**2, axis=0)), 0.5)
    tau += friction * scale * (np.tanh(v / 0.01) + v) + rng.normal(0.0, TORQUE_NOISE * scale, tau.shape)
    q += rng.normal(0.0, POSITION_NOISE, q.shape)
    columns = {("q", name): q[:, j] for j, name in enumerate(NAMES)}
    columns |= {(channel, name): tau[:, j] for j, name in enumerate(NAMES)}
    return make(time, columns, "ur5.parquet")


@cache
def _dynamics(mass: float, place: tuple[float, float, float]) -> Callable[[Array, Array, Array], Array]:
    bodies = read_bodies(example_robot_data() / "example-robot-data" / URDF)
    if mass > 0.0:
        bodies[-1] = _laden(bodies[-1], mass, np.array(place))
    assert tuple(body.joint for body in bodies) == NAMES
    q, v, a = (ca.SX.sym(name, len(NAMES)) for name in "qva")
    gravity = ca.SX(np.array([0.0, 0.0, -9.81]))
    tau = inverse_dynamics(bodies, [body_load(body) for body in bodies], gravity, q, v, a)
    function = ca.Function("tau", [q, v, a], [tau])
    return lambda q, v, a: np.array(function(q.T, v.T, a.T)).T


def _laden(body: Body, mass: float, place: Array) -> Body:
    """The body with a point mass fixed to it."""
    total = body.mass + mass
    centre = (body.mass * body.com + mass * place) / total
    inertia = body.inertia.copy()
    for part, at in ((body.mass, body.com), (mass, place)):
        d = at - centre
        inertia = inertia + part * (d @ d * np.eye(3) - np.outer(d, d))
    return replace(body, mass=total, com=centre, inertia=inertia)
