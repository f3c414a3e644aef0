"""Contact forces that hold a robot at rest: what its motors cannot give, its contacts must.

At rest g(q) = S' tau + J_c' lambda, with S the actuated coordinates. The rows of the floating base and of
passive joints hold no motor torque: they are solved for lambda, the smallest in the sense of least squares,
and the actuated rows then give tau = g - J_c' lambda (Mistry, Buchli and Schaal, Inverse dynamics control of
floating base systems using orthogonal decomposition, 2010, on the same split).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear, nnls

from flexjoint.core.errors import ModelError
from flexjoint.model.dynamics import FlexibleJointModel

BALANCED = 1e-9  # of the largest gravity force: what may be left of a balance, three digits above round-off
CHUNK = 1024  # poses whose Jacobians are in memory at once


@dataclass(frozen=True)
class Contact:
    """A frame of the robot that touches its surroundings.

    A point carries a force, a `surface` a moment too. `normal` points out of the ground, along world axes;
    with `pushes`, the force along it cannot be negative.
    """

    frame: str
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    pushes: bool = False
    surface: bool = False

    @property
    def size(self) -> int:
        return 6 if self.surface else 3

    def axes(self) -> np.ndarray:
        """(size, 6) rows: the normal, two tangents, and for a surface the moments' axes."""
        normal = np.array(self.normal, dtype=float)
        length = float(np.linalg.norm(normal)) if normal.shape == (3,) else 0.0
        if not np.isfinite(length) or length == 0.0:
            raise ModelError(f"contact {self.frame}: normal must be 3 numbers, not all 0, got {self.normal}")
        normal = normal / length
        aside = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        aside = aside / np.linalg.norm(aside)
        frame = np.stack([normal, aside, np.cross(normal, aside)])
        out = np.zeros((self.size, 6))
        out[:3, :3] = frame
        if self.surface:
            out[3:, 3:] = np.eye(3)
        return out


def unactuated(model: FlexibleJointModel) -> np.ndarray:
    """Places in v that no motor drives: those of the floating base first, then passive joints'."""
    driven = {joint.idx_v for joint in model.joints}
    return np.array([k for k in range(model.nv) if k not in driven], dtype=int)


