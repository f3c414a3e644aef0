"""A robot at rest on the ground: what its contacts carry, how deep they sink, and what its joints need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import ModelError
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import deflection, equilibrium, holding_torque
from flexjoint.model.statics.forces import unactuated

ALONG = 1e3  # how much dearer a force along the ground is than one along the normal
ROUNDS = 20  # of the base's placement; each leaves about a hundredth of the error
CONVERGED = 1e-12  # [m]
BALANCED = 1e-9  # of the weight


@dataclass(frozen=True)
class Standing:
    """state: at rest, springs carrying the load and contacts sunk in; tau (n,): joint torques
    g - J_c' lambda [N m]; forces (c, 3): lambda, of the contacts on the robot along world axes [N]."""

    state: State
    tau: np.ndarray
    forces: np.ndarray


def standing(model: FlexibleJointModel, q: np.ndarray) -> Standing:
    """The robot at rest on its contacts with the joints at q (nq,) [rad]; its base is moved and tilted onto
    them.

    The smallest forces are taken, and along the ground only such as balance needs. Where four or more
    contacts do not lie in a plane, their depths fit in the sense of least squares.

    Raises ModelError where the model has no contacts, or they cannot carry it by pushing.
    """
    if model.ground is None or model.symbolic:
        raise ModelError("standing needs a numeric model of a floating robot with contacts in its file")
    q = np.array(q, dtype=float)
    for _ in range(ROUNDS):
        points, jacobian = model.ground.places(model.body, q)
        forces = _forces(model, q, jacobian)
        missing = -model.ground.sinking(forces) - points[:, 2]
        move = np.zeros(model.nv)
        move[:6] = np.linalg.lstsq(jacobian[:, 2, :6], missing, rcond=1e-9)[0]
        q = model.body.integrate(q, move)
        if np.max(np.abs(move)) < CONVERGED:
            break
    points, jacobian = model.ground.places(model.body, q)
    forces = _forces(model, q, jacobian)
    made = np.einsum("cjv,cj->v", jacobian, forces)
    tau = holding_torque(model, q)[0] - made[[joint.idx_v for joint in model.joints]]
    state = model.rest(q)
    for k, i in enumerate(model.flexible):
        flow = model.flows[i]
        link = q[flow.joint.idx_q : flow.joint.idx_q + 1]
        state.theta[k] = link[0] + deflection(flow, link, tau[i : i + 1])[0]
        for slot, value in flow.steady_state(Signals(q=link[0], theta=state.theta[k], tau_m=tau[i]), tau[i]):
            state.z[slot] = value
    state.z = model.ground.carrying(model.body, state.z, points, forces)
    return Standing(state, tau, forces)


def holding(model: FlexibleJointModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motor positions (n,) [rad] and joint torques (n,) [N m] that hold the joints at q (nq,), on the ground
    where the model has contacts. Raises ModelError where that cannot be."""
    if model.ground is None:
        rest = equilibrium(model, q)
        return rest.theta[0], rest.tau[0]
    stands = standing(model, q)
    theta = np.array([q[joint.idx_q] for joint in model.joints])
    theta[list(model.flexible)] = stands.state.theta
    return theta, stands.tau


def _forces(model: FlexibleJointModel, q: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """(c, 3) the cheapest forces that balance the load of coordinates without a motor."""
    free = unactuated(model)
    cheap = np.tile([1.0 / ALONG, 1.0 / ALONG, 1.0], len(jacobian))
    load = model.body.gravity_torque(q)[free]
    part = jacobian.reshape(-1, model.nv)[:, free].T * cheap
    found = np.linalg.lstsq(part, load, rcond=1e-12)[0]
    left = float(np.max(np.abs(load - part @ found)))
    forces = (cheap * found).reshape(-1, 3)
    weight = float(np.max(np.abs(load)))
    if left > BALANCED * weight or np.any(forces[:, 2] < 0.0):
        names = ", ".join(item.frame for item in model.robot.contacts)
        raise ModelError(
            f"standing: the contacts ({names}) cannot carry the robot by pushing; move its centre of mass"
            " above them, or add contacts"
        )
    return np.asarray(forces)
