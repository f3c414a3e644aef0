"""Dry friction on data: where a body slides and where it rests."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft
from scipy.ndimage import maximum_filter1d

from flexjoint.diagnosis.balances.dry_friction import DryFriction, Speed, greatest
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.signals.signals import Filter, Wiener, make_filter

RATE, SIGMA = 500.0, 0.008
T = np.arange(6000) / RATE
LEVEL = 3.0  # N m
LIMITS = USUAL.balances


def window() -> Filter:
    return make_filter(T.size, 1.0 / RATE, SIGMA)


def friction(speed: np.ndarray, net: np.ndarray, inertia: float, noise: float = 0.0) -> np.ndarray:
    """(N,) filtered dry friction of a body, from its speed and what else pulls at it, before the filter."""
    own = window()
    law = DryFriction(own, SIGMA, LIMITS)
    levels = np.full((2, T.size), LEVEL)
    moved, net = own.smooth(speed), own.smooth(net)
    known = Speed(moved, np.full(T.size, noise), np.zeros(T.size), 0.0)
    spectrum, _ = law.spectrum(levels, known, net, net, inertia)
    return np.asarray(fft.irfft(spectrum, own.size)[: own.count])


@pytest.mark.parametrize("inertia", [0.3, 30.0])
def test_what_slides_slowly_has_its_level_whatever_the_balance_asks_for(inertia: float) -> None:
    """A light body that its friction stops within the filter's width slides all the same. `net` is half of
    what the friction would have to be: the model is wrong."""
    way = np.sign(np.sin(2.0 * np.pi * T / 6.0 + 0.3))
    speed = 4.0 * LIMITS.least_rest_speed * way

    found = friction(speed, 0.5 * LEVEL * way, inertia)

    far = np.convolve(np.abs(np.gradient(way)), np.ones(61), mode="same") == 0.0  # of every reversal
    inside = far & (T > 0.5) & (T[-1] - 0.5 > T)
    np.testing.assert_allclose(found[inside], -LEVEL * way[inside], rtol=1e-3)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_what_rests_holds_what_pulls_at_it(noise: float) -> None:
    """Below the speed that its noise leaves known, and below that at which joints creep."""
    pulls = 0.8 * LEVEL * np.sin(2.0 * np.pi * 0.2 * T)
    creeps = 0.9 * max(LIMITS.least_rest_speed, LIMITS.speed_deviations * noise) * np.cos(2.0 * np.pi * T)

    found = friction(creeps, pulls, 30.0, noise)

    inside = slice(300, -300)
    np.testing.assert_allclose(found[inside], -window().smooth(pulls)[inside], atol=1e-3 * LEVEL)


@pytest.mark.parametrize("frequency", [0.3, 3.0])
def test_the_error_of_a_speed_without_its_noise_is_the_predicted_one(frequency: float) -> None:
    """Of 20 draws of noise: within 6 % at rest and in motion."""
    own, noise = window(), 2e-4
    true = 0.4 * np.sin(2.0 * np.pi * frequency * T) * (T > 6.0)
    true = np.convolve(true, np.hanning(101) / 50.0, mode="same")
    speed = own.smooth(true, 1)
    squares, predicted = np.zeros(T.size), np.zeros(T.size)
    for draw in range(20):
        filtered = Wiener.of(true + noise * np.random.default_rng(draw).standard_normal(T.size), noise)
        squares += (own.smooth(filtered.signal(), 1) - speed) ** 2 / 20
        predicted += filtered.speed_error(own) ** 2 / 20
    for part in (slice(500, 2500), slice(3600, 5500)):
        assert np.mean(squares[part]) == pytest.approx(np.mean(predicted[part]), rel=0.15)
    # while it rests, far less than the filtered speed's noise
    plain = noise * np.sqrt(np.mean((own.omega * own.gain) ** 2))
    assert np.sqrt(np.mean(predicted[500:2500])) < 0.3 * plain


def test_near_a_kink_the_measured_speed_counts_and_far_from_it_the_one_without_noise() -> None:
    speed = Speed(np.ones(3), np.full(3, 0.01), np.full(3, 0.5), 0.1)

    far, error_far = speed.beside(np.zeros(3))
    near, error_near = speed.beside(np.full(3, 1e3))

    np.testing.assert_allclose(far, 1.0)
    np.testing.assert_allclose(error_far, 0.01)
    np.testing.assert_allclose(near, 1.5)
    np.testing.assert_allclose(error_near, np.hypot(0.01, 0.1))


def test_of_speeds_with_and_without_noise_the_mean_has_the_least_square_error() -> None:
    """A kink that is lost with the noise, and the noise, are independent errors."""
    kink, noise = 0.3, 0.2
    share = np.linspace(0.0, 1.0, 1001)
    error = ((1.0 - share) * kink) ** 2 + (share * noise) ** 2

    speed, spread = Speed(np.zeros(1), np.zeros(1), np.ones(1), noise).beside(np.array([kink]))

    assert speed[0] == pytest.approx(share[np.argmin(error)], abs=1e-3)
    assert spread[0] == pytest.approx(np.sqrt(np.min(error)), rel=1e-3)


@pytest.mark.parametrize("count", [1, 2, 7, 300])
@pytest.mark.parametrize("reach", [0, 1, 3, 400])
def test_the_greatest_about_each_sample(count: int, reach: int) -> None:
    x = np.random.default_rng(count).integers(0, 9, count).astype(float)  # with equals among them

    np.testing.assert_array_equal(greatest(x, reach), maximum_filter1d(x, 2 * reach + 1))
