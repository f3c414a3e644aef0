"""A signal without its noise, by a Wiener filter that follows the signal in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp

from flexjoint.diagnosis.signals.signals import wiener

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
