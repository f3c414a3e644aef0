"""Links without encoder: how they move with what is wrong, and what that adds to the balances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from planting import PERFECT, ROBOTS, plant
from scipy.integrate import solve_ivp
from scipy.interpolate import interp1d
from support.diagnose_cases import Case, as_recording, nominal
from support.robots.arms import SPATIAL, make
from support.thorough import exhaustive, thorough

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, SPRING, TwinBalances, balances_of
from flexjoint.diagnosis.balances.links.movement import Numbers, torque
from flexjoint.diagnosis.balances.motion import reconstruct
from flexjoint.diagnosis.regression.deviations import about_likely_links, deviation_effects
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.whitening import make as make_whitening
from flexjoint.effects import effect
from flexjoint.recording import table
from flexjoint.recording.table import Recording

MOTORS = ("theta", "dtheta", "tau_m", "tau_cmd")


def without_links(recording: Recording, channels: Sequence[str] = MOTORS) -> Recording:
    """The recording of motor encoders and torques."""
    kept = {key: x for key, x in recording.columns.items() if key[0] in channels}
    return replace(recording, columns=kept)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return without_links(as_recording(Case("crane", "rich", 31, inexact=0.03).with_causes()))


@pytest.fixture(scope="module")
def balances(recording: Recording) -> TwinBalances:
    return balances_of(nominal("crane"), recording)


def nominal_numbers(balances: TwinBalances) -> Numbers:
    return Numbers(tuple(joint.drive for joint in balances.motion.robot.joints))


@exhaustive
def test_a_torque_on_the_links_moves_them_by_their_linear_equations(balances: TwinBalances) -> None:
    """Against a tight solution of M dq'' + (C + D) dq' + (G + K) dq = torque, another integrator's."""
    motion, links = balances.motion, balances.missing_links
    robot, rigid, t = motion.robot, motion.rigid, motion.readings.time - motion.readings.time[0]
    n = len(robot.joints)
    push = 3.0 * np.sin(2.0 * np.pi * 1.3 * t) * np.minimum(t, 1.0)
    force = np.zeros((n, t.size))
    force[0] = push
    matrices = [
        interp1d(t, x, axis=0)
        for x in (
            rigid.mass,
            rigid.by_v + np.diag([j.drive.D for j in robot.joints]),
            rigid.by_q + np.diag([j.drive.K for j in robot.joints]),
        )
    ]
    forced = interp1d(t, force)

    def rates(time: float, x: np.ndarray) -> np.ndarray:
        mass, damping, stiffness = (m(time) for m in matrices)
        return np.concatenate(
            [x[n:], np.linalg.solve(mass, forced(time) - damping @ x[n:] - stiffness @ x[:n])]
        )

    found = links._by_load(force)
    exact = solve_ivp(
        rates, (0.0, t[-1]), np.zeros(2 * n), t_eval=t, rtol=1e-8, atol=1e-12, max_step=motion.filter.period
    )

    for i, movement in found:
        largest = np.max(np.abs(exact.y[:n]))
        assert movement.q == pytest.approx(exact.y[i], abs=0.01 * largest)


def test_the_links_take_an_error_of_their_balances_and_springs_pass_it_on(balances: TwinBalances) -> None:
    """A link that moves as the torque on it asks leaves nothing of that torque: its load, along the motion,
    and its spring take all of it, and the spring pulls as much at the motor."""
    motion, links = balances.motion, balances.missing_links
    n, t = len(motion.robot.joints), motion.readings.time - motion.readings.time[0]
    force = np.zeros((n, t.size))
    force[1] = 2.0 * np.sin(2.0 * np.pi * 0.8 * t) * np.sin(np.pi * t / t[-1]) ** 4  # nothing at the ends
    loads = {row.joint: k for k, row in enumerate(balances.rows) if row.balance == LINK}
    motors = {row.joint: k for k, row in enumerate(balances.rows) if row.balance == MOTOR}

    movements = dict(links._by_load(force))
    added = links.moved({loads[k]: force[k] for k in range(n)}, nominal_numbers(balances))

    largest = np.max(np.abs(force))
    for k in range(n):
        numbers = nominal_numbers(balances)
        load = sum(torque(motion, k, i, movement, numbers) for i, movement in movements.items())
        pulled = added[motors[k]]
        assert np.max(np.abs(force[k] + added[loads[k]])) < 1e-9 * largest
        # the masses that links follow with are those of the middle of each step
        assert np.max(np.abs(force[k] - load - pulled)[200:-200]) < 1e-3 * largest


def test_numbers_that_are_off_are_explained_where_the_posture_varies(recording: Recording) -> None:
    """The machine is healthy, and its numbers 3 % off: with links moved about the nominal ones and then about
    the likely ones, no more is left than noise."""
    problem = Problem(balances_of(nominal("crane"), recording))

    better = about_likely_links(problem)

    energies = [p.energy(p.residual([])) / p.noise_energy for p in (problem, better)]
    assert energies[1] <= energies[0]
    assert energies[1] < 1.1
    assert np.max(better.variances(better.residual([]))) < 2.0


def test_a_deviation_s_column_is_what_links_made_of_it_leave(recording: Recording) -> None:
    """Along links that follow from a number that is off, the balances with that number are those of the
    nominal robot along its own links: the column is the change back, to first order."""
    robot = nominal("crane")
    problem = Problem(balances_of(robot, recording))
    k = next(k for k, number in enumerate(problem.nuisance) if number.name == "spring_stiffness")
    numbers = np.zeros(len(problem.nuisance))
    numbers[k] = -1.0
    off = deviation_effects(problem, numbers)
    readings = problem.motion.readings
    there = TwinBalances(
        reconstruct(robot, readings, recording, off),
        reconstruct(robot, problem.balances.denoised.motion.readings, recording, off),
    )

    at_nominal, made_of_it = problem.residual([]), problem.whitening.apply(there.residual(off)).ravel()
    plain = problem.whitening.white(problem.whitening.band(problem.balances.changed([], off))).ravel()

    # the motion is another one, but the machine that it belongs to is the one that was asked for
    change = np.std(made_of_it - at_nominal)
    assert change < 0.3 * np.std(plain) + 0.3 * np.std(at_nominal)


@pytest.mark.parametrize("channels", [MOTORS, (*MOTORS, "tau_t")], ids=["motors", "motors and springs"])
@pytest.mark.parametrize("name", ["crane", "scara", "gimbal", "lever"])
def test_a_number_s_column_is_what_it_changes_for_links_made_with_it(
    name: str, channels: Sequence[str]
) -> None:
    """Near the ends of the recording as well. Whitening alone, which eliminated the links' movement in the
    mean posture, left up to a fifth of a stiffness' column there, and that was told as an encoder's offset of
    a machine with nothing wrong."""
    robot = nominal(name)
    recording = without_links(as_recording(Case(name, "steps", 31).with_causes()), channels)
    problem = Problem(balances_of(robot, recording))
    apply, rows = problem.whitening.apply, len(problem.balances.rows)
    here = apply(problem.balances.denoised.residual([]))
    for k, number in enumerate(problem.nuisance):
        if number.name != "spring_stiffness":
            continue
        share = 0.05
        moved = [
            replace(j, drive=replace(j.drive, K=j.drive.K * (1.0 + share * number.std)))
            if j.name == number.joint
            else j
            for j in robot.joints
        ]
        there = balances_of(replace(robot, joints=tuple(moved)), recording)

        change = (apply(there.denoised.residual([])) - here) / share
        column = problem.along(np.eye(len(problem.nuisance))[k]).reshape(rows, -1)

        assert np.linalg.norm(change - column) < 0.03 * np.linalg.norm(change), number.joint


@pytest.mark.parametrize("channels", [MOTORS, (*MOTORS, "tau_t")], ids=["motors", "motors and springs"])
@pytest.mark.parametrize("name", ["crane", "scara", "gimbal", "lever"])
def test_links_follow_a_softer_spring_as_one(name: str, channels: Sequence[str]) -> None:
    """A stiffness 20 % off, under a whitening of its own. Moved by the nominal stiffness, links left a fifth
    of what it changes."""
    robot, off = nominal(name), -0.2
    recording = without_links(as_recording(Case(name, "rich", 31).with_causes()), channels)
    first, *others = robot.joints
    softer = replace(first, drive=replace(first.drive, K=first.drive.K * (1.0 + off)))
    there = balances_of(replace(robot, joints=(softer, *others)), recording)
    problem = Problem(balances_of(robot, recording))
    cause = [*problem.nominal, effect("spring_stiffness", first.name, scale=off)]
    scale = np.array([problem.torque_scale[row.joint] for row in problem.balances.rows])
    white = make_whitening(problem.balances, scale, cause, like=problem.whitening)

    exact = white.apply(there.denoised.residual(problem.nominal))
    found, without = (white.apply(problem.balances.denoised.residual(e)) for e in (cause, problem.nominal))

    assert np.linalg.norm(found - exact) < 0.08 * np.linalg.norm(without - exact)


def test_links_that_would_fall_are_not_followed(recording: Recording) -> None:
    """Beside a spring too soft for its load the linear equations grow without end: nothing is added, instead
    of numbers that are not finite."""
    links = balances_of(nominal("crane"), recording).missing_links
    mass, damping, stiffness = links._driven_matrices
    vars(links)["_driven_matrices"] = (mass, damping, -1e3 * np.abs(stiffness))  # a cached property

    assert not links
    assert links.free() == []


def test_links_that_are_measured_are_left_alone() -> None:
    measured = balances_of(nominal("lever"), as_recording(Case("lever", "rich", 5).with_causes()))

    assert not measured.missing_links
    problem = Problem(measured)
    assert about_likely_links(problem) is problem


def test_an_angle_made_of_a_torque_sensor_s_reading_leaves_nothing_of_it() -> None:
    """The reading is filtered once, as all others: twice would leave the fast part of every torque."""
    whole = as_recording(Case("crane", "steps", 9).with_causes())
    kept = {key: x for key, x in whole.columns.items() if key[0] in ("q", "dq", "tau_t")}
    found = balances_of(nominal("crane"), replace(whole, columns=kept))
    springs = [k for k, row in enumerate(found.rows) if row.balance == SPRING]

    left = found.time_series(found.residual([]))[:, found.motion.readings.valid]

    assert springs
    scale = found.torque_scale()
    for k in springs:
        assert np.std(left[k]) < 1e-9 * scale[found.rows[k].joint]


@pytest.mark.parametrize("robot", ["lever", "scara", "gimbal"])
def test_a_link_without_encoder_moves_as_it_does(robot: str) -> None:
    """Without noise, of a nominal model that is right: within 1 % of the deflection at 250 Hz, and nearer at
    twice the rate."""
    sensors, model = replace(PERFECT, channels=("theta", "dtheta", "tau_m")), nominal(robot)
    errors = []
    for rate in (250.0, 500.0):
        recorded = plant(ROBOTS / f"{robot}.yaml", [], "rich", 6.0, 3, sensors, rate=rate)
        motion = balances_of(model, as_recording(recorded)).motion
        used = motion.readings.valid
        true = recorded.true["q"].T[:, : used.size]
        error, deflection = motion.filter.smooth(motion.q - true), motion.theta - true
        errors.append(np.std(error[:, used], axis=1) / np.std(deflection[:, used], axis=1))

    assert np.max(errors[0]) < 0.01, errors
    assert np.mean(errors[1]) < 0.75 * np.mean(errors[0]), errors


@thorough
@pytest.mark.parametrize("inexact", [0.0, 0.05])
@pytest.mark.parametrize("robot", ["lever", "crane"])
def test_a_link_may_swing_at_the_start(robot: str, inexact: float) -> None:
    """A recording that begins in the midst of a motion: from links at rest there it left 87 to 223 times the
    noise, for the error of a swing times that of the posture is of second order."""
    whole = without_links(as_recording(Case(robot, "rich", 3, "motor_only", inexact).with_causes()))
    late = whole.time >= 4.0
    columns = {key: x[late] for key, x in whole.columns.items()}
    begun = table.make(whole.time[late] - 4.0, columns, "begun")
    problem = about_likely_links(Problem(balances_of(nominal(robot), begun)))
    assert problem.energy(problem.residual([])) < 1.2 * problem.freedom


def of_a_light_link(inertia: float) -> TwinBalances:
    """Balances along the motors of an arm whose last link has its mass on its axis, and this inertia."""
    light = ("pitch", "0 1 0", "0 0 -0.38", "0 0 0", 0.2, inertia)
    robot = make([*SPATIAL[:2], light], {"pitch": {"stiffness": 2000}})
    time = np.arange(0.0, 4.0, 0.002)
    columns = {}
    for k, name in enumerate(robot.joint_names):
        columns["theta", name] = 0.4 * np.sin((1.3 + 0.5 * k) * time + k)
        columns["tau_m", name] = np.cos((0.9 + 0.4 * k) * time)
    return balances_of(robot, table.make(time, columns))


def test_a_link_without_inertia_follows_its_spring() -> None:
    """As one that is nearly without: robot files give small links none."""
    none, little = of_a_light_link(0.0), of_a_light_link(1e-7)
    push = np.sin(np.arange(none.filter.count) * 0.01)
    rows = [r for r, row in enumerate(none.rows) if row.balance == LINK]
    moved, close = (
        b.missing_links.moved(dict.fromkeys(rows, push), nominal_numbers(b)) for b in (none, little)
    )

    assert none.missing_links
    assert np.isfinite(Problem(none).residual([])).all()
    for r, series in moved.items():
        assert series == pytest.approx(close[r], abs=1e-6)  # N m, of a push of 1 N m
