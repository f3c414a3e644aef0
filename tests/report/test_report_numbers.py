"""The report's numbers in words, and the arithmetic behind its plots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flexjoint.diagnosis import result as d
from flexjoint.diagnosis.result import merit, torque, wording
from flexjoint.report import series

# --- numbers in words --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.011243, 0.00021, "0.0112 ± 0.0002"),
        (0.011243, 0.00014, "0.01124 ± 0.00014"),  # an error that begins with 1 keeps two digits
        (7056.3, 123.0, "7060 ± 120"),
        (-0.25, 0.3, "-0.2 ± 0.3"),
        (-1e-4, 0.5, "0.0 ± 0.5"),
        (1.234e-5, 2e-7, "(1.23 ± 0.02)e-05"),
        (3.2e7, 4e5, "(3.20 ± 0.04)e+07"),
        (0.5, float("nan"), "0.5"),
        (0.5, 0.0, "0.5"),
        (0.123456789, 1e-12, "0.123457 ± 1e-12"),
    ],
)
def test_a_number_shows_the_digits_that_its_error_supports(value, std, text):
    assert wording.with_error(value, std) == text


def test_a_number_has_no_power_of_ten_below_a_million() -> None:
    told = [wording.number(x) for x in (6098.0, 164.7, 0.00105, 123456.0, -5551.0, 2.5e6, 1e-5)]
    assert told == ["6100", "165", "0.00105", "123000", "-5550", "2.50e+06", "1e-05"]


def test_vectors_bounds_and_words_are_readable():
    position = d.Fitted((0.1, 0.0, -0.25), (0.01, 0.02, 0.03), "m", at_bound=True)
    assert wording.fitted(position) == "[0.100 ± 0.010, 0.00 ± 0.02, -0.25 ± 0.03] m (at its bound)"
    assert wording.fitted("theta") == "theta"
    assert wording.fitted(d.Fitted(0.12, 0.03, "1")) == "0.12 ± 0.03"


def test_shares_never_round_to_certainty():
    shares = (0.873, 0.0312, 0.9996, 1.0, 0.0, 4e-4, -0.07, float("nan"))
    assert [wording.percent(s) for s in shares] == [
        "87 %",
        "3.1 %",
        "> 99 %",
        "100 %",
        "0 %",
        "< 0.1 %",
        "-7.0 %",
        "–",
    ]


def test_a_fall_is_stated_in_per_cent_and_a_rise_is_called_one():
    assert wording.less(53.0, 2.2) == "96 % less"
    assert wording.less(2.0, 2.5) == "25 % more"
    assert wording.less(0.0, 2.5) == ""


def test_a_signal_of_another_joint_is_named_with_it():
    assert wording.signal_name("tau_t.left.knee") == "spring torque tau_t of left.knee"
    assert wording.signal_name("tau_t.knee", rigid=True) == "load torque tau_t of knee"
    assert wording.signal_name("some.thing") == "some.thing"


def test_of_many_joints_those_are_listed_of_which_most_is_left():
    left = [d.Remaining(f"j{k}", 10.0, 5.0, 0.1 * (k % 7), 0.1, 0.0, "q") for k in range(30)]
    table = torque.table(d.Diagnosis("causes", "", remaining=tuple(left)), wording.Joints(), 4)
    assert table is not None and table.more == 26
    assert [row.joint for row in table.rows] == ["j6", "j13", "j20", "j27"]  # in the robot's order


def test_a_joint_without_torque_or_noise_has_no_share_of_it():
    left = d.Remaining("free", 0.0, 0.0, 0.1, 0.0, 0.0, "q")
    table = torque.table(d.Diagnosis("causes", "", remaining=(left,)), wording.Joints(), 4)
    assert table is not None
    row = table.rows[0]
    assert (row.of_before, row.of_torque, row.times_noise) == (wording.NOTHING,) * 3


def test_the_noise_floor_is_put_on_the_scale_of_the_error():
    gain = d.Gain(
        True,
        0.5,
        {"rms": {"q.a": 0.02, "q.b": 0.01, "phi.a": 1.0}, "nrmse": {"q.a": 0.4, "q.b": 0.3, "phi.a": 9.0}},
        {"rms": {"q.a": 0.01}, "nrmse": {"q.a": 0.2}},
        {"rms": {"q.a": 0.001}},
    )
    first = merit.channel_errors(gain)[0]
    assert first.floor == pytest.approx(0.02)  # 0.001 over the standard deviation 0.02 / 0.4
    grown = replace(gain, noise_floor={**gain.noise_floor, "simulated": {"q.a": 0.004}})
    assert merit.channel_errors(grown)[0].floor == pytest.approx(0.08)  # what becomes of all noise is more
    assert first.removed == pytest.approx(0.5)
    total = merit.overall(gain)
    assert total.before == pytest.approx(np.sqrt((0.4**2 + 0.3**2) / 2))  # the deflection is left out
    assert total.after == pytest.approx(0.2)


# --- arithmetic behind the plots ---------------------------------------------------------------------


def test_the_excerpt_lies_around_the_largest_error():
    time = np.arange(0.0, 30.0, 0.01)
    error = 0.1 + 5.0 * np.exp(-(((time - 17.0) / 0.5) ** 2))
    start, stop = series.excerpt(time, error, 3.0)
    assert stop - start == pytest.approx(3.0)
    assert start < 16.0 and stop > 18.0  # the peak's two sigma lie inside
    assert series.excerpt(time, np.where(time > 29.5, error, np.nan), 3.0)[1] <= time[-1]


def test_thinning_keeps_peaks_and_gaps():
    time = np.arange(10_000) * 1e-3
    values = np.sin(time)
    values[4321] = 7.0
    values[6000:7000] = np.nan
    short, kept = series.thinned(time, values, 200)
    assert kept.size <= 400 and np.nanmax(kept) == 7.0 and np.all(np.diff(short) > 0)
    assert np.all(np.isnan(kept[(short > 6.06) & (short < 6.94)]))  # one bucket of 0.05 s at each end may mix


def test_dependence_tells_a_law_from_noise():
    rng = np.random.default_rng(5)
    x, noise = rng.uniform(-1, 1, 4000), rng.standard_normal(4000)
    assert series.dependence(x, np.sign(x)) > 0.9  # the bin around zero holds both signs
    assert series.dependence(x, noise) < 0.02  # 24 bins of 4000 samples: 0.006 expected
    assert series.dependence(x, np.zeros(4000)) == 0.0


def test_binned_medians_follow_the_law():
    rng = np.random.default_rng(6)
    x = rng.uniform(-1, 1, 4000)
    y = x**2 + 0.01 * rng.standard_normal(4000)
    bins = series.binned(x, y)
    # a bin is 1/12 wide: x^2 varies by up to 1/6 inside, its median by a fraction of that
    assert bins.median == pytest.approx(bins.x**2, abs=0.02)
    assert np.all((bins.low <= bins.median) & (bins.median <= bins.high))
    assert series.binned(np.full(100, 2.0), np.ones(100)).x == pytest.approx([2.0])
    assert series.binned(np.array([]), np.array([])).x.size == 0


# --- residuals and signals of few values ---------------------------------------------------------------
def test_a_residual_of_two_values_has_a_row_of_medians_for_each():
    rng = np.random.default_rng(5)
    x = np.sort(rng.uniform(0.0, 10.0, 4000))
    y = 0.4 * np.sign(np.sin(17.0 * x)) + 0.05 * rng.standard_normal(x.size)
    low, high = series.levels(x, y)
    # a median of some 80 samples of sd 0.05 errs by 0.007
    np.testing.assert_allclose(low.median, -0.4, atol=0.03)
    np.testing.assert_allclose(high.median, 0.4, atol=0.03)
    assert low.x.size == 24


def test_forth_and_back_have_a_row_of_medians_each():
    """An ellipse, as damping draws it over position: one median would jump from its top to its bottom."""
    rng = np.random.default_rng(9)
    phase = rng.uniform(0.0, 2 * np.pi, 6000)
    x, y = np.sin(phase), np.cos(phase) + 0.02 * rng.standard_normal(phase.size)
    low, high = series.levels(x, y)
    middle = np.abs(high.x) < 0.9
    # within a bin the ellipse falls by some 0.1 at 0.9; its median lies near the middle
    np.testing.assert_allclose(high.median[middle], np.sqrt(1 - high.x[middle] ** 2), atol=0.04)
    np.testing.assert_allclose(low.median[middle], -np.sqrt(1 - low.x[middle] ** 2), atol=0.04)
    # at its ends, where forth meets back, both rows hold the same
    assert abs(high.median[-1] - low.median[-1]) < 0.6


def test_a_level_that_a_bin_does_not_visit_has_no_median_there():
    rng = np.random.default_rng(6)
    x = rng.uniform(-1.0, 1.0, 4000)
    low, high = series.levels(x, 0.4 * np.sign(x) + 0.03 * rng.standard_normal(x.size))
    assert np.all(np.isnan(low.median[low.x > 0.1])) and np.all(np.isfinite(low.median[low.x < -0.1]))
    assert np.all(np.isnan(high.median[high.x < -0.1])) and np.all(np.isfinite(high.median[high.x > 0.1]))


@pytest.mark.parametrize("name", ["normal", "uniform", "sine", "outliers", "constant"])
def test_other_residuals_have_one_row(name):
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(4000)
    y = {
        "normal": noise,
        "uniform": rng.uniform(size=4000),
        "sine": np.sin(np.linspace(0.0, 200.0, 4000)),
        "outliers": np.where(rng.uniform(size=4000) < 0.02, 50.0, noise),
        "constant": np.zeros(4000),
    }[name]
    assert series.between_levels(y) is None
    assert len(series.levels(np.linspace(0.0, 1.0, 4000), y)) == 1


def test_each_value_of_a_signal_of_few_values_is_a_bin():
    rng = np.random.default_rng(8)
    x = rng.choice([-1.0, 1.0, 3.0], 3000)
    y = 0.5 * x + 0.1 * rng.standard_normal(x.size)
    (bins,) = series.levels(x, y)
    assert bins.discrete
    np.testing.assert_array_equal(bins.x, [-1.0, 1.0, 3.0])
    np.testing.assert_allclose(bins.median, 0.5 * bins.x, atol=0.02)  # 1000 samples of sd 0.1: 0.004
    # var(0.5 x) = 0.667 of 0.677
    assert series.dependence(x, y) == pytest.approx(0.985, abs=0.005)
