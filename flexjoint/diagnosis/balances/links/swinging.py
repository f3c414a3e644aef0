"""Links that swing on springs, linear about a motion: M(t) dq'' + C(t) dq' + K(t) dq = torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtbtrs

from flexjoint.diagnosis.balances.links.movement import Movement

FADES = 1.0 / 24.0  # of (rate times period)^4, by which the second half of the rule fades
SLOWEST = 0.1  # of a sample: a link whose spring moves it faster follows it at once


@dataclass(frozen=True)
class Swinging:
    """Equations of k links: mass, damping and stiffness (N, k, k), the sampling period [s].

    Steps are those of Hermite's rule of fourth order (Hairer, Norsett and Wanner, "Solving ordinary
    differential equations I", II.2), x1 - x0 = h/2 (x0' + x1') + h^2/12 (x0'' - x1''): the trapezoidal rule
    lowers a frequency of a tenth of the sampling rate by 3 %. Of swings that the samples do not resolve the
    second half of the rule fades away: the trapezoidal rule leaves their error where filters take it, at half
    the sampling rate. It fades with even powers of springs and of dampers, each for itself: of one link, no
    step then enlarges what a spring and a damper make smaller."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    period: float

    def by(self, torque: np.ndarray, start: np.ndarray | None = None) -> list[Movement]:
        """What torques (k, N) on the links move them by, from a `start` (2 k,) of positions and speeds; from
        rest where the springs carry them without one."""
        k, count = torque.shape
        drive = np.zeros((count, 2 * k))
        if start is None:
            drive[0, :k] = np.linalg.solve(self.stiffness[0], torque[:, 0])
        else:
            drive[0] = start
        slope = np.gradient(torque, self.period, axis=1)
        (before, after), (rising, rose) = ((x[:, :-1], x[:, 1:]) for x in (torque, slope))
        pushes = (before + after, before - after, rising - rose)
        for part, push in zip(self._steps[1:], pushes, strict=True):
            drive[1:] += np.einsum("tij,jt->ti", part, push)
        state, info = dtbtrs(self._recurrence, drive.reshape(-1, 1), uplo="L", diag="U")
        assert info == 0  # the diagonal is 1
        q, v = np.moveaxis(state.reshape(count, 2, k), 0, -1)
        held = np.einsum("tij,jt->it", self.damping, v) + np.einsum("tij,jt->it", self.stiffness, q)
        a = np.linalg.solve(self.followed, (torque - held).T[:, :, None])[:, :, 0].T
        return [Movement(*one) for one in zip(q, v, a, strict=True)]

    @cached_property
    def followed(self) -> np.ndarray:
        """(N, k, k) masses with which links follow their springs in no less than a tenth of a sample: a robot
        file may give a small link no inertia about its axis, and steps forget faster swings slowly."""
        springs, own = (np.diagonal(x, axis1=1, axis2=2) for x in (self.stiffness, self.mass))
        least = springs * (SLOWEST * self.period) ** 2
        return np.asarray(self.mass + np.maximum(0.0, least - own)[:, :, None] * np.eye(own.shape[1]))

    @cached_property
    def _steps(self) -> tuple[np.ndarray, ...]:
        """(N - 1, 2 k, 2 k) and thrice (N - 1, 2 k, k): the state x = (dq, dq') after a step, by the one
        before it, by the sum and the difference of the torques at both ends, and by the difference of their
        slopes. The equations x' = A x + b f are those of the middle of the step."""
        h, k = self.period, self.mass.shape[1]
        matrices = (self.followed, self.damping, self.stiffness)
        mass, damping, stiffness = (0.5 * (x[:-1] + x[1:]) for x in matrices)
        none, one = np.zeros_like(mass), np.broadcast_to(np.eye(k), mass.shape)
        held = -np.linalg.solve(mass, np.concatenate([stiffness, damping], axis=2))
        a = np.concatenate([np.concatenate([none, one], axis=2), held], axis=1)
        b = np.concatenate([none, np.linalg.inv(mass)], axis=1)
        second, share = h**2 * (a @ a), np.zeros_like(a)
        springs, dampers = h**2 * held[:, :, :k], (h * held[:, :, k:]) @ (h * held[:, :, k:])
        fading = np.linalg.inv(12.0 * (np.eye(k) + FADES * (springs @ springs + dampers @ dampers)))
        share[:, :k, :k] = share[:, k:, k:] = fading
        even, odd, bent = np.eye(2 * k) + share @ second, 0.5 * h * a, h**2 * share
        right = [even + odd, 0.5 * h * b, bent @ a @ b, bent @ b]
        steps = np.linalg.solve(even - odd, np.concatenate(right, axis=2))
        return tuple(np.split(steps, [2 * k, 3 * k, 4 * k], axis=2))

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
