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
from scipy.ndimage import maximum_filter1d

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

    def beside(self, kink: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The speed (N,) and its error where friction makes a `kink` in it, of which a Wiener filter takes up
        to all for noise: the mean of the speeds with and without noise that has the least square error."""
        if self.noise == 0.0:
            return self.clean, self.error
        share = kink**2 / (kink**2 + self.noise**2)
        return self.clean + share * self.taken, np.sqrt(self.error**2 + share * self.noise**2)


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
        changed: np.ndarray | float = limits.rest_rings * self._sigma * float(np.max(levels)) / inertia
        lost, given_back = np.zeros_like(net), None
        reach = self._within(limits.ringing)
        for further in reversed(range(FRICTION_ROUNDS)):
            filtered, error = speed.beside(changed)
            rest = np.minimum(np.maximum(changed, self.rest_speed(error)), limits.rest_speed)
            # the filtered speed must say so, too: where a body stands for longer than the filter between two
            # motions, the iteration would become unstable
            speeds = filtered[None] if given_back is None else np.array([filtered, filtered + given_back])
            ahead, back = _moving(speeds, rest)
            moving = ahead + back
            near, far_net = maximum_filter1d(moving, reach), denoised_net + lost
            sticking = np.minimum(np.maximum(far_net + near * (net + lost - far_net), least), most)
            friction = ahead * forward - back * backward + (1.0 - moving) * sticking
            spectrum = window.spectrum(friction)
            if further:
                lost, integral = fft.irfft(spectrum * self._lost, window.size)[:, : window.count]
                given_back = -integral / inertia
                if not shared:
                    changed = maximum_filter1d(np.abs(given_back), self._within(limits.rest_rings))
        return -spectrum * window.gain, (moving < 0.5) & (least < sticking) & (sticking < most)

    def _within(self, widths: float) -> int:
        """Samples about one that are no more filter deviations away."""
        return 2 * int(np.ceil(widths * self._sigma / self._window.period)) + 1


def _moving(speeds: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(2, N) share of the time about each sample in which all speeds (k, N), linear meanwhile, are above the
    `rest` speed (N,), forward and backward. A law that switched with the sample would jump with every number
    of a fit."""
    change = np.empty_like(speeds)
    np.subtract(speeds[:, 2:], speeds[:, :-2], out=change[:, 1:-1])
    change[:, 1:-1] *= 0.5
    change[:, 0], change[:, -1] = speeds[:, 1] - speeds[:, 0], speeds[:, -1] - speeds[:, -2]
    np.abs(change, out=change)
    np.maximum(change, 1e-300, out=change)
    shares = np.empty((2, *speeds.shape))
    np.subtract(speeds, rest, out=shares[0])
    np.add(speeds, rest, out=shares[1])
    np.negative(shares[1], out=shares[1])
    shares /= change
    shares += 0.5
    least = shares[:, 0] if len(speeds) == 1 else np.minimum(shares[:, 0], shares[:, 1])
    return np.minimum(np.maximum(least, 0.0, out=least), 1.0, out=least)
