"""Dry friction on data: a set-valued law, where a body's speed and what pulls at it are measured.

In motion it is level sgn(speed). At rest it equals the torque that pulls at the body, which follows from the
balance itself, within the levels of both directions. That torque is taken from the denoised recording, as a
friction holds a body and not the sensors' noise, except near the times at which the body stops or breaks
loose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from flexjoint.core.compiled import compiled
from flexjoint.diagnosis.settings import BalanceSettings
from flexjoint.diagnosis.signals.signals import Filter

FRICTION_ROUNDS = 4


@dataclass(frozen=True)
class Speed:
    """The filtered speed of what rubs, (N,) each [rad/s]."""

    clean: np.ndarray  # without its sensor's noise, as far as that is known
    error: np.ndarray  # its standard deviation
    taken: np.ndarray  # what was taken out as noise
    noise: float  # standard deviation of the speed's noise, where some was taken out

    @staticmethod
    def combined(parts: Sequence[tuple[float, Speed]]) -> Speed:
        """The weighted sum of speeds with independent noise."""
        return Speed(
            np.asarray(sum(x * s.clean for x, s in parts)),
            np.sqrt(sum((x * s.error) ** 2 for x, s in parts)),
            np.asarray(sum(x * s.taken for x, s in parts)),
            float(np.sqrt(sum((x * s.noise) ** 2 for x, s in parts))),
        )

    def beside(self, kink: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The speed (N,) and its error where friction makes a `kink` (N,) in it, of which a Wiener filter
        takes up to all for noise: the mean of the speeds with and without noise that has the least square
        error."""
        return _beside(self.clean, self.error, self.taken, self.noise, kink)


