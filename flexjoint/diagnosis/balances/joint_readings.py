"""One joint's readings, filtered: what its torque balances begin with."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import fft

from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.diagnosis.signals.signals import Wiener
from flexjoint.effects import Signals

OCTAVE = 2.0  # factor in frequency, down and up, over which a power is averaged: gains that change faster ...
FEWEST = 9  # ... with it, or over fewer frequencies at its lower end, would reach further in time
ROUNDING = 1e-4  # of a torque: as well as filters and interpolation keep it


class JointReadings:
    """What of a joint's readings does not depend on any effect but its sensors', computed once. `true` are
    q, theta and tau_t with what sensors do taken back, where they do anything."""

    def __init__(
        self, motion: Motion, i: int, true: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    ) -> None:
        window, readings = motion.filter, motion.readings
        if true is None:
            true = motion.q[i], motion.theta[i], readings.tau_t[i]
        self.q, self.theta, self.tau_t = true
        self._window, self._drive = window, motion.robot.joints[i].drive
        self._readings, self._joint = readings, i
        self._tolerance = motion.robot.tolerance
        self._complete = not any(joint == i for _, joint in motion.missing)
        self.driven = bool(np.isfinite(readings.torque[i, 0]))
        self.torque = readings.torque[i] if self.driven else np.zeros(window.count)
        self.q_hat = window.spectrum(self.q) * window.gain
        self.theta_hat = window.spectrum(self.theta) * window.gain
        self.phi, self.phi_hat = self.theta - self.q, self.theta_hat - self.q_hat
        # what is known of the deflection beyond the two angles, whatever sensors do to these
        beyond = readings.phi[i] - (readings.theta[i] - readings.q[i])
        self._beyond = beyond if np.isfinite(beyond[0]) and np.any(beyond) else None
        if self._beyond is not None:
            self.phi += self._beyond
            self.phi_hat += window.spectrum(self._beyond) * window.gain

    @property
    def nbytes(self) -> int:
        return 12 * self.q.nbytes  # about: as many series, or spectra of as many bytes

    @cached_property
    def torque_hat(self) -> np.ndarray:
        return self._window.spectrum(self.torque) * self._window.gain

    @cached_property
    def reading(self) -> np.ndarray:
        """Spectrum of the transmission's measured torque; 0 where there is none."""
        if not np.isfinite(self.tau_t[0]):
            return np.zeros_like(self.q_hat)
        return self._window.spectrum(self.tau_t) * self._window.gain

    @cached_property
    def spring_hat(self) -> np.ndarray:
        """Spectrum of the torque of the nominal spring."""
        s = 1j * self._window.omega
        return np.asarray((self._drive.K + self._drive.D * s) * self.phi_hat)

    @cached_property
    def spring(self) -> np.ndarray:
        return np.asarray(fft.irfft(self.spring_hat, self._window.size)[: self._window.count])

    @cached_property
    def precisions(self) -> np.ndarray:
        """(3, F) one over the variance with which encoders, motor and torque sensor give the spring's torque,
        at each frequency; 0 for one that is missing. Encoders and motor give it by nominal numbers that are
        known to their tolerances: of a preload by gravity a stiffness that is 2 % off makes more of an error
        than a sensor's noise does, and than a small friction at rest is."""
        s, noise, j = 1j * self._window.omega, self._readings.noise, self._joint
        by_q, by_theta, by_sensor, by_torque = (noise[c][j] ** 2 for c in ("q", "theta", "tau_t", "torque"))
        encoders = np.abs(self._drive.K + self._drive.D * s) ** 2 * (by_q + by_theta)
        motor = by_torque + np.abs(self._drive.B * s**2 + self._drive.D_m * s) ** 2 * by_theta
        encoders += self._tolerated(self._tolerance.stiffness * self.spring_hat)
        motor += self._tolerated(self._tolerance.inertial * self.shaft_hat)
        sensor = np.full_like(encoders, by_sensor)
        # what is not noise is known to no more than rounding
        least = (ROUNDING * float(np.std(self.spring))) ** 2 + 1e-300
        known = np.array([self._complete, self.driven and self._complete, np.isfinite(self.tau_t[0])])
        return np.where(known[:, None], 1.0 / np.maximum([encoders, motor, sensor], least), 0.0)

    def _tolerated(self, error_hat: np.ndarray) -> np.ndarray:
        """(F,) variance per sample of white noise that has the mean power of an error (F,) about each
        frequency."""
        total = np.concatenate([[0.0], np.cumsum(np.abs(error_hat) ** 2)])
        places, count = np.arange(error_hat.size), error_hat.size
        low = (places / OCTAVE).astype(int)
        high = np.minimum((places * OCTAVE).astype(int) + FEWEST, count)
        return np.asarray((total[high] - total[low]) / (high - low) / self._window.count)

    def combined(
        self, spring_hat: np.ndarray, reading: np.ndarray, motor_hat: np.ndarray | None = None
    ) -> np.ndarray:
        """Spectrum of the spring's torque from its deflection, its sensor and (where it is not None) its
        motor, weighted at each frequency by their precision. Fast parts come from the deflection alone, which
        the filter rounds at a stop in the same way as the accelerations."""
        gains = self._gains[motor_hat is not None]
        if gains is None:
            return spring_hat
        spring, motor, sensor = gains
        torque = spring * spring_hat + sensor * reading
        return torque if motor_hat is None else torque + motor * motor_hat

    @cached_property
    def _gains(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(3, F) gains of deflection, motor and sensor in `combined`, without the motor and with it; None
        where only the deflection is known."""
        gains: list[np.ndarray | None] = []
        for motor in (0.0, 1.0):
            shares = self.precisions * np.array([1.0, motor, 1.0])[:, None]
            if np.any(shares[1:]):
                best = self._slow * shares / np.sum(shares, axis=0)
                best[0] += 1.0 - self._slow
                gains.append(best)
            else:
                gains.append(None)
        return gains[0], gains[1]

    @cached_property
    def _slow(self) -> np.ndarray:
        """(F,) gain of what is slower than a denoised acceleration rings."""
        ringing = self._readings.settings.balances.ringing
        return np.exp(-0.5 * (ringing * self._readings.sigma * self._window.omega) ** 2)

    @cached_property
    def shaft_hat(self) -> np.ndarray:
        """Spectrum of what the nominal motor needs for its own motion."""
        s = 1j * self._window.omega
        return np.asarray((self._drive.B * s**2 + self._drive.D_m * s) * self.theta_hat)

    @property
    def noise(self) -> Signals:
        """What a Wiener filter takes for noise in q, theta and phi, each by itself (what differs between two
        filters would be a deflection), and in their rates."""
        return self._filtered[0]

    @property
    def position_errors(self) -> dict[str, np.ndarray]:
        """(N,) [rad] what it leaves of the noise in q, theta and phi, by name."""
        return self._filtered[1]

    @cached_property
    def _filtered(self) -> tuple[Signals, dict[str, np.ndarray]]:
        """`noise` and `position_errors`, of one filter."""
        readings, smooth = self._readings, self._window.smooth
        size = {name: float(readings.noise[name][self._joint]) for name in ("q", "theta")}
        size["phi"] = float(np.hypot(size["q"], size["theta"]))
        noise, errors = {}, {}
        for name, x in {"q": self.q, "theta": self.theta, "phi": self.phi}.items():
            one = Wiener.of(x, size[name])
            noise[name], errors[name] = x - one.signal(), one.error()
        rates = {f"d{name}": smooth(x, 1) for name, x in noise.items()}
        return Signals(**noise, **rates), errors

    @cached_property
    def speed_errors(self) -> dict[str, np.ndarray]:
        """(N,) [rad/s] what is left of the noise in dq and dtheta, by name, where a Wiener filter has taken
        out what it can. An angle without a sensor is made of the other one."""
        noise = max(float(self._readings.noise[name][self._joint]) for name in ("q", "theta"))
        angles = {"dq": self.q, "dtheta": self.theta}
        return {name: Wiener.of(x, noise).speed_error(self._window) for name, x in angles.items()}

    @cached_property
    def dq(self) -> np.ndarray:
        return self._window.smooth(self.q, 1)

    @cached_property
    def dtheta(self) -> np.ndarray:
        return self._window.smooth(self.theta, 1)

    @cached_property
    def dphi(self) -> np.ndarray:
        dphi = self.dtheta - self.dq
        return dphi if self._beyond is None else dphi + self._window.smooth(self._beyond, 1)
