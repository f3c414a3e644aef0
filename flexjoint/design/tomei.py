"""Tomei's condition: does PD control with constant gravity compensation have one rest, and reach it from
anywhere?

Tomei 1991 (A simple PD controller for robots with elastic joints); notation of De Luca, Siciliano and Zollo
2005: lambda_min [[K, -K], [-K, K + K_P]] > alpha, where alpha bounds the gravity Hessian ||dg/dq|| over all
positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from flexjoint.core.errors import ModelError
from flexjoint.model.dynamics import FlexibleJointModel

LOCAL = 5  # samples from which the optimiser starts


@dataclass(frozen=True, kw_only=True)
class TomeiCheck:
    """The verdict of Tomei's condition.

    gravity: alpha [N m/rad], the largest ||dg/dq|| found, at the links' `pose` (nq,). stiffness: lambda_min
    of the potential of springs and K_P [N m/rad]. margin: stiffness / gravity; the condition holds where it
    is above 1.
    convex: the smallest eigenvalue over poses of K K_P / (K + K_P) + dg/dq [N m/rad]. Above 0 the whole
    potential is convex, which alone gives one rest: sharper than Tomei's condition, which it follows from.
    Both extremes were searched by `samples` poses and local optimisation from the worst of them: the largest
    found, not a proven bound.
    """

    holds: bool
    margin: float
    gravity: float
    stiffness: float
    convex: float
    pose: np.ndarray
    samples: int

    def __str__(self) -> str:
        verdict = "holds" if self.holds else "does not hold"
        return (
            f"Tomei's condition {verdict}: {self.stiffness:.4g} N m/rad of springs and K_P against"
            f" {self.gravity:.4g} N m/rad"
            f" of gravity (margin {self.margin:.3g}); the potential is"
            f" {'convex' if self.convex > 0.0 else 'not convex'} ({self.convex:.3g} N m/rad)"
        )


def tomei(
    model: FlexibleJointModel, kp: np.ndarray | float, samples: int = 2000, seed: int = 0
) -> TomeiCheck:
    """Check K_P (n,) [N m/rad] and the springs of a model against gravity, over all its positions.

    Positions range over the URDF's limits, a full turn at most. Springs count with K, effects on the drive
    included. Raises ModelError for a floating base or passive joints, where the condition does not apply.
    """
    n = len(model.joints)
    if model.nv != n:
        raise ModelError("Tomei's condition needs a fixed base and every joint actuated")
    gains = np.broadcast_to(np.asarray(kp, dtype=float), n)
    order = [joint.idx_v for joint in model.joints]
    K = np.array([flow.drive.K for flow in model.flows])
    series = np.where(np.isinf(K), gains, gains / (1.0 + gains / K))

    def slope(q: np.ndarray) -> np.ndarray:
        zero = np.zeros(model.nv)
        by_q = model.body.rnea_derivatives(q, zero, zero)[0][np.ix_(order, order)]
        return 0.5 * (by_q + by_q.T)

    def steepness(q: np.ndarray) -> float:
        return -float(np.linalg.norm(slope(q), 2))

    def curvature(q: np.ndarray) -> float:
        return float(np.linalg.eigvalsh(np.diag(series) + slope(q))[0])

    low, high = position_limits(model)
    poses = low + (high - low) * np.random.default_rng(seed).random((samples, model.nq))
    pose, found = _smallest(steepness, poses, low, high)
    convex = _smallest(curvature, poses, low, high)[1]
    stiffness = float(min(_potential(k, p) for k, p in zip(K, gains, strict=True)))
    gravity = -found
    margin = stiffness / gravity if gravity > 0.0 else np.inf
    return TomeiCheck(
        holds=margin > 1.0,
        margin=float(margin),
        gravity=gravity,
        stiffness=stiffness,
        convex=convex,
        pose=pose,
        samples=samples,
    )


def position_limits(model: FlexibleJointModel) -> tuple[np.ndarray, np.ndarray]:
    """(nq,) lower and upper positions of single-axis joints: the URDF's, within half a turn of the middle; a
    joint without limits, +-pi."""
    low = np.array(model.robot.model.lowerPositionLimit)
    high = np.array(model.robot.model.upperPositionLimit)
    free = ~((high - low > 0.0) & (high - low < 2.0 * np.pi))
    return np.where(free, -np.pi, low), np.where(free, np.pi, high)


def _potential(K: float, kp: float) -> float:
    """lambda_min of [[K, -K], [-K, K + kp]]; K_P itself for a rigid joint."""
    if np.isinf(K):
        return kp
    return K + 0.5 * kp - float(np.hypot(K, 0.5 * kp))


def _smallest(
    function: Callable[[np.ndarray], float], poses: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """Where a function of the pose is smallest: of the samples, improved locally from the best of them."""
    values = np.array([function(q) for q in poses])
    best, least = poses[int(np.argmin(values))], float(np.min(values))
    bounds = list(zip(low, high, strict=True))
    for k in np.argsort(values)[:LOCAL]:
        local = minimize(function, poses[k], bounds=bounds, method="L-BFGS-B", options={"maxiter": 60})
        if local.fun < least:
            best, least = local.x, float(local.fun)
    return best, least
