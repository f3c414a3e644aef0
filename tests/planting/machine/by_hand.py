"""The lever's equations written out by hand, for comparison with the general ones."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..robots import ROBOTS, read_robot
from .laws import Equations
from .machine import Machine

LEVER = ROBOTS / "lever.yaml"
JOINT = "swing"


def lever_gravity(q: np.ndarray | float, roll: float = 0.0) -> np.ndarray | float:
    """Torque that holds the lever at q [N m]; it turns about y, so that z' = -(x cos q + z sin q) q'."""
    body = read_robot(LEVER).bodies[0]
    x, _, z = body.com
    return -body.mass * 9.81 * np.cos(roll) * (x * np.cos(q) + z * np.sin(q))


def lever_inertia() -> float:
    """Inertia of the link about its joint [kg m^2]."""
    body = read_robot(LEVER).bodies[0]
    x, _, z = body.com
    return float(body.inertia[1, 1] + body.mass * (x * x + z * z))


def rate_of(robot, effects, x, u, modes=(), t=0.0, gates=None):
    """x' and tau_t at a state."""
    e = Equations(robot, effects)
    function = ca.Function("rate", [e.x, e.u, e.modes, e.gates, e.t], [e.rate, e.torque])
    gates = np.ones(len(effects)) if gates is None else gates
    rate, torque = function(x, u, np.array(modes, dtype=float), gates, t)
    return np.array(rate).ravel(), np.array(torque).ravel()


def lever_state(q=0.3, dq=0.4, theta=0.33, dtheta=0.9, z=0.0):
    return np.array([q, dq, theta, dtheta, z])


def lever(*effects, modes=(), t=0.0, u=7.0, gates=None, **state):
    """What acts on the lever beside the nominal: torque on its link, on its motor; and its tau_t and dz."""
    robot = read_robot(LEVER)
    x = lever_state(**state)
    rate, torque = rate_of(robot, list(effects), x, np.array([u]), modes, t, gates)
    link = lever_inertia() * rate[1] + lever_gravity(x[0]) - torque[0]
    motor = robot.motor_inertia[0] * rate[3] - (u - torque[0] - robot.motor_damping[0] * x[3])
    return link, motor, torque[0], rate[4]


def spring(phi=0.03, dphi=0.5):
    robot = read_robot(LEVER)
    return robot.stiffness[0] * phi + robot.damping[0] * dphi


def run(robot, effects, x, u, seconds, step=2e-4):
    """States (steps + 1, 5 n) under constant torque."""
    machine = Machine(robot, effects, step, 5)
    machine.x[: len(x)] = x
    gates = np.ones((5, len(effects)))
    torque = np.tile(np.asarray(u, dtype=float), (5, 1))
    machine.settle(torque[0], gates[0], 0.0)
    states = [machine.x[None].copy()]
    for k in range(round(seconds / (5 * step))):
        states.append(machine.advance(torque, gates, 5 * k * step)[0])
    assert machine.unfinished_events == 0
    return np.concatenate(states)
