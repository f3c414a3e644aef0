"""Motors that turn with several joints, in the balances: what of their torques acts at each joint.

A shaft turns by m = n theta and acts at the joints by n (`flexjoint.model.shafts`). Balances stay at the
joints: those of the motors, N^-T times these, are the same equations. A joint's chain has what its shafts
give: their inertia and damping, the laws on them, what effects of the command change, and their dry friction.
Where a shaft stands, that friction is what else pulls at it: of a motor its own share of the joints' torques,
of another shaft what fits them best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.dry_friction import Speed
from flexjoint.diagnosis.balances.laws import Laws
from flexjoint.diagnosis.balances.ties import Turning
from flexjoint.effects import Planned, Signals, Site

REMEMBERED = 2e7  # bytes of spectra of shafts
Pulling = Callable[[int, Sequence[Planned], np.ndarray, np.ndarray], np.ndarray]
KINEMATIC = ("q", "dq", "theta", "dtheta", "phi", "dphi")


class Shafts:
    """Torques of shafts along one motion, remembered by the effects on their joints."""

    def __init__(self, laws: Laws, pulling: Pulling) -> None:
        """`pulling` gives (2, N) what pulls at a joint beside dry friction, with a torque (N,) and a spectrum
        (F,) added, as recorded and without noise."""
        self._laws, self._pulling = laws, pulling
        self._recent: LruCache[np.ndarray] = LruCache()

    def torque(self, i: int, effects: Sequence[Planned]) -> np.ndarray | None:
        """(F,) filtered torque of shafts at joint i, with the effects of all joints tied to it; None where it
        is tied to none."""
        joints = self._laws.ties.mates(effects).get(i)
        if joints is None:
            return None
        total = np.zeros(self._laws.jomega.size, dtype=complex)
        for shaft in self._laws.ties.shafts(joints, effects):
            if shaft.turns.get(i, 0.0) != 0.0:
                total = total + shaft.turns[i] * self._of(shaft, joints, effects)
        return total

    def _of(self, shaft: Turning, joints: frozenset[int], effects: Sequence[Planned]) -> np.ndarray:
        """(F,) torque of a shaft at its own position."""
        of = {j: self._laws.signals(j, effects) for j in joints}
        s = _combined(shaft, of)
        out = self._laws.along(shaft.laws, s) + np.zeros(self._laws.jomega.size, dtype=complex)
        if shaft.takes:
            out = out + self._driven(shaft, s, effects)
        return np.asarray(out + self._friction(shaft, joints, effects))

    def _friction(self, shaft: Turning, joints: frozenset[int], effects: Sequence[Planned]) -> np.ndarray:
        """(F,) dry friction of a shaft."""
        if not any(e.effect.overrides("level") for e in shaft.laws):
            return np.zeros(self._laws.jomega.size, dtype=complex)
        key = (shaft.joint, *(e.identity for e in shaft.laws), "of", *(e.identity for e in effects))
        return self._recent.get(key, lambda: self._rubbing(shaft, joints, effects), REMEMBERED)

    def _driven(self, shaft: Turning, s: Signals, effects: Sequence[Planned]) -> np.ndarray:
        """Spectrum of what a motor's own inertia and damping take, and of what effects of its command
        change."""
        along = self._laws
        theta_hat = sum(
            n * along.readings(j, along.sensors(j, effects)).theta_hat for j, n in shaft.turns.items()
        )
        out = -along.shaft_taken(along.motion.robot.joints[shaft.joint].drive, shaft.laws, theta_hat)
        commands = [e for e in shaft.laws if e.effect.site is Site.COMMAND]
        if commands:
            raw = np.asarray(s.tau_m)
            out = out + along.filtered(along.commanded(commands, raw, s) - raw)
        return np.asarray(out)

    def _rubbing(self, shaft: Turning, joints: frozenset[int], effects: Sequence[Planned]) -> np.ndarray:
        """The same, evaluated. What holds where several stand is told one after the other: shafts before this
        one have taken theirs, of others and of the joints' own frictions only that is known which slides."""
        along = self._laws
        of = {j: along.signals(j, effects) for j in joints}
        s = _combined(shaft, of)
        dry = [e for e in shaft.laws if e.effect.overrides("level")]
        every = self._laws.ties.shafts(joints, effects)
        place = next(k for k, other in enumerate(every) if _same(other, shaft))
        pulled = np.zeros((2, along.filter.count))
        for j, share in shaft.projection.items():
            if not along.base(j).driven:
                continue
            sliding, taken = np.zeros(along.filter.count), np.zeros(along.jomega.size, dtype=complex)
            own = along.dry_of(j, effects)
            if own:
                sliding = sliding + along.sliding(own, of[j])
            for k, other in enumerate(every):
                if k < place:
                    taken = taken + other.turns.get(j, 0.0) * self._friction(other, joints, effects)
                elif k > place and j in other.turns:
                    sliding = sliding + other.turns[j] * along.sliding(other.laws, _combined(other, of))
            pulled = pulled + share * self._pulling(j, effects, sliding, taken)
        tied = sorted(joints)
        n = np.array([shaft.turns.get(j, 0.0) for j in tied])
        inertia = 1.0 / float(n @ np.linalg.solve(along.inertias(tied, effects), n))
        speed = Speed.combined([(x, along.speed(j, "dtheta", of[j])) for j, x in shaft.turns.items()])
        shared = bool(np.count_nonzero(n) > 1)
        spectrum, _ = along.rubbing(dry, s, speed, pulled[0], pulled[1], inertia, shared)
        return spectrum


def _same(one: Turning, other: Turning) -> bool:
    return (one.joint, one.takes, one.laws) == (other.joint, other.takes, other.laws)


def _combined(shaft: Turning, of: Mapping[int, Signals]) -> Signals:
    """What the laws of a shaft see."""
    own = of[shaft.joint]
    s = Signals(
        own.t, tau_t=own.tau_t, tau_m=own.tau_m, tau_m_before=own.tau_m_before, tau_m_after=own.tau_m_after
    )
    for name in KINEMATIC:
        setattr(s, name, sum(n * getattr(of[j], name) for j, n in shaft.turns.items()))
    for name in ("tau_t", "tau_m") if shaft.takes else ():
        setattr(s, name, sum(n * getattr(of[j], name) for j, n in shaft.takes.items()))
    return s
