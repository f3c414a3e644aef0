"""References as functions of time that may jump, and their samples at control ticks.

A jump that falls on a tick is read from the left: the controller samples what was there up to then, and sees
the new value one tick later. Every solution that is compared has to read it alike: a sample out of place at a
step of 1 rad with a gain of 1000 N m/rad is an error of the whole motor torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flexjoint.core.errors import SimulationError
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium

SAME_TIME = 1e-9  # [s] closer times count as one


@dataclass(frozen=True)
class Profile:
    """A signal made of pieces: `pieces` holds, in order of time, where each begins [s] and its function of
    the time t (N,) [s]. The first also holds before its beginning.

    Raises SimulationError when there is no piece or their order is not that of time.
    """

    pieces: tuple[tuple[float, Callable[[np.ndarray], np.ndarray]], ...]

    def __post_init__(self) -> None:
        starts = [start for start, _ in self.pieces]
        if not starts or any(b <= a for a, b in pairwise(starts)):
            raise SimulationError(f"profile: expected pieces that begin one after the other, got {starts}")

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times at which one piece gives way to the next."""
        return tuple(start for start, _ in self.pieces[1:])

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """The value at times (N,) or one time; at a break from the left."""
        t = np.asarray(t, dtype=float)
        which = np.searchsorted(np.array(self.breaks) + SAME_TIME, t, side="left")
        out = np.zeros(t.shape)
        for k, (_, function) in enumerate(self.pieces):
            out = np.where(which == k, function(t), out)
        return out


def constant(value: float) -> Callable[[np.ndarray], np.ndarray]:
    """A piece that holds a value."""
    return lambda t: np.full(np.shape(t), value)


def tomei(model: FlexibleJointModel, q_ref: np.ndarray) -> dict[str, np.ndarray]:
    """The references of eq 4 of Kameduła et al. 2016 at link positions q_ref (N, n) of the actuated joints:
    q_ref, theta_ref = q_ref + g(q_ref)/K, dtheta_ref = 0, tau_ff = g(q_ref); each (N, n). Other joints are
    neutral.
    """
    rows = np.tile(model.body.neutral, (len(q_ref), 1))
    rows[:, [joint.idx_q for joint in model.joints]] = q_ref
    rest = equilibrium(model, rows)
    return {
        "q_ref": np.array(q_ref, dtype=float),
        "theta_ref": rest.theta,
        "dtheta_ref": np.zeros_like(rest.theta),
        "tau_ff": rest.tau,
    }
