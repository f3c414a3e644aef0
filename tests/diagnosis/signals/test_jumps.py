"""What a torque that jumps does between two samples is not known, and is no error of a model."""

from __future__ import annotations

import numpy as np
import pytest
from planting import robot_file
from study.cases import make
from support.diagnose_cases import as_recording
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression import nuisance
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.shared_numbers import _keys
from flexjoint.diagnosis.signals.jumps import jumps, unknown_shapes
from flexjoint.diagnosis.signals.signals import Readings
from flexjoint.recording.table import Recording
from flexjoint.recording.table import make as make_recording
from flexjoint.robot.robot import Robot, load

PERIOD = 0.008


def read(torque: np.ndarray, commanded: bool = True) -> Readings:
    """Readings of one joint with this motor torque, sampled at 125 Hz."""
    none = {name: np.zeros(1) for name in ("q", "theta", "tau_t", "torque")}
    absent, valid = np.full((1, torque.size), np.nan), np.ones(torque.size, dtype=bool)
    time = PERIOD * np.arange(torque.size)
    return Readings(
        time, absent, absent, absent, absent, torque[None],
        commanded=np.array([commanded]), feedback=np.zeros(1), valid=valid, noise=none, steps=none,
        sigma=2.0 * PERIOD, start=0.0, recording=make_recording(time, {("tau_m", "joint"): torque}),
    )  # fmt: skip


def test_a_torque_that_is_reversed_jumps_once() -> None:
    torque = np.where(np.arange(60) < 31, -3.0, 3.0)
    expected = np.zeros(60)
    expected[30] = 6.0
    np.testing.assert_allclose(jumps(read(torque))[0], expected)


def test_a_sample_in_the_middle_of_a_jump_makes_two_of_it() -> None:
    torque = np.where(np.arange(60) < 31, -3.0, 3.0)
    torque[31] = -1.0
    found = jumps(read(torque))[0]
    np.testing.assert_array_equal(np.flatnonzero(found), [30, 31])
    assert 2.0 <= found[30] <= 2.0 + 1e-9  # no more than the torque has changed
    assert 2.0 <= found[31] <= 4.0


def test_a_torque_that_changes_smoothly_does_not_jump() -> None:
    """A parabola's samples foretell each other; a sine of 3 Hz errs by the cube of its phase per sample."""
    t = PERIOD * np.arange(200)
    assert np.max(jumps(read(3.0 * t**2 - t))[0][3:-3]) < 1e-12
    assert np.max(jumps(read(np.sin(6.0 * np.pi * t)))[0][3:-3]) < 1.5 * (6.0 * np.pi * PERIOD) ** 3


def test_noise_does_not_jump() -> None:
    torque = np.random.default_rng(2).standard_normal(4000)
    assert np.count_nonzero(jumps(read(torque))) == 0
    torque[2000:] += 100.0
    assert np.flatnonzero(jumps(read(torque))[0]).tolist() == [1999]


@pytest.mark.parametrize(
    ("commanded", "rate"), [(True, 1000.0), (True, 500.0), (True, 250.0), (False, 1000.0)]
)
def test_impulse_and_centre_scatter_as_jumps_at_any_tick_do(commanded: bool, rate: float) -> None:
    """Of a jump of 1 N m at each of the instants that are as likely, against one in the middle."""
    ticks = round(PERIOD * rate) if commanded else 4000
    after_middle = PERIOD * ((np.arange(ticks) + 0.5) / ticks - 0.5)
    # between the middle and the instant the torque is missing: a rectangle about half that instant
    impulse, centre = -after_middle, after_middle / 2.0
    (both, parted) = unknown_shapes(read(np.zeros(60), commanded), 0, rate)
    assert both[0] == both[1] and parted[0] == -parted[1]
    assert both.sum() * PERIOD == pytest.approx(np.sqrt(np.mean(impulse**2)), rel=1e-6)
    moment = parted @ [-PERIOD / 2.0, PERIOD / 2.0] * PERIOD
    assert abs(moment) == pytest.approx(np.sqrt(np.mean((impulse * centre) ** 2)), rel=1e-6)


@pytest.mark.parametrize("rate", [125.0, 125.0 * 1.00001, 124.9])
def test_a_command_of_which_every_tick_is_recorded_is_known(rate: float) -> None:
    shapes = unknown_shapes(read(np.zeros(60)), 0, rate)
    assert np.all(np.isfinite(shapes)) and np.max(np.abs(shapes)) < 3e-3


def measured(number: int) -> tuple[Robot, Recording]:
    """A case of the study's robots drawn at random: nominal model and recording."""
    case = make("drawn", number)
    return load(robot_file(case.case.robot)), as_recording(case.case.train(), case.name)


def test_what_torques_did_between_samples_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """A healthy machine that swings at its torque limits, recorded at every eighth tick."""
    nominal, recording = measured(132)
    problem = Problem(balances_of(nominal, recording))
    assert problem.energy(problem.residual([])) < 1.1 * problem.noise_energy
    monkeypatch.setattr(nuisance, "jumps", lambda readings: np.zeros_like(readings.torque))
    certain = Problem(balances_of(nominal, recording))
    assert certain.energy(certain.residual([])) > 100.0 * certain.noise_energy


def test_jumps_beside_a_gap_are_unknown_too() -> None:
    nominal, recording = measured(132)
    middle = np.abs(recording.time - recording.time.mean()) > 0.2
    gappy = make_recording(recording.time[middle], {k: v[middle] for k, v in recording.columns.items()})
    problem = Problem(balances_of(nominal, gappy))
    assert problem.energy(problem.residual([])) < 1.1 * problem.noise_energy


def test_each_recording_has_its_own_jumps() -> None:
    nominal, recording = measured(132)
    problem = Problem(balances_of(nominal, recording))
    first, second = set(_keys(problem, 0)), set(_keys(problem, 1))
    claimed = sum(number.of_the_robot for number in problem.nuisance)
    assert 0 < claimed < len(problem.nuisance)
    assert len(first & second) == claimed


@pytest.mark.parametrize(
    "number",
    [pytest.param(20, id="measured", marks=thorough), pytest.param(132, id="commanded", marks=thorough)],
)
def test_a_healthy_machine_at_its_torque_limits_is_healthy(number: int) -> None:
    nominal, recording = measured(number)
    found = diagnose(nominal, [recording])
    assert found.verdict == "healthy", found
    assert not found.unexplained


@thorough
def test_a_cause_is_found_beside_jumps() -> None:
    nominal, recording = measured(42)
    found = diagnose(nominal, [recording])
    assert [(f.effect, f.joint) for f in found.findings] == [("quadratic_drag", "joint_0")]
    assert found.verdict == "causes" and found.findings[0].probability > 0.9
    planted = make("drawn", 42).case.effects[0].value("coefficient")
    assert found.findings[0].parameters["coefficient"].value == pytest.approx(planted, rel=0.1)
