"""Standard errors beside numbers that are at a bound."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexjoint.diagnosis.regression.uncertainty import beside_bounds


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=2, max_size=6))
def test_the_others_have_the_errors_of_a_fit_in_which_numbers_at_bounds_are_given(
    seed: int, at: list[bool]
) -> None:
    rng, held = np.random.default_rng(seed), np.array(at)
    root, units = rng.normal(size=(len(at) + 3, len(at))), 10.0 ** rng.uniform(-3, 3, len(at))
    curvature = root.T @ root
    spread = beside_bounds(np.linalg.inv(curvature) * np.outer(units, units), held) / np.outer(units, units)
    free = np.ix_(~held, ~held)
    assert spread[free] == pytest.approx(np.linalg.inv(curvature[free]), rel=1e-6, abs=1e-9)
    for k in np.flatnonzero(held):
        alone = ~held
        alone[k] = True
        own = np.linalg.inv(curvature[np.ix_(alone, alone)])[np.sum(alone[:k]), np.sum(alone[:k])]
        assert spread[k, k] == pytest.approx(own, rel=1e-6)


def test_one_of_two_numbers_of_one_thing_leaves_the_other_certain_at_its_bound() -> None:
    """Two levels of one friction: their sum is known to 0.01, each of them to 6."""
    total, apart = 0.01**2, 6.0**2
    spread = np.array([[apart, total / 2 - apart], [total / 2 - apart, apart]])
    out = beside_bounds(spread, np.array([False, True]))
    assert np.sqrt(out[0, 0]) == pytest.approx(0.01, rel=1e-3)
    assert np.sqrt(out[1, 1]) == pytest.approx(6.0)  # nothing else is at a bound
    assert out[0, 1] == 0.0
    assert np.array_equal(beside_bounds(spread, np.zeros(2, bool)), spread)