def contact_forces(
    model: FlexibleJointModel, q: np.ndarray, gravity: np.ndarray, contacts: Sequence[Contact]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces (N, c, 6) of the contacts on the robot at q (N, nq), and the generalised forces (N, nv) that
    they make; force before moment, at the frames' origins, along world axes [N, N m].

    `gravity` (N, nv) is g(q) less whatever else acts. Where contacts can share a load in many ways, the
    smallest sum of squares is taken.

    Raises ModelError that names the pose and what is left unbalanced, or an unknown frame.
    """
    free = unactuated(model)
    basis = _basis(contacts)
    bounded = _bounded(contacts)
    forces, made = np.empty((len(q), len(contacts), 6)), np.empty((len(q), model.nv))
    for begin in range(0, len(q), CHUNK):
        rows = slice(begin, begin + CHUNK)
        jacobian = _jacobian(model, q[rows], contacts)
        shares = np.swapaxes(basis @ jacobian, 1, 2)  # (n, nv, m): generalised force per unit of lambda
        load = gravity[rows][:, free]
        part = shares[:, free]
        scale = np.maximum(np.max(np.abs(gravity[rows]), axis=1), 1e-12)
        shared = _smallest(part, load, BALANCED * scale)
        for k in np.flatnonzero(np.any(shared[:, bounded] < -BALANCED * scale[:, None], axis=1)):
            shared[k] = _pushing(part[k], shared[k], bounded)
        left = load - (part @ shared[:, :, None])[:, :, 0]
        wrong = np.flatnonzero(~(np.max(np.abs(left), axis=1, initial=0.0) <= BALANCED * scale))
        if wrong.size:
            first = int(wrong[0])
            best = _nearest(part[first], load[first], bounded, model.robot.floating)
            remains = load[first] - part[first] @ best
            raise _unbalanced(model, contacts, q[rows][first], begin + first, remains)
        forces[rows] = (shared @ basis).reshape(len(shared), len(contacts), 6)
        made[rows] = (shares @ shared[:, :, None])[:, :, 0]
    return forces, made


def given_forces(
    model: FlexibleJointModel, q: np.ndarray, contacts: Sequence[Contact], forces: np.ndarray
) -> np.ndarray:
    """(N, nv) generalised forces J_c' lambda of known forces (N, c, 6), as in contact_forces."""
    made = np.empty((len(q), model.nv))
    for begin in range(0, len(q), CHUNK):
        rows = slice(begin, begin + CHUNK)
        jacobian = _jacobian(model, q[rows], contacts)
        made[rows] = np.einsum("ncv,nc->nv", jacobian, forces[rows].reshape(len(jacobian), -1))
    return made


def _jacobian(model: FlexibleJointModel, q: np.ndarray, contacts: Sequence[Contact]) -> np.ndarray:
    """(n, 6 c, nv)."""
    jacobian = model.body.frame_jacobians_batch(q, [contact.frame for contact in contacts])
    return jacobian.reshape(len(q), 6 * len(contacts), model.nv)


def _basis(contacts: Sequence[Contact]) -> np.ndarray:
    """(m, 6 c): each unknown as a force or moment of one contact."""
    out = np.zeros((sum(contact.size for contact in contacts), 6 * len(contacts)))
    row = 0
    for k, contact in enumerate(contacts):
        out[row : row + contact.size, 6 * k : 6 * k + 6] = contact.axes()
        row += contact.size
    return out


def _bounded(contacts: Sequence[Contact]) -> np.ndarray:
    """Places of the unknowns that may not be negative."""
    starts = np.cumsum([0, *(contact.size for contact in contacts)])
    return np.array([starts[k] for k, contact in enumerate(contacts) if contact.pushes], dtype=int)


def _smallest(part: np.ndarray, load: np.ndarray, close: np.ndarray) -> np.ndarray:
    """The smallest lambda (n, m) with part (n, u, m) lambda = load (n, u), or nearest to it: by normal
    equations, refined once, and by the pseudo-inverse where these miss by more than close (n,)."""
    out = np.zeros((len(part), part.shape[2]))
    across = np.swapaxes(part, 1, 2)
    left = load
    try:
        for _ in range(2):
            out = out + (across @ np.linalg.solve(part @ across, left[:, :, None]))[:, :, 0]
            left = load - (part @ out[:, :, None])[:, :, 0]
        wrong = ~(np.max(np.abs(left), axis=1, initial=0.0) <= close)
    except np.linalg.LinAlgError:
        wrong = np.ones(len(part), dtype=bool)
    if np.any(wrong):
        inverse = np.linalg.pinv(part[wrong], rcond=1e-10)
        once = (inverse @ load[wrong][:, :, None])[:, :, 0]
        left = load[wrong] - (part[wrong] @ once[:, :, None])[:, :, 0]
        out[wrong] = once + (inverse @ left[:, :, None])[:, :, 0]
    return out


def _pushing(part: np.ndarray, smallest: np.ndarray, bounded: np.ndarray) -> np.ndarray:
    """The smallest lambda with part lambda as given by `smallest`, and its bounded entries not negative: in
    the null space Z, min |y| with (Z y)_b >= -smallest_b, a least-distance problem solved by non-negative
    least squares (Lawson and Hanson, Solving least squares problems, 1974, chapter 23). Unchanged where there
    is none."""
    _, sizes, right = np.linalg.svd(part)
    rank = int(np.sum(sizes > 1e-10 * max(sizes[0], 1e-300)))
    null = right[rank:].T
    if null.shape[1] == 0:
        return np.where(np.isin(np.arange(len(smallest)), bounded), np.maximum(smallest, 0.0), smallest)
    scale = float(np.max(np.abs(smallest)))
    system = np.vstack([null[bounded].T, -smallest[bounded] / scale])
    target = np.zeros(len(system))
    target[-1] = 1.0
    weights, distance = nnls(system, target)
    left = system @ weights - target
    if distance < 1e-9 or left[-1] == 0.0:
        return np.where(np.isin(np.arange(len(smallest)), bounded), np.maximum(smallest, 0.0), smallest)
    out = smallest + scale * (null @ (-left[:-1] / left[-1]))
    out[bounded] = np.where(out[bounded] > -1e-12 * scale, np.maximum(out[bounded], 0.0), out[bounded])
    return out


def _nearest(part: np.ndarray, load: np.ndarray, bounded: np.ndarray, floating: bool) -> np.ndarray:
    """The lambda that leaves least unbalanced, of a floating base the moments rather than the forces."""
    low = np.full(part.shape[1], -np.inf)
    low[bounded] = 0.0
    weight = np.ones(len(load))
    weight[:3] = 1e4 if floating else 1.0
    return lsq_linear(part * weight[:, None], load * weight, bounds=(low, np.inf), method="bvls").x


def _unbalanced(
    model: FlexibleJointModel, contacts: Sequence[Contact], q: np.ndarray, pose: int, left: np.ndarray
) -> ModelError:
    """The error that names what the contacts leave."""
    names = ", ".join(contact.frame for contact in contacts) or "none"
    free = unactuated(model)
    parts = []
    if model.robot.floating:
        # the base's rows are along its own axes
        turn = model.body.frame_placement(q, "root_joint")[:3, :3]
        force, moment = np.round(turn @ left[:3], 4) + 0.0, np.round(turn @ left[3:6], 4) + 0.0
        parts.append(f"force {_numbers(force)} N and moment {_numbers(moment)} N m about the base's origin")
    rigid = model.robot.model
    for k in range(1, rigid.njoints):
        joint = rigid.joints[k]
        own = np.isin(free, range(joint.idx_v, joint.idx_v + joint.nv))
        if joint.shortname() != "JointModelFreeFlyer" and np.any(np.abs(left[own]) > 1e-6):
            parts.append(f"{', '.join(f'{value:.4g}' for value in left[own])} N m at {rigid.names[k]}")
    pushing = " by pushing" if any(contact.pushes for contact in contacts) else ""
    return ModelError(
        f"pose {pose}: the contacts ({names}) cannot carry the robot{pushing}; left unbalanced: "
        f"{'; '.join(parts)}. Add contacts, or move the centre of mass above them"
    )


def _numbers(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
