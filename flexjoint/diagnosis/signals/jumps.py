"""The unknown torque of a motor between two samples, where it jumps.

A controller that reverses a torque at its limit may do so at any tick between two recorded ones. The tick is
not recorded, so the impulse of the torque is wrong by up to the jump times a part of the period. This is no
sensor noise, and it does not have the same size at all times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.settings import SignalSettings
from flexjoint.diagnosis.signals.signals import Readings
from flexjoint.recording.noise import step_of, usual_noise

# a parabola through three samples, half a period and a period beyond the last of them
HALF_AHEAD, ONE_AHEAD = np.array([1.875, -1.25, 0.375]), np.array([3.0, -3.0, 1.0])
FEWEST = 6  # samples, from which a jump can be found


@dataclass(frozen=True)
class Unknown:
    """What is not known of a joint's torque between samples: pairs of torques at `when` (m,) and the sample
    behind it, (m, 2) [N m], and which of them (m, k) its k numbers are made of."""

    joint: int
    when: np.ndarray
    pairs: np.ndarray
    axes: np.ndarray

    def torque(self, numbers: np.ndarray, count: int) -> np.ndarray:
        """(count,) torque [N m] of some numbers (k,)."""
        out = np.zeros(count)
        weighted = (self.axes @ numbers)[:, None] * self.pairs
        for behind in range(2):
            np.add.at(out, self.when + behind, weighted[:, behind])
        return out


def jumps(readings: Readings) -> np.ndarray:
    """(n, N) size [N m] of each motor's torque jump between a sample and the next, 0 where it changes
    smoothly or its noise might have made it."""
    out = np.zeros_like(readings.torque)
    for i, torque in enumerate(readings.torque):
        if np.isfinite(torque[0]) and torque.size >= FEWEST:
            size = _sizes(torque)
            least = readings.settings.signals.sure_jump * _noise(torque, readings.settings.signals)
            out[i] = np.where(size > least * np.linalg.norm(ONE_AHEAD), size, 0.0)
    return out


def _noise(torque: np.ndarray, settings: SignalSettings) -> float:
    """[N m] of a torque. Where it has few levels only, its steps count as jumps, not as noise."""
    step = step_of(torque)
    return max(
        usual_noise(torque), step / np.sqrt(12.0) if np.ptp(torque) > settings.sensor_levels * step else 0.0
    )


def unknown_shapes(readings: Readings, i: int, rate: float) -> np.ndarray:
    """(2, 2) what is not known of a unit jump of joint i's torque, as torques at the sample before it and the
    one behind it, one standard deviation each: the impulse that it gives, and about when. A command changes
    at the controller's ticks of this rate [Hz], any of them alike, a measured torque at any time."""
    ticks = max(1.0, readings.period * rate) if readings.commanded[i] else np.inf
    # a jump that comes a share u of a period after the middle, u within one half, gives u too little, with
    # its centre at u / 2
    square = (1.0 - 1.0 / ticks**2) / 12.0  # mean of u^2
    fourth = square * max(0.0, 3.0 - 7.0 / ticks**2) / 20.0
    return np.array([[0.5, 0.5], [-0.5, 0.5]]) * np.sqrt([[square], [fourth]])


def _sizes(torque: np.ndarray) -> np.ndarray:
    """(N,) size of the jump between a sample and the next: by how much the predictions from both sides differ
    half-way, or by how much a sample in the middle of a jump differs from both."""
    out, apart = np.zeros_like(torque), np.abs(half_way_apart(torque))
    ahead, behind = _predicted(torque, ONE_AHEAD), _predicted(torque[::-1], ONE_AHEAD)[::-1]
    astray = np.zeros_like(torque)
    astray[1:-1] = np.minimum(np.abs(torque[1:-1] - ahead[:-2]), np.abs(torque[1:-1] - behind[2:]))
    unsure = np.maximum(apart, np.maximum(astray[:-1], astray[1:]))
    out[:-1] = np.minimum(unsure, np.abs(np.diff(torque)))
    return out


def half_way_apart(x: np.ndarray) -> np.ndarray:
    """(N - 1,) by how much a signal (N,) is higher half-way to the next sample as the three samples from
    there on predict it, than as the three up to here do."""
    return np.asarray(_predicted(x[::-1], HALF_AHEAD)[::-1][1:] - _predicted(x, HALF_AHEAD)[:-1])


def _predicted(x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(N,) the sample that a parabola through three samples predicts; the sample itself where there are no
    three."""
    out = x.copy()
    out[2:] = weights[0] * x[2:] + weights[1] * x[1:-1] + weights[2] * x[:-2]
    return out
