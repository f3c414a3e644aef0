"""A simulated motion, and what went before one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.model.dynamics import State


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """A simulated motion on a uniform time grid of R rows, the first `first` of which lie before the start.

    time (R,) [s]; q (R, nq), v (R, nv); theta, dtheta (R, nf) of the flexible joints; z (R, nz);
    tau_rigid (R, nr); tau_m (R, n) motor torque commanded at a row and held to the next, before the
    effects on the command.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    z: np.ndarray
    tau_rigid: np.ndarray
    tau_m: np.ndarray
    first: int = 0

    def state(self, row: int) -> State:
        """The state at a row, with nothing remembered of the step before."""
        nv, nf = self.v.shape[1], self.theta.shape[1]
        return State(
            float(self.time[row]),
            self.q[row].copy(),
            self.v[row].copy(),
            self.theta[row].copy(),
            self.dtheta[row].copy(),
            self.z[row].copy(),
            np.zeros(nv),
            np.zeros(nf),
            self.tau_rigid[row].copy(),
        )


@dataclass(frozen=True)
class Past:
    """What went before a start, oldest first, on the grid of the simulation: motor torques tau_m (H, n) and
    q (H, nq), v (H, nv), theta, dtheta (H, nf). Delayed commands and readings look it up."""

    tau_m: np.ndarray
    q: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
