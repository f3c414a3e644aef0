"""Real causes that may stand behind a torque that does not follow: data are blamed only where they cannot.

A row may have an offset, a spring to any angle and a gain of up to three; and the robot may carry a load, a
point mass of up to its own mass, on any link within its reach; or a link lacks what its file says it has.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from flexjoint.diagnosis.data.change import View
from flexjoint.diagnosis.data.torques.follows import Balance, Row, limits_of
from flexjoint.robot.robot import Robot

STARTS = (0.1, 0.5)  # of the largest load; a lighter link is found from the first
LEAST_REACH = 0.3  # m


def explained_otherwise(balance: Balance, view: View, place: int, left: float) -> bool:
    """Whether a real cause explains a row of the data nearly as well as a change does, which leaves a share
    of its variance."""
    limits = balance.settings
    row = balance.row(balance.rows[place], view)
    if row is None:
        return False
    enough = limits.times_rival**2 * max(left, 1e-6)
    if balance.misfit(row, limits_of(limits.rival_gains), spring=True) <= enough:
        return True
    return any(misfit <= enough for misfit in _loaded(balance, view, place))


def reach(robot: Robot) -> float:
    """Sum of the distances between joints and of the last body's centre [m]: no part of it is farther."""
    model = robot.model
    steps = [float(np.linalg.norm(place.translation)) for place in list(model.jointPlacements)[2:]]
    centres = [float(np.linalg.norm(inertia.lever)) for inertia in list(model.inertias)[1:]]
    return sum(steps) + max(centres, default=0.0)


def _loaded(balance: Balance, view: View, place: int) -> list[float]:
    """Misfit of a row with the best load on each link that it carries."""
    model = balance.data.robot.model
    rows = [row for key in balance.rows if (row := balance.row(key, view)) is not None]
    at = [k for k, row in enumerate(rows) if row.key == balance.rows[place]]
    if not at or any(joint not in balance.data.robot.joint_names for joint in balance.data.joints):
        return []
    regressor = balance.body.regressor_batch(*balance.motion(view))
    heaviest = balance.settings.payload_mass * sum(inertia.mass for inertia in list(model.inertias)[1:])
    farthest = max(reach(balance.data.robot), LEAST_REACH)
    out = []
    for joint in balance.data.robot.joints:
        carried = regressor[:, :, 10 * (joint.pin_id - 1) : 10 * joint.pin_id]  # (M, nv, 10)
        added = [carried[:, balance.data.robot.joint(row.key[1]).idx_v] for row in rows]
        if np.max(np.abs(added[at[0]])) == 0.0:
            continue
        own = float(model.inertias[joint.pin_id].mass)
        load = _best_load(rows, added, (-own, heaviest), farthest)
        row = rows[at[0]]
        laden = Row(row.key, row.recorded, row.taken + added[at[0]] @ load, row.motion)
        out.append(balance.misfit(laden))
    return out


def _best_load(
    rows: list[Row], added: list[np.ndarray], masses: tuple[float, float], farthest: float
) -> np.ndarray:
    """(10,) inertial parameters of the point mass that leaves least of all rows, each in its own size, beside
    any friction and inertia."""
    squared, linear = np.zeros((10, 10)), np.zeros(10)
    for row, columns in zip(rows, added, strict=True):
        _, v, a = row.motion
        own = np.column_stack([np.sign(v), v, a])
        basis, _ = np.linalg.qr(own) if np.any(own) else (np.zeros((v.size, 0)), None)
        missing = row.recorded - row.taken
        y, x = missing - basis @ (basis.T @ missing), columns - basis @ (basis.T @ columns)
        squared += x.T @ x / (row.size * v.size)
        linear += x.T @ y / (row.size * v.size)
    values, vectors = np.linalg.eigh(squared)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    target = np.where(
        values > 1e-12 * values[-1], (vectors.T @ linear) / np.sqrt(np.maximum(values, 1e-300)), 0.0
    )
    best, least = np.zeros(10), np.inf
    aside = np.linalg.lstsq(root[:, 1:4], target, rcond=None)[0]
    for share in STARTS:
        mass = share * masses[1]
        start = np.array([mass, *np.clip(aside / mass, -0.9 * farthest, 0.9 * farthest)])
        solved = least_squares(
            lambda x: root @ _point_mass(x) - target,
            start,
            bounds=([masses[0], *[-farthest] * 3], [masses[1], *[farthest] * 3]),
            max_nfev=60,
        )
        if solved.cost < least:
            best, least = _point_mass(solved.x), float(solved.cost)
    return best


def _point_mass(x: np.ndarray) -> np.ndarray:
    mass, c = x[0], x[1:]
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *mass * c, *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
