"""Real causes that may stand behind torques that do not follow: data are blamed only where none can.

A joint may have an offset, a spring to any angle and a gain of up to three; and the robot may carry a load, a
point mass of up to its own mass, on any link within its reach; or a link lacks what its file says it has.

A repair is one statement about all torques that it sets right, so a real cause has to be one, too: a spring
at one joint, or one load, which explains each of them nearly as well. Torques that were not far off may have
a small spring or offset of their own beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import least_squares

from flexjoint.diagnosis.data.change import View
from flexjoint.diagnosis.data.torques.follows import Balance, Row, limits_of
from flexjoint.robot.robot import Robot

STARTS = (0.1, 0.5)  # of the largest load; a lighter link is found from the first
LEAST_REACH = 0.3  # m


def explained_otherwise(balance: Balance, view: View, without: np.ndarray, final: np.ndarray) -> bool:
    """Whether one real cause explains nearly as well what changes set right: of misfits (rows,) `without`
    them, in the `view`, the `final` ones."""
    limits = balance.settings
    enough = limits.times_rival**2 * np.maximum(final, 1e-6)
    better = without > enough
    cleared = (without >= limits.wrong**2) & (without >= limits.times_smaller**2 * final)
    rows = [balance.row(key, view) for key in balance.rows]
    gains = limits_of(limits.rival_gains)
    sprung = np.array([np.inf if row is None else balance.misfit(row, gains, spring=True) for row in rows])
    bent = sprung <= enough
    if np.count_nonzero(cleared) == 1 and np.all(bent[better]):
        return True
    for misfits in _loaded(balance, view, rows, cleared):
        laden = misfits <= enough
        if np.all(laden[cleared]) and np.all((laden | bent)[better]):
            return True
    return False


def reach(robot: Robot) -> float:
    """Sum of the distances between joints and of the last body's centre [m]: no part of it is farther."""
    model = robot.model
    steps = [float(np.linalg.norm(place.translation)) for place in list(model.jointPlacements)[2:]]
    centres = [float(np.linalg.norm(inertia.lever)) for inertia in list(model.inertias)[1:]]
    return sum(steps) + max(centres, default=0.0)


def _loaded(
    balance: Balance, view: View, all_rows: Sequence[Row | None], cleared: np.ndarray
) -> Iterator[np.ndarray]:
    """Misfits (rows,) with the best load on each link that acts on a cleared row; inf of a row whose source
    was not recorded."""
    robot = balance.data.robot
    there = [k for k, row in enumerate(all_rows) if row is not None]
    rows = [row for row in all_rows if row is not None]
    if not np.any(cleared[there]) or any(joint not in robot.joint_names for joint in balance.data.joints):
        return
    model = robot.model
    regressor = balance.body.regressor_batch(*balance.motion(view))
    heaviest = balance.settings.payload_mass * sum(inertia.mass for inertia in list(model.inertias)[1:])
    farthest = max(reach(robot), LEAST_REACH)
    for joint in robot.joints:
        carried = regressor[:, :, 10 * (joint.pin_id - 1) : 10 * joint.pin_id]  # (M, nv, 10)
        added = [carried[:, robot.joint(row.key[1]).idx_v] for row in rows]
        if not any(np.any(a) for a, shows in zip(added, cleared[there], strict=True) if shows):
            continue
        own = float(model.inertias[joint.pin_id].mass)
        load = _best_load(rows, added, (-own, heaviest), farthest)
        misfits = np.full(len(all_rows), np.inf)
        for k, row, columns in zip(there, rows, added, strict=True):
            laden = Row(row.key, row.recorded, row.taken + columns @ load, row.motion)
            misfits[k] = balance.misfit(laden)
        yield misfits


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
