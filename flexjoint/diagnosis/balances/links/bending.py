"""Joints that a robot file takes as rigid and that bend under their load (`joint_compliance`).

The encoder tells where the motor is; the link lags behind it by the deflection phi. To first order in that,
about the motion that the encoders tell, with the loads' derivatives M, C and G,

    M phi'' + (C + D) phi' + (G + K) phi = load,

and the joints carry the load less M phi'' + C phi' + G phi. The torque s that the motor passes on tells the
deflection, too: s = K phi + D phi'. What the equation gives is drawn to that by a further damper, as an
observer does (Luenberger 1971): nothing is wrong by it where the numbers are right, and neither a wrong start
nor noise near the resonance swings on for long.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import fft

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.links.swinging import Swinging
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.diagnosis.signals.signals import reach_of_ends
from flexjoint.effects import Drive, Planned

REMEMBERED = 2e7  # bytes of equations


class Bending:
    """What bending joints change of the loads along one motion; n actuated joints, N samples."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._equations: LruCache[_Equations] = LruCache()

    def drives(self, effects: Sequence[Planned]) -> dict[int, Drive]:
        """The numbers of the joints that bend, by joint."""
        robot, out = self._motion.robot, {}
        for e in effects:
            if e.effect.for_rigid:
                i = robot.joint_names.index(str(e.joint))
                drive = e.effect.edit_drive(robot.joints[i].drive, e.p)
                if np.isfinite(drive.K):
                    out[i] = drive
        return out

    def change(self, drives: Mapping[int, Drive], load: np.ndarray, passed: np.ndarray) -> np.ndarray:
        """(n, N) what joints with these springs change of a load (n, N), by the spectra (k, F) of the torques
        that their motors pass on."""
        key = tuple((i, float(drive.K), float(drive.D)) for i, drive in drives.items())
        equations = self._equations.get(key, lambda: _Equations(self._motion, drives), REMEMBERED)
        # near its ends the filter distorts a motion, and a spring would swing on from that
        begin, clock = reach_of_ends(self._motion.readings), self._motion.filter
        torque = fft.irfft(passed, clock.size, axis=-1)[:, : clock.count]
        torque[:, :begin], torque[:, -begin:] = torque[:, begin, None], torque[:, -begin - 1, None]
        told = fft.irfft(clock.spectrum(torque) * equations.told, clock.size, axis=-1)[:, : clock.count]
        change = np.zeros_like(load)
        change[:, begin:] = equations.change(load[:, begin:], told[:, begin:])
        return change


class _Equations:
    """The equations of bending joints from the first sample that is not distorted on."""

    def __init__(self, motion: Motion, drives: Mapping[int, Drive]) -> None:
        self._bent, self._period = list(drives), motion.filter.period
        begin, rigid = reach_of_ends(motion.readings), motion.rigid
        self._gains = tuple(
            x[begin:, :, self._bent].astype(float) for x in (rigid.by_q, rigid.by_v, rigid.mass)
        )
        by_q, by_v, mass = (x[:, self._bent] for x in self._gains)
        self._K, self._D = (np.array([getattr(drive, name) for drive in drives.values()]) for name in "KD")
        inertia = np.diagonal(np.mean(mass, axis=0))
        own = np.sqrt(self._K / inertia)  # rad/s
        limits = motion.readings.settings.balances
        self._drawn = 2.0 * limits.drawn * inertia * own
        # (k, F) deflections by the torques: far above the resonance these tell their own noise
        reach = limits.drawn_band * own[:, None]
        spring = self._K[:, None] + 1j * motion.filter.omega * self._D[:, None]
        self.told = np.exp(-0.5 * (motion.filter.omega / reach) ** 2) / spring
        self._swinging = Swinging(
            mass, by_v + np.diag(self._D + self._drawn), by_q + np.diag(self._K), self._period
        )

    @property
    def nbytes(self) -> int:
        return 3 * sum(gain.nbytes for gain in self._gains)

    def change(self, load: np.ndarray, told: np.ndarray) -> np.ndarray:
        """(n, N) of a load (n, N) and of the deflections (k, N) that the motors' torques tell."""
        rates = np.gradient(told, self._period, axis=1)
        moved = self._swinging.by(
            load[self._bent] + self._drawn[:, None] * rates, np.concatenate([told[:, 0], rates[:, 0]])
        )
        change = np.zeros_like(load)
        for k, phi in enumerate(moved):
            for gain, x in zip(self._gains, (phi.q, phi.v, phi.a), strict=True):
                change -= gain[:, :, k].T * x
        return change
