"""A position that jumps between two samples and goes on as before: its reading does, no body."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.signals.reading_jumps import reading_jumps

PERIOD, COUNT, NOISE = 0.008, 1000, 1e-5
T = PERIOD * np.arange(COUNT)


def motion(seed: int, noise: float = NOISE) -> np.ndarray:
    """Three sines of up to 2 Hz, and white noise."""
    rng = np.random.default_rng(seed)
    sines = [0.5 * np.sin(2 * np.pi * rng.uniform(0.1, 2.0) * T + rng.uniform(0, 6)) for _ in range(3)]
    return sum(sines) + rng.normal(0.0, noise, COUNT)


def found(x: np.ndarray) -> list[int]:
    return reading_jumps(x, USUAL.signals)


@given(
    st.integers(0, 10_000),
    st.integers(10, COUNT - 12),
    st.floats(0.03, 1.0),
    st.sampled_from((-1.0, 1.0)),
)
def test_a_jump_is_found_where_it_is(seed: int, at: int, size: float, sign: float) -> None:
    """Three sines at 2 Hz take parabolas from both sides apart by 0.625 h^3 times their third derivative, by
    up to 1e-3 rad, and the jump that is taken out is off by as much: samples beside it are off by 3e-3 rad,
    a tenth of the smallest jump here."""
    x = motion(seed)
    x[at + 1 :] += sign * size
    assert found(x) == [at]


@pytest.mark.parametrize("seed", range(20))
def test_no_motion_and_no_noise_is_a_jump(seed: int) -> None:
    assert found(motion(seed)) == []
    assert found(motion(seed, 1e-3)) == []
    assert found(np.round(motion(seed, 0.0) / 1e-3) * 1e-3) == []


def test_a_body_that_is_hit_does_not_jump() -> None:
    """It moves on at another speed."""
    hit = motion(1) + np.where(T > 4.0, 2.0 * (T - 4.0), 0.0)
    assert found(hit) == []


def test_a_single_reading_that_failed_is_no_jump() -> None:
    x = motion(2)
    x[500] += 0.1
    assert found(x) == []


def test_short_or_missing_readings_show_none() -> None:
    assert found(np.full(COUNT, np.nan)) == [] and found(T[:5]) == []
