"""A signal without its noise, by a Wiener filter that follows the signal in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp

from flexjoint.diagnosis.signals.signals import Readings, denoised, wiener
from flexjoint.recording.table import make

RATE = 250.0
T = np.arange(1500) / RATE
NOISE = 1e-5
MOTIONS = {
    "slow": 0.3 * np.sin(2.0 * np.pi * 0.4 * T),
    "fast at the end only": 0.05 * chirp(T, 0.2, T[-1], 10.0, method="logarithmic"),
    "a step": 0.2 / (1.0 + np.exp(-25.0 * (T - 3.0))),
    "rests": np.full(T.size, 0.7),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_it_is_nearer_to_the_motion_than_the_readings_are_throughout(motion: str) -> None:
    """A filter that is the same at all times would take away what is fast for a while only."""
    true = MOTIONS[motion]
    noise = NOISE * np.random.default_rng(3).standard_normal(true.size)

    error = wiener(true + noise, NOISE) - true

    for part in np.array_split(np.arange(true.size), 10):
        assert np.std(error[part]) < np.std(noise[part])
    assert np.std(error) < 0.6 * np.std(noise)


def test_noise_alone_is_mostly_taken_away() -> None:
    noise = np.random.default_rng(4).standard_normal(4000)

    assert np.std(wiener(noise, 1.0)) < 0.3


def test_what_has_no_noise_stays_as_it_is() -> None:
    true = MOTIONS["fast at the end only"]

    assert np.allclose(wiener(true, 0.0), true, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("count", [40, 511, 512, 513])
def test_short_recordings_keep_their_length(count: int) -> None:
    assert wiener(T[:count], 1e-3).shape == (count,)


def test_a_small_deflection_has_less_noise_than_the_difference_of_two_angles() -> None:
    """A stiff spring's deflection seen by its noise would look softer than it is: the more of the motion's
    frequencies two angles keep, the more of their noise is between them."""
    rng, channels = np.random.default_rng(5), ("q", "theta", "tau_t", "torque")
    motion = np.sum([1e-3 * np.sin(2.0 * np.pi * f * T + f) for f in range(1, 40)], axis=0)
    deflection = 2.0 * NOISE * np.sin(2.0 * np.pi * 0.7 * T)
    angles = np.array([motion, motion + deflection]) + NOISE * rng.standard_normal((2, T.size))
    q, theta, absent = angles[:1], angles[1:], np.full((1, T.size), np.nan)
    readings = Readings(
        T, q, theta, theta - q, absent, absent,
        commanded=np.zeros(1, dtype=bool), feedback=np.zeros(1), valid=np.ones(T.size, dtype=bool),
        noise={name: np.full(1, NOISE) for name in channels}, steps={name: np.zeros(1) for name in channels},
        sigma=2.0 / RATE, start=0.0, recording=make(T, {("q", "joint"): q[0]}),
    )  # fmt: skip

    clean = denoised(readings)

    assert np.std(clean.phi[0] - deflection) < 0.5 * np.std(clean.theta[0] - clean.q[0] - deflection)
