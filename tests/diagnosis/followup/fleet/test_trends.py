"""Change points and drifts of numbers over time: found when they are there, rarely when not, and not for a
warm day."""

from __future__ import annotations

import numpy as np
import pytest

from flexjoint.diagnosis.followup.fleet.trends import DAY, Change, change
from flexjoint.diagnosis.settings import FleetSettings

SETTINGS = FleetSettings()
WEEKS = np.arange(12) * 7.0 * DAY
NONE = np.full(WEEKS.size, np.nan)


def found(values: np.ndarray, temperature: np.ndarray = NONE, std: float = 0.02) -> Change:
    one = change(WEEKS, values, np.full(values.size, std), temperature, SETTINGS)
    assert one is not None
    return one


def test_a_step_is_found_when_it_was() -> None:
    rng = np.random.default_rng(1)
    values = 1.0 + 0.02 * rng.standard_normal(12) + 0.3 * (np.arange(12) >= 7)
    one = found(values)
    assert one.kind == "step" and one.chance < 1e-4
    assert one.since == WEEKS[7] and one.points == (WEEKS[7],)
    # means of seven and of five values with an error of 0.02
    assert one.was == pytest.approx(1.0, abs=0.03) and one.now == pytest.approx(1.3, abs=0.03)


def test_a_drift_is_found() -> None:
    rng = np.random.default_rng(2)
    one = found(1.0 + 0.02 * rng.standard_normal(12) + 0.02 * np.arange(12))
    assert one.chance < 1e-3 and one.now - one.was > 0.1


def test_a_machine_that_stays_rarely_changes() -> None:
    """Of 200, at a chance of 1 %, two; more than 8 would have a probability of 0.02 %."""
    rng = np.random.default_rng(3)
    chances = [found(1.0 + 0.02 * rng.standard_normal(12)).chance for _ in range(200)]
    assert sum(chance < 0.01 for chance in chances) <= 8


def test_what_the_temperature_does_is_no_wear_and_wear_shows_beside_it() -> None:
    rng = np.random.default_rng(4)
    warmth = rng.uniform(15.0, 35.0, 12)
    heated = 1.0 - 0.02 * (warmth - 25.0) + 0.01 * rng.standard_normal(12)
    calm = found(heated, warmth)
    assert calm.chance > SETTINGS.false_alarms and calm.kind == "none"
    # the law is told of a machine that stays, too: an error of 0.01 over 12 values that spread by 6 deg C
    assert calm.per_degree_error == pytest.approx(0.01 / np.sqrt(12) / np.std(warmth), rel=0.6)
    assert abs(calm.per_degree + 0.02) < 4.0 * calm.per_degree_error
    worn = found(heated + 0.3 * (np.arange(12) >= 6), warmth)
    assert worn.chance < 1e-3 and worn.since == WEEKS[6]
    assert worn.per_degree == pytest.approx(-0.02, abs=0.004)  # four errors of a slope over 12 values


def test_a_drift_on_warm_and_cold_days_has_both_slopes() -> None:
    rng = np.random.default_rng(5)
    warmth = rng.uniform(15.0, 35.0, 12)
    one = found(1.0 - 0.02 * (warmth - 25.0) + 0.004 * np.arange(12), warmth)
    assert one.chance < 1e-6 and one.now - one.was == pytest.approx(0.044, rel=1e-6)
    assert one.per_degree == pytest.approx(-0.02, rel=1e-6)
    cold = found(1.0 + 0.02 * rng.standard_normal(12))
    assert (cold.per_degree, cold.per_degree_error, cold.warm) == (0.0, 0.0, False)


def test_too_few_recordings_and_those_that_do_not_show_it_say_nothing() -> None:
    assert change(WEEKS[:4], np.ones(4), np.full(4, 0.1), np.full(4, np.nan), SETTINGS) is None
    stds = np.where(np.arange(12) == 5, 10.0, 0.02)
    values = np.where(np.arange(12) == 5, 40.0, 1.0) + 1e-3 * np.arange(12) % 2
    one = change(WEEKS, values, stds, NONE, SETTINGS)
    assert one is not None and not one.points  # the one that does not show it is no change
