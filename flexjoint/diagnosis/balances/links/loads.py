"""What links carry along a motion, and what effects of bodies add to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.effects import Planned, signal_order

REMEMBERED = 5e6  # bytes of changes of the rigid-body torques


class Loads:
    """Rigid-body torques along one motion; n actuated joints, N samples."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._t = motion.readings.time - motion.readings.start
        self._added: LruCache[np.ndarray] = LruCache()

    def carried(self, i: int, bodies: Sequence[Planned]) -> np.ndarray:
        """(N,) torque at joint i with some effects of bodies at work."""
        nominal = self._motion.rigid.tau[i]
        return nominal + self.added(bodies)[i] if bodies else nominal

    def added(self, bodies: Sequence[Planned]) -> np.ndarray:
        """(n, N) what effects of bodies change of the torques."""
        bodies = signal_order(bodies)
        key = tuple(e.identity for e in bodies)
        return self._added.get(key, lambda: self._evaluated(bodies), REMEMBERED)

    def _evaluated(self, bodies: Sequence[Planned]) -> np.ndarray:
        rigid, robot = self._motion.rigid, self._motion.robot
        change = np.zeros_like(rigid.tau)
        for e in bodies:
            p, torque = e.p, np.zeros_like(rigid.tau)
            if e.effect.overrides("edit_inertial") and e.joint is not None:
                i = robot.joint_names.index(e.joint)
                added = np.array(e.effect.edit_inertial(list(rigid.inertial[i]), p)) - rigid.inertial[i]
                torque = torque + rigid.regressor.torque(i, added)
            if e.effect.overrides("edit_gravity"):
                turned = np.array(e.effect.edit_gravity(list(rigid.gravity), p)) - rigid.gravity
                torque = torque + np.einsum("a,ajt->jt", turned, rigid.by_gravity)
            change = change + (torque if e.since is None else torque * e.acts(self._t))
        return change
