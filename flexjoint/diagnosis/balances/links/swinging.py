"""Links that swing on springs, linear about a motion: M(t) dq'' + C(t) dq' + K(t) dq = torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtbtrs


@dataclass(frozen=True)
class Movement:
    """dq, dq' and dq'' (N,) of a link."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True)
class Swinging:
    """Equations of k links, by the trapezoidal rule: mass, damping and stiffness (N, k, k), the sampling
    period [s]."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    period: float

    def by(self, torque: np.ndarray, start: np.ndarray | None = None) -> list[Movement]:
        """What torques (k, N) on the links move them by, from a `start` (2 k,) of positions and speeds; from
        rest where the springs carry them without one."""
        k, count = torque.shape
        drive = np.zeros((count, 2 * k))
        mean = 0.5 * (torque[:, :-1] + torque[:, 1:]).T
        if start is None:
            drive[0, :k] = np.linalg.solve(self.stiffness[0], torque[:, 0])
        else:
            drive[0] = start
        drive[1:] = np.einsum("tij,tj->ti", self._steps[1], mean)
        state, info = dtbtrs(self._recurrence, drive.reshape(-1, 1), uplo="L", diag="U")
        assert info == 0  # the diagonal is 1
        q, v = np.moveaxis(state.reshape(count, 2, k), 0, -1)
        held = np.einsum("tij,jt->it", self.damping, v) + np.einsum("tij,jt->it", self.stiffness, q)
        a = np.linalg.solve(self.mass, (torque - held).T[:, :, None])[:, :, 0].T
        return [Movement(*one) for one in zip(q, v, a, strict=True)]

    @cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray]:
        """(N - 1, 2 k, 2 k) and (N - 1, 2 k, k): the state (dq, dq') after a step, of the one before it and
        of the mean torque."""
        h, k = self.period, self.mass.shape[1]
        mass, damping, stiffness = (0.5 * (x[:-1] + x[1:]) for x in (self.mass, self.damping, self.stiffness))
        one = np.broadcast_to(np.eye(k), mass.shape)
        # M dv = h (f - C v - K q) and dq = h v, each with the means of both ends
        left = np.block([[one, -0.5 * h * one], [0.5 * h * stiffness, mass + 0.5 * h * damping]])
        right = np.block([[one, 0.5 * h * one], [-0.5 * h * stiffness, mass - 0.5 * h * damping]])
        pushed = np.concatenate([np.zeros_like(mass), h * one], axis=1)
        solved = np.linalg.solve(left, np.concatenate([right, pushed], axis=2))
        return solved[:, :, : 2 * k], solved[:, :, 2 * k :]

    @cached_property
    def _recurrence(self) -> np.ndarray:
        """The steps as a banded matrix (LAPACK's lower form): state - step times the state before = drive."""
        step = self._steps[0]
        size = step.shape[1]
        band = np.zeros((2 * size, (len(step) + 1) * size))
        band[0] = 1.0
        for row in range(size):
            for column in range(size):
                band[size + row - column, column : len(step) * size : size] = -step[:, row, column]
        return band