class DryFriction:
    """Dry friction behind one filter, of standard deviation `sigma` [s]."""

    def __init__(self, window: Filter, sigma: float, settings: BalanceSettings) -> None:
        self._window, self._sigma, self.settings = window, sigma, settings
        jomega = 1j * window.omega
        # noise of a filtered speed, per unit of white noise in the position
        self.speed_noise = float(np.sqrt(np.mean((window.omega * window.gain) ** 2)))
        # what the filter takes away, and its integral: (2, F), as two transforms at once take little longer
        lost, nothing = 1.0 - window.gain, np.zeros_like(jomega)
        self._lost = np.array([lost, np.divide(lost, jomega, out=nothing, where=window.omega > 0)])

    def rest_speed(self, noise: np.ndarray) -> np.ndarray:
        """(N,) [rad/s] below which the sign of a speed does not tell where a body goes, from the noise (N,)
        of the speed."""
        limits = self.settings
        least = np.maximum(max(limits.least_rest_speed, 1e-6), limits.speed_deviations * noise)
        return np.minimum(least, limits.rest_speed)

    def spectrum(
        self,
        levels: np.ndarray,
        speed: Speed,
        net: np.ndarray,
        denoised_net: np.ndarray,
        inertia: float,
        shared: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(F,) spectrum of the filtered friction torque, from its levels (2, N) backward and forward, the
        body's speed, and (N,) what else pulls at it, as measured and without noise. And where it sticks (N,),
        bool. What several joints share stands already at a speed that it stops within the filter: how it
        creeps, no joint's torque tells.

        The filter rounds the kinks that friction itself makes in speed and net torque; what it takes away,
        (1 - F) friction, is known from the friction and given back, a few rounds until they agree. Where that
        changes the speed, it is known no better.
        """
        window, limits = self._window, self.settings
        if float(np.std(net - denoised_net)) > limits.noisy_friction * float(np.max(levels)):
            net = denoised_net
        backward, forward = levels
        least, most = -limits.most_at_rest * backward, limits.most_at_rest * forward
        kink = limits.rest_rings * self._sigma * float(np.max(levels)) / inertia
        lost, given_back, changed = np.zeros_like(net), np.zeros_like(net), np.full_like(net, kink)
        for further in reversed(range(FRICTION_ROUNDS)):
            filtered, error = speed.beside(changed)
            rest = np.minimum(np.maximum(changed, self.rest_speed(error)), limits.rest_speed)
            moving, sticking, friction = _round(
                (filtered, filtered + given_back),
                rest,
                (backward, forward, least, most),
                (net, denoised_net, lost),
                self._reach(limits.ringing),
            )
            spectrum = window.spectrum(friction)
            if further:
                lost, integral = fft.irfft(spectrum * self._lost, window.size)[:, : window.count]
                given_back = -integral / inertia
                if not shared:
                    changed = greatest(np.abs(given_back), self._reach(limits.rest_rings))
        return -spectrum * window.gain, (moving < 0.5) & (least < sticking) & (sticking < most)

    def _reach(self, widths: float) -> int:
        """Samples that lie within so many filter deviations."""
        return int(np.ceil(widths * self._sigma / self._window.period))


@compiled
def _round(
    speeds: tuple[np.ndarray, np.ndarray],
    rest: np.ndarray,
    levels: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    pulls: tuple[np.ndarray, np.ndarray, np.ndarray],
    reach: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One round of `DryFriction.spectrum`: (N,) share of the time about each sample in which the body moves,
    the torque that would hold it, and the friction.

    speeds (N,): the filtered one, and with what the filter took away of it. Both must say that it moves:
    where a body stands for longer than the filter between two motions, the iteration would become unstable.
    rest (N,): the speed below which it stands; levels (N,): backward, forward, least and most at rest; pulls
    (N,): as measured, without noise, and what the filter took away of friction; reach: samples.
    """
    filtered, given = speeds
    backward, forward, least, most = levels
    net, denoised_net, lost = pulls
    count = filtered.size
    ahead, back, moving = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        # speeds are linear between samples: a law that switched with the sample would jump with every number
        # of a fit
        before, after = max(k - 1, 0), min(k + 1, count - 1)
        part = 1.0 if after - before == 1 else 0.5
        change = max(abs((filtered[after] - filtered[before]) * part), 1e-300)
        change_given = max(abs((given[after] - given[before]) * part), 1e-300)
        up = min((filtered[k] - rest[k]) / change + 0.5, (given[k] - rest[k]) / change_given + 0.5)
        down = min(-(filtered[k] + rest[k]) / change + 0.5, -(given[k] + rest[k]) / change_given + 0.5)
        ahead[k], back[k] = min(max(up, 0.0), 1.0), min(max(down, 0.0), 1.0)
        moving[k] = ahead[k] + back[k]
    near = greatest(moving, reach)
    sticking, friction = np.empty(count), np.empty(count)
    for k in range(count):
        far = denoised_net[k] + lost[k]
        sticking[k] = min(max(far + near[k] * (net[k] + lost[k] - far), least[k]), most[k])
        friction[k] = ahead[k] * forward[k] - back[k] * backward[k] + (1.0 - moving[k]) * sticking[k]
    return moving, sticking, friction


@compiled
def _beside(
    clean: np.ndarray, error: np.ndarray, taken: np.ndarray, noise: float, kink: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`Speed.beside`."""
    if noise == 0.0:
        return clean, error
    speed, off = np.empty(clean.size), np.empty(clean.size)
    for k in range(clean.size):
        share = kink[k] ** 2 / (kink[k] ** 2 + noise**2)
        speed[k] = clean[k] + share * taken[k]
        off[k] = np.sqrt(error[k] ** 2 + share * noise**2)
    return speed, off


@compiled
def greatest(x: np.ndarray, reach: int) -> np.ndarray:
    """(N,) the greatest of each sample of x (N,) and those up to `reach` samples beside it."""
    count = x.size
    out, falling = np.empty(count), np.empty(count, dtype=np.int64)
    first, last, ahead = 0, 0, 0  # of `falling`: samples from here on that a later one does not exceed
    for k in range(count):
        while ahead < min(count, k + reach + 1):
            while last > first and x[falling[last - 1]] <= x[ahead]:
                last -= 1
            falling[last] = ahead
            last += 1
            ahead += 1
        if falling[first] < k - reach:
            first += 1
        out[k] = x[falling[first]]
    return out
