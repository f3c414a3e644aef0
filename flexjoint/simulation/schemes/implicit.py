"""Implicit midpoint, solved by Newton's method to convergence.

    u = u0 + h/2 f(midpoint of u),  u = (v, dtheta, z) at the midpoint

Order 2, A-stable, symmetric; it keeps quadratic invariants, so the energy of a lossless robot does not
drift (Hairer, Lubich and Wanner 2006, sections II.1.3 and IV.2). The Jacobian is of difference quotients,
taken at the predicted midpoint and again where it serves badly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flexjoint.core import ops
from flexjoint.core.errors import ModelError, SimulationError
from flexjoint.core.ops import Value
from flexjoint.model.dynamics import FlexibleJointModel, Rates, State
from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step, midpoint_matrix

ITERATIONS = 60
CONVERGED = 1e-12  # relative size of the last correction
STALLED = 1e-8  # a correction this small that no longer shrinks is rounding
SLOW = 0.1  # contraction above which the Jacobian is renewed
HALVINGS = 12
NUDGE = 1e-7  # relative step of the difference quotients


class Equations:
    """The equations of one step from x under the torques tau_m (n,), for numbers and CasADi alike.

    Attributes:
        before, guess: (u,) v, dtheta and z at the start, and what is predicted for the midpoint.
    """

    def __init__(
        self, model: FlexibleJointModel, x: State, tau_m: Value, h: float, width: float | None
    ) -> None:
        self.model, self.x, self.tau_m, self.h, self.width = model, x, tau_m, h, width
        self.a = 0.5 * h
        self.before = ops.join([x.v, x.dtheta, x.z])
        self.guess = self.before + self.a * ops.join([x.acc, x.ddtheta, model.zeros(model.nz)])

    def missing(self, u: Value) -> Value:
        """(u,) what u lacks of being the midpoint."""
        r = self._rates(self._middle(u))
        return u - self.before - self.a * ops.join([r.acc, r.ddtheta, r.dz])

    def end(self, u: Value) -> State:
        """The state at the end of the step whose midpoint is u."""
        model, x, a = self.model, self.x, self.a
        nv, nf = model.nv, model.nf
        mid = self._middle(u)
        tau_rigid = self._rates(mid).tau_t[list(model.rigid)] if model.rigid else x.tau_rigid
        end = 2.0 * u - self.before
        return State(
            x.t + self.h,
            model.body.integrate(x.q, self.h * mid.v),
            end[:nv],
            x.theta + self.h * mid.dtheta,
            end[nv : nv + nf],
            end[nv + nf :],
            (mid.v - x.v) / a,
            (mid.dtheta - x.dtheta) / a,
            tau_rigid,
        )

    def _middle(self, u: Value) -> State:
        model, x, a = self.model, self.x, self.a
        nv, nf = model.nv, model.nf
        v, w, z = u[:nv], u[nv : nv + nf], u[nv + nf :]
        q = model.body.integrate(x.q, a * v)
        return replace(x, t=x.t + a, q=q, v=v, theta=x.theta + a * w, dtheta=w, z=z)

    def _rates(self, middle: State) -> Rates:
        return self.model.rates(middle, self.tau_m, self.width)


class ImplicitMidpoint(Scheme):
    """Implicit midpoint by Newton's method; many evaluations a step; numbers only (compiled, the same
    iteration runs in C: `flexjoint/simulation/compiled/sources/newton.c`).

    Dry friction is smoothed over `width` [rad/s], which may be as narrow as wanted. A step that does not
    converge raises SimulationError with its time and the joint that is worst off.
    """

    name = "implicit_midpoint"
    order = 2
    any_stiffness = True
    keeps_energy = 2.0
    keeps_momentum = 0.1
    newton = True

    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        if model.symbolic:
            raise ModelError(
                f"{self.name} iterates until it has converged, which expressions cannot; use {DEFAULT}"
            )

        def step(x: State, tau_m: Value) -> State:
            equations = Equations(model, x, tau_m, h, width)
            u = _newton(equations.missing, equations.guess, lambda k: not_converged(model, x.t, h, k))
            return equations.end(u)

        return step

    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        return midpoint_matrix(A, h)


def _newton(
    missing: Callable[[np.ndarray], np.ndarray],
    u: np.ndarray,
    failed: Callable[[int], SimulationError],
) -> np.ndarray:
    """The root of `missing`; `failed` gives the error to raise from the place of the worst entry."""
    error = missing(u)
    slopes, fresh = _slopes(missing, u, error), True
    before = np.inf
    for _ in range(ITERATIONS):
        try:
            move = -np.linalg.solve(slopes, error)
        except np.linalg.LinAlgError:
            break
        size = _size(move, u)
        if not np.isfinite(size):
            break
        if size <= CONVERGED or (size <= STALLED and size >= 0.5 * before):
            return u + move
        share, trial = 1.0, missing(u + move)
        if _size(trial, u) > _size(error, u):
            if not fresh:
                slopes, fresh, before = _slopes(missing, u, error), True, np.inf
                continue
            for _ in range(HALVINGS):  # a kink, or too far: go part of the way
                share *= 0.5
                trial = missing(u + share * move)
                if _size(trial, u) <= _size(error, u):
                    break
        u, error = u + share * move, trial
        if share < 1.0 or size > SLOW * before:
            slopes, fresh = _slopes(missing, u, error), True
        else:
            fresh = False
        before = size
    raise failed(int(np.argmax(np.abs(error) / (1.0 + np.abs(u)))))


def _slopes(missing: Callable[[np.ndarray], np.ndarray], u: np.ndarray, error: np.ndarray) -> np.ndarray:
    out = np.empty((len(u), len(u)))
    for k in range(len(u)):
        moved = u.copy()
        moved[k] += NUDGE * (1.0 + abs(u[k]))
        out[:, k] = (missing(moved) - error) / (moved[k] - u[k])
    return out


def _size(change: np.ndarray, u: np.ndarray) -> Any:
    return np.max(np.abs(change) / (1.0 + np.abs(u))) if len(u) else 0.0


def not_converged(model: FlexibleJointModel, t: float, h: float, worst: int) -> SimulationError:
    """The error of a step of h seconds from t on; worst: the place in u of the largest residual."""
    nv, nf = model.nv, model.nf
    if worst < nv:
        owners = [joint.name for joint in model.joints if joint.idx_v == worst] or [f"v[{worst}]"]
    elif worst < nv + nf:
        owners = [model.joints[model.flexible[worst - nv]].name]
    else:
        owners = [model.state_names[model.nq + nv + 2 * nf + worst - nv - nf]]
    return SimulationError(
        f"{ImplicitMidpoint.name}: Newton's method did not converge in the step from t = {t:.6g} s (h ="
        f" {h:g} s), worst at joint {owners[0]}; raise the physics rate, widen the smoothing of dry"
        f" friction, or use {DEFAULT}"
    )
