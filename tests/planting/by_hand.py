"""The lever's equations written out by hand, for comparison with the general ones."""

from __future__ import annotations

import numpy as np

from .robots import ROBOTS, read_robot

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
