"""Static law of a robot with flexible joints: what holds a link position at rest.

g(q) holds the links, a spring deflection that carries it puts the motor at theta_d = q_d + g(q_d)/K (Tomei
1991; Kashiri et al. 2017, section 3). Springs that are not linear are inverted by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexjoint.effect import Signals
from flexjoint.errors import ModelError
from flexjoint.flow import JointFlow
from flexjoint.model import FlexibleJointModel

ROUNDS = 100  # of safeguarded Newton; each at least halves the bracket
WIDENINGS = 60  # doublings of the bracket until it holds the root


@dataclass(frozen=True)
class Equilibrium:
    """Rest at link positions: theta (N, n) motor positions [rad] and tau (N, n) motor torques [N m] of the
    actuated joints, dry friction aside; tau is also what the springs carry."""

    theta: np.ndarray
    tau: np.ndarray


def holding_torque(model: FlexibleJointModel, q: np.ndarray) -> np.ndarray:
    """(N, n) joint torques [N m] that hold the links at rest at q (N, nq): gravity less what link effects
    (a cable, a stop) give."""
    q = _rows(model, q)
    gravity = np.array([model.body.gravity_torque(row) for row in q])
    tau = np.empty((len(q), len(model.joints)))
    z = np.zeros((model.nz, 1))
    for i, flow in enumerate(model.flows):
        x = q[:, flow.joint.idx_q]
        _, on_link = flow.torques(Signals(q=x, theta=x), z)
        tau[:, i] = gravity[:, flow.joint.idx_v] - on_link
    return tau


def equilibrium(model: FlexibleJointModel, q: np.ndarray) -> Equilibrium:
    """theta_d and g(q_d) for link positions q (N, nq) or (nq,) [rad].

    Internal states of effects count as relaxed (0). Raises ModelError when a spring cannot carry the load.
    """
    q = _rows(model, q)
    load = holding_torque(model, q)
    theta = np.empty_like(load)
    for i, flow in enumerate(model.flows):
        link = q[:, flow.joint.idx_q]
        theta[:, i] = link if flow.joint.rigid else link + deflection(flow, link, load[:, i])
    return Equilibrium(theta, load)


def deflection(flow: JointFlow, q: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(N,) phi = theta - q at rest under tau_t = load (N,) [N m] with the link at q (N,).

    Raises ModelError when the spring cannot carry the load.
    """
    stiffness = flow.drive.K
    if not flow.nonlinear_spring:
        return load / stiffness

    def missing(phi: np.ndarray) -> np.ndarray:
        z = np.zeros((1 + max((part.slot for part in flow.stateful), default=0), 1))
        return flow.transmission(Signals(q=q, theta=q + phi, phi=phi), z) - load

    low, high = _bracket(missing, load / stiffness, np.abs(load) / stiffness + 1e-3, flow)
    phi = np.clip(load / stiffness, low, high)
    for _ in range(ROUNDS):
        error = missing(phi)
        low, high = np.where(error < 0.0, phi, low), np.where(error > 0.0, phi, high)
        step = 1e-7 * (1.0 + np.abs(phi))
        slope = (missing(phi + step) - error) / step
        safe = slope > 1e-6 * stiffness
        newton = phi - error / np.where(safe, slope, 1.0)
        inside = safe & (newton > low) & (newton < high)
        new = np.where(error == 0.0, phi, np.where(inside, newton, 0.5 * (low + high)))
        if np.all(np.abs(new - phi) <= 1e-15 * (1.0 + np.abs(phi))):
            return new
        phi = new
    return phi


def _bracket(
    missing: Callable[[np.ndarray], np.ndarray], centre: np.ndarray, reach: np.ndarray, flow: JointFlow
) -> tuple[np.ndarray, np.ndarray]:
    """Deflections below and above the root: a transmission torque grows with the deflection."""
    low, high = centre - reach, centre + reach
    for _ in range(WIDENINGS):
        below, above = missing(low) > 0.0, missing(high) < 0.0
        if not np.any(below | above):
            return low, high
        reach = 2.0 * reach
        low, high = np.where(below, centre - reach, low), np.where(above, centre + reach, high)
    raise ModelError(
        f"the spring of joint {flow.joint.name} cannot carry the load at rest; check its effects' parameters"
    )


def _rows(model: FlexibleJointModel, q: np.ndarray) -> np.ndarray:
    rows = np.atleast_2d(np.asarray(q, dtype=float))
    if rows.ndim != 2 or rows.shape[1] != model.nq:
        raise ModelError(f"q: expected (N, {model.nq}) link positions, got shape {np.shape(q)}")
    return rows
