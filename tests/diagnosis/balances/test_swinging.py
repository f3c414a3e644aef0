"""Links that swing on springs, against closed forms of a link with one mass, damper and spring."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flexjoint.diagnosis.balances.links.swinging import Swinging

MASS, DAMPING, FREQUENCY = 0.3, 0.4, 40.0  # kg m^2, N m s/rad, rad/s
STIFFNESS = MASS * FREQUENCY**2


def of_one_link(time: np.ndarray, mass: float = MASS, stiffness: float = STIFFNESS) -> Swinging:
    matrices = (np.full((time.size, 1, 1), x) for x in (mass, DAMPING, stiffness))
    return Swinging(*matrices, float(time[1] - time[0]))


def times(period: float) -> np.ndarray:
    return np.arange(0.0, 2.0 + 0.5 * period, period)


def error_of_a_free_swing(period: float) -> float:
    t = times(period)
    (found,) = of_one_link(t).by(np.zeros((1, t.size)), np.array([0.1, 0.0]))
    rate = DAMPING / (2.0 * MASS)
    own = np.sqrt(FREQUENCY**2 - rate**2)
    exact = 0.1 * np.exp(-rate * t) * (np.cos(own * t) + rate / own * np.sin(own * t))
    return float(np.max(np.abs(found.q - exact)))


def error_of_a_forced_swing(period: float) -> float:
    """From the state of the forced motion, so that nothing else swings."""
    t, driven = times(period), 25.0
    response = 1.0 / (STIFFNESS - MASS * driven**2 + 1j * driven * DAMPING)
    exact = np.imag(response * np.exp(1j * driven * t))
    start = np.array([exact[0], np.imag(1j * driven * response)])
    (found,) = of_one_link(t).by(np.sin(driven * t)[None], start)
    return float(np.max(np.abs(found.q - exact)) / np.abs(response))


@pytest.mark.parametrize("error", [error_of_a_free_swing, error_of_a_forced_swing])
def test_steps_are_of_fourth_order(error: Callable[[float], float]) -> None:
    coarse, fine = error(0.004), error(0.002)
    assert 14.0 < coarse / fine < 18.0  # 2^4, and terms of higher order


def test_a_swing_of_a_tenth_of_the_rate_keeps_its_frequency() -> None:
    """The trapezoidal rule would be out of phase by 2.5 rad after these 2 s."""
    period = 2.0 * np.pi / FREQUENCY / 10.0
    assert error_of_a_free_swing(period) < 0.02 * 0.1


@pytest.mark.parametrize("factor", [1e2, 1e4, 1e8])
def test_a_link_on_a_stiff_spring_follows_its_torque(factor: float) -> None:
    """Whose swing the samples do not resolve: it neither lags behind nor swings on in the band of signals."""
    t = times(0.004)
    torque = np.sin(5.0 * t) * (1.0 - np.exp(-5.0 * t))
    stiffness = factor * STIFFNESS
    (found,) = of_one_link(t, stiffness=stiffness).by(torque[None])
    # of the torque: the mass, below the resonance, and the step of the slope at the start
    assert np.max(np.abs(found.q * stiffness - torque)) < 0.02


@pytest.mark.parametrize("ratio", [1e-3, 0.1, 0.5, 0.6, 0.64, 0.68, 0.7, 0.75, 0.9, 1.0, 3.0, 1e3])
def test_no_step_enlarges_a_damped_swing(ratio: float) -> None:
    """Of any frequency: a rule that fades with the fourth power of complex rates has a pole near some."""
    period = 0.005
    for own in np.geomspace(0.01, 100.0, 200) / period:
        mass, damping, stiffness = (np.full((2, 1, 1), x) for x in (1.0, 2.0 * ratio * own, own**2))
        start = np.eye(2)
        after = [Swinging(mass, damping, stiffness, period).by(np.zeros((1, 2)), x) for x in start]
        step = np.array([[one.q[1], one.v[1]] for (one,) in after]).T
        assert np.max(np.abs(np.linalg.eigvals(step))) <= 1.0


def test_from_rest_where_the_spring_carries_it() -> None:
    t = times(0.004)
    (found,) = of_one_link(t).by(np.full((1, t.size), 2.0))
    assert found.q == pytest.approx(np.full(t.size, 2.0 / STIFFNESS), rel=1e-9)
    assert np.max(np.abs(found.a)) < 1e-8
