"""Balances of motors that turn with several joints: a simulated machine's vanish with what acts on it, and
the TX40's real ones come down with the friction of the motor that its joints 5 and 6 share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from planting import Planted
from planting.sizes import usual_effect
from support.diagnose_cases import Case, as_recording, nominal
from support.robots.arms import SPATIAL, make
from support.robots.coupled_robots import DIFFERENTIAL, SHARED, THROUGH, Matrix, coupled, swinging
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import TwinBalances, acts_within_a_joint, balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.robot.couplings import Coupling
from flexjoint.robot.robot import Robot, load, robots_folder
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.simulate import simulate

SHAPES = [(rigid, matrix) for rigid in (True, False) for matrix in (THROUGH, DIFFERENTIAL)]
SMOOTH = [
    effect("motor_inertia", "pitch", scale=0.3),
    effect("motor_viscous_friction", "roll", coefficient=0.4),
    effect("torque_gain", "pitch", gain=0.1),
    effect("cogging", "roll", amplitude=0.4, cycles=7.0),
]
DRY = [
    effect("motor_coulomb_friction", "roll", level=1.5),
    effect("motor_coulomb_friction", "pitch", level=1.0),
]
SHARING = effect("coupled_friction", "pitch", level=1.2, coefficient=0.3, speed="difference")
BOTH = effect("differential_friction", "pitch", level_sum=0.8, level_difference=1.2, coefficient_sum=0.3)


def recorded(robot: Robot, effects: Sequence[Planned], noise: dict[str, float] | None = None) -> Recording:
    model = FlexibleJointModel(robot, effects)
    options = RunOptions(engine="compiled")
    run = simulate(model, swinging(robot, 4.0), options, sample_rate=1000.0, noise=noise, seed=4)
    return run.measured


def left(balances: TwinBalances, effects: Sequence[Planned]) -> np.ndarray:
    """(rows,) RMS of the balances [N m] with these effects."""
    used = balances.motion.readings.valid
    series = balances.time_series(balances.residual(effects))[:, used]
    return np.asarray(np.sqrt(np.mean(series**2, axis=1)))


@pytest.mark.parametrize(("rigid", "matrix"), SHAPES)
def test_balances_vanish_with_what_acts_on_shared_motors(rigid: bool, matrix: Matrix) -> None:
    robot = coupled(matrix, rigid=rigid)
    balances = balances_of(robot, recorded(robot, SMOOTH))
    assert np.max(left(balances, [])) > 0.05
    # torques of some N m; the rest is what filters and interpolation leave
    assert np.max(left(balances, SMOOTH)) < 5e-4
    for k in range(len(SMOOTH)):
        assert np.max(left(balances, [e for e in SMOOTH if e is not SMOOTH[k]])) > 2e-3, SMOOTH[k]


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize(
    ("matrix", "more"), [(None, SHARING), (None, BOTH), (THROUGH, None), (DIFFERENTIAL, None)]
)
def test_so_they_do_with_dry_friction_at_rest_and_in_motion(
    matrix: Matrix | None, more: Planned | None, rigid: bool
) -> None:
    robot = coupled(matrix, rigid=rigid)
    acting = [*DRY, more] if more else DRY
    balances = balances_of(robot, recorded(robot, acting))
    nominal, explained = left(balances, []), left(balances, acting)
    assert np.max(nominal) > 1.0
    assert np.max(explained) < 0.005 * np.max(nominal)  # around standstills, as of a single joint's friction


@pytest.mark.parametrize("rigid", [True, False])
def test_the_matrix_one_is_no_coupling(rigid: bool) -> None:
    robot = coupled(None, rigid=rigid)
    effects = [*SMOOTH[:2], *DRY]
    taken = recorded(robot, effects)
    stated = replace(robot, couplings=(Coupling(SHARED, ((1.0, 0.0), (0.0, 1.0))),))
    one, other = (balances_of(r, taken) for r in (robot, stated))
    for some in (effects[:2], effects):
        np.testing.assert_allclose(
            one.residual(some), other.residual(some), atol=1e-9 * np.max(np.abs(one.residual([])))
        )


@pytest.mark.parametrize(("rigid", "matrix"), SHAPES)
def test_a_change_is_the_difference_of_two_residuals(rigid: bool, matrix: Matrix) -> None:
    robot = coupled(matrix, rigid=rigid)
    balances = balances_of(robot, recorded(robot, SMOOTH))
    base = [*SMOOTH[:2], DRY[0]]
    for more in ([*base, SHARING], [*base, SMOOTH[2]], [base[0], DRY[1]]):
        expected = balances.residual(more) - balances.residual(base)
        np.testing.assert_allclose(
            balances.change(base, more), expected, atol=1e-9 * np.max(np.abs(expected))
        )


@pytest.mark.parametrize(("rigid", "matrix"), SHAPES)
def test_noise_of_a_healthy_machine_is_the_predicted_one(rigid: bool, matrix: Matrix) -> None:
    """The energy of white balances is 1 a sample; an uncoupled model of the same machine is far off."""
    robot = coupled(matrix, rigid=rigid)
    noise = {"q": 2e-5, "theta": 2e-5, "tau_t": 0.02, "tau_m": 0.02}
    taken = recorded(robot, [], noise)
    problem = Problem(balances_of(robot, taken))
    energy = problem.energy(problem.residual([])) / problem.freedom
    assert energy == pytest.approx(1.0, abs=0.08)  # some 1 / sqrt(N), N independent samples
    plain = Problem(balances_of(replace(robot, couplings=()), taken))
    assert plain.energy(plain.residual([])) / plain.freedom > 3.0


@pytest.mark.parametrize("rigid", [True, False])
def test_a_shared_motors_numbers_are_free_within_their_tolerance(rigid: bool) -> None:
    """A motor of a differential 2 % heavier than stated: its tolerance explains it, by a column on both
    joints."""
    robot = coupled(DIFFERENTIAL, rigid=rigid)
    noise = {"q": 1e-5, "theta": 1e-5, "tau_t": 0.01, "tau_m": 0.01}
    taken = recorded(robot, [effect("motor_inertia", "roll", scale=0.02)], noise)
    problem = Problem(balances_of(robot, taken))
    y = problem.residual([])
    deviation = problem.deviations(y)
    names = [(number.name, number.joint) for number in problem.nuisance]
    own = abs(deviation[names.index(("motor_inertia", "roll"))])
    assert own == pytest.approx(1.0, abs=0.25)  # of its tolerance of 2 %; the links' inertias take a part
    assert problem.energy(y) / problem.freedom == pytest.approx(1.0, abs=0.1)


def test_an_effect_on_two_joints_is_not_within_one() -> None:
    assert acts_within_a_joint(DRY[0]) and not acts_within_a_joint(SHARING)
    balances = balances_of(coupled(None, rigid=True), recorded(coupled(None, rigid=True), []))
    changed = balances.changed([], [SHARING])
    assert [balances.rows[r].joint for r in sorted(changed)] == list(SHARED)
    first = effect("coupled_friction", "yaw")  # which has no joint before it, and shows nothing
    assert np.max(np.abs(balances.change([], [first]))) == 0.0
    # nor do pairs of which one joint is rigid, nor late commands of shared motors: no model has these
    mixed = make(SPATIAL, {"pitch": {"stiffness": float("inf")}})
    balances = balances_of(mixed, recorded(mixed, []))
    assert np.max(np.abs(balances.change([], [SHARING]))) == 0.0
    shared = coupled(THROUGH, rigid=True)
    balances = balances_of(shared, recorded(shared, []))
    assert np.max(np.abs(balances.change([], [effect("torque_delay", "pitch", delay=0.003)]))) == 0.0


# ------------------------------------------------------------------ a real machine
Make = Callable[[Sequence[float]], list[Planned]]


def hand_fit(robot: Robot, make: Make, start: Sequence[float], signed: int) -> np.ndarray:
    """(rows,) RMS on the second half of the TX40's recording, of numbers fitted to the first by least
    squares; all but the last `signed` ones are friction, and not negative."""
    balances = balances_of(robot, recording.read(robots_folder() / "tx40" / "recordings" / "rec.parquet"))
    used, time = balances.motion.readings.valid, balances.motion.readings.time
    first = used & (time < 0.5 * (time[0] + time[-1]))
    x = np.array(start)

    def series(numbers: np.ndarray) -> np.ndarray:
        return balances.time_series(balances.residual(make(numbers.tolist())))

    for _ in range(3):
        here = series(x)
        columns = []
        for k, step in enumerate(0.05 * np.maximum(np.abs(x), 0.2)):
            moved = x.copy()
            moved[k] += step
            columns.append((series(moved) - here)[:, first].ravel() / step)
        x = x - np.linalg.lstsq(np.array(columns).T, here[:, first].ravel(), rcond=None)[0]
        x[: x.size - signed] = np.maximum(x[: x.size - signed], 0.0)
    return np.asarray(np.sqrt(np.mean(series(x)[:, used & ~first] ** 2, axis=1)))


def friction(numbers: Sequence[float]) -> list[Planned]:
    """Coulomb and viscous friction and an offset of each joint."""
    out = []
    for k, name in enumerate(load("tx40").joint_names):
        out.append(effect("motor_coulomb_friction", name, level=numbers[k]))
        out.append(effect("motor_viscous_friction", name, coefficient=numbers[6 + k]))
        out.append(effect("torque_offset", name, offset=numbers[-6 + k]))
    return out


def shared(numbers: Sequence[float]) -> list[Planned]:
    level, coefficient = numbers[12:14]
    return [*friction(numbers), effect("coupled_friction", "joint_6", level=level, coefficient=coefficient)]


START = (5.0, 5.0, 5.0, 2.0, 2.0, 0.5, 5.0, 5.0, 2.0, 1.0, 1.0, 0.5)
YARDSTICK = np.array([4.0, 3.9, 1.35, 0.65, 1.06, 0.72])  # N m, an engineer's hand fit with the shared motor


@thorough
def test_the_tx40_comes_down_with_friction_that_joints_5_and_6_share() -> None:
    """Measured: 3.71, 2.41, 1.02, 0.46, 0.86, 0.57 N m with the shared friction as an effect; 3.71, 2.41,
    1.02, 0.46, 0.79, 0.46 with the coupling stated; joints 5 and 6 5.5 and 2.0 with neither."""
    robot = load("tx40")
    drives = {"joint_5": 0.0468}  # kg m^2, of both motors that turn with joint 5, as published
    joints = [replace(j, drive=replace(j.drive, B=drives.get(j.name, j.drive.B))) for j in robot.joints]
    uncoupled = replace(robot, joints=tuple(joints), couplings=())
    with_effect = hand_fit(uncoupled, shared, [*START, 1.0, 0.4, *[0.0] * 6], 6)
    assert np.all(with_effect < YARDSTICK)
    stated = hand_fit(robot, friction, [*START, *[0.0] * 6], 6)
    assert np.all(stated < YARDSTICK)
    neither = hand_fit(uncoupled, friction, [*START, *[0.0] * 6], 6)
    assert neither[4] > 3.0 and neither[5] > 1.5


@pytest.mark.parametrize("name", ["crane", "gimbal"])
def test_a_planted_shared_friction_is_explained_down_to_the_noise(name: str) -> None:
    """By the generator's own law, which creeps where the product's sticks."""
    last = nominal(name).joint_names[-1]
    usual = usual_effect("coupled_friction", name, last, np.random.default_rng(1))
    values = {key: usual.value(key) for key in ("level", "coefficient")}
    planted = Case(name, "rich", 7).with_causes(Planted("coupled_friction", last, {**values}))
    problem = Problem(balances_of(nominal(name), as_recording(planted, name)))
    energy = {
        speed: problem.energy(problem.residual([effect("coupled_friction", last, speed=speed, **values)]))
        for speed in ("sum", "difference")
    }
    assert energy["sum"] / problem.freedom < 2.0  # 1 is noise; the rest is creep
    assert min(energy["difference"], problem.energy(problem.residual([]))) / problem.freedom > 10.0
