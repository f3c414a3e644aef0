"""Dry friction on data: a set-valued law, where a body's speed and what pulls at it are measured.

In motion it is level sgn(speed). At rest it equals the torque that pulls at the body, which follows from the
balance itself, within the levels of both directions. That torque is taken from the denoised recording, as a
friction holds a body and not the sensors' noise, except near the times at which the body stops or breaks
loose.
"""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.ndimage import maximum_filter1d

from flexjoint.diagnosis.settings import BalanceSettings
from flexjoint.diagnosis.signals.signals import Filter

FRICTION_ROUNDS = 4


class DryFriction:
    """Dry friction behind one filter, of standard deviation `sigma` [s]."""

    def __init__(self, window: Filter, sigma: float, settings: BalanceSettings) -> None:
        self._window, self._sigma, self.settings = window, sigma, settings
        jomega = 1j * window.omega
        # noise of a filtered speed, per unit of white noise in the position
        self._speed_noise = float(np.sqrt(np.mean((window.omega * window.gain) ** 2)))
        # what the filter takes away, and its integral: (2, F), as two transforms at once take little longer
        lost, nothing = 1.0 - window.gain, np.zeros_like(jomega)
        self._lost = np.array([lost, np.divide(lost, jomega, out=nothing, where=window.omega > 0)])

    def rest_speed(self, levels: np.ndarray, inertia: float, noise: float) -> float:
        """[rad/s] below which a filtered speed's sign does not tell where a body goes, from the friction's
        levels, the body's inertia and the noise of its position; in half octaves, so that a fit of the
        level does not move it."""
        rings = self.settings.rest_rings * self._sigma * float(np.max(levels)) / inertia
        least = max(
            self.settings.least_rest_speed,
            rings,
            self.settings.speed_deviations * noise * self._speed_noise,
            1e-6,
        )
        most = self.settings.rest_speed
        return float(most * 2.0 ** min(0.0, 0.5 * np.ceil(2.0 * np.log2(least / most))))

    def spectrum(
        self,
        levels: np.ndarray,
        speed: np.ndarray,
        net: np.ndarray,
        denoised_net: np.ndarray,
        inertia: float,
        rest: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(F,) spectrum of the filtered friction torque, from its levels (2, N) backward and forward, and
        series (N,): the body's filtered speed, and what else pulls at it, as measured and without noise;
        below the `rest` speed it stands. And where it sticks (N,), bool.

        The filter rounds the kinks that friction itself makes in speed and net torque; what it takes away,
        (1 - F) friction, is known from the friction and given back, a few rounds until they agree.
        """
        window = self._window
        if float(np.std(net - denoised_net)) > self.settings.noisy_friction * float(np.max(levels)):
            net = denoised_net
        backward, forward = levels
        most_at_rest = self.settings.most_at_rest
        least, most = -most_at_rest * backward, most_at_rest * forward
        sharp_speed, sharp_net, lost = speed, net, np.zeros_like(net)
        filtered = _moving(speed, rest)
        reach = 2 * int(np.ceil(self.settings.ringing * self._sigma / window.period)) + 1
        for further in reversed(range(FRICTION_ROUNDS)):
            # the filtered speed must say so, too: where a body stands for longer than the filter between two
            # motions, the iteration would become unstable
            ahead, back = np.minimum(_moving(sharp_speed, rest), filtered)
            moving = ahead + back
            near, far_net = maximum_filter1d(moving, reach), denoised_net + lost
            sticking = np.clip(far_net + near * (sharp_net - far_net), least, most)
            friction = ahead * forward - back * backward + (1.0 - moving) * sticking
            spectrum = window.spectrum(friction)
            if further:
                lost, integral = fft.irfft(spectrum * self._lost, window.size)[:, : window.count]
                sharp_net = net + lost
                sharp_speed = speed - integral / inertia
        return -spectrum * window.gain, (moving < 0.5) & (least < sticking) & (sticking < most)


def _moving(speed: np.ndarray, rest: float) -> np.ndarray:
    """(2, N) share of the time about each sample in which a speed (N,), linear meanwhile, is above the `rest`
    speed, forward and backward. A law that switched with the sample would jump with every number of a fit."""
    change = np.empty_like(speed)
    change[1:-1] = 0.5 * np.abs(speed[2:] - speed[:-2])
    change[0], change[-1] = np.abs(speed[1] - speed[0]), np.abs(speed[-1] - speed[-2])
    shares = np.array([speed - rest, -speed - rest]) / np.maximum(change, 1e-300) + 0.5
    return np.minimum(np.maximum(shares, 0.0, out=shares), 1.0, out=shares)
