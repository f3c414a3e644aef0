"""Motors that turn with several joints: the equations of motion, typed here from Lagrange's, and at rest."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from support.robots.coupled_robots import (
    DAMPING,
    DIFFERENTIAL,
    SHARED,
    THROUGH,
    UNITY,
    Matrix,
    coupled,
    swinging,
)

from flexjoint.core.errors import ModelError
from flexjoint.design.linearise import linearise
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.simulate import simulate
from flexjoint.simulation.testing.energy import assert_energy_balance

MATRICES = (THROUGH, DIFFERENTIAL, ((1.0, 0.2), (-0.3, 1.4)))
TORQUE = np.array([3.0, -4.0, 2.0])
VISCOUS = 0.7


def somewhere(model: FlexibleJointModel) -> State:
    rng = np.random.default_rng(2)
    x = model.rest(np.array([0.3, -0.5, 0.8]))
    x.v[:] = rng.normal(size=3)
    x.theta, x.dtheta = x.theta + 0.01 * rng.normal(size=model.nf), rng.normal(size=model.nf)
    return x


def whole(matrix: Matrix) -> np.ndarray:
    """(3, 3) motors by joints, the first one alone."""
    out = np.eye(3)
    out[np.ix_(SHARED, SHARED)] = matrix
    return out


@pytest.mark.parametrize("matrix", MATRICES)
def test_rigid_joints_carry_inertia_and_friction_by_the_transposed_matrix(
    matrix: Matrix,
) -> None:
    robot = coupled(matrix, rigid=True)
    model = FlexibleJointModel(robot, [effect("motor_viscous_friction", "pitch", coefficient=VISCOUS)])
    x, N = somewhere(model), whole(matrix)
    B = N.T @ np.diag([joint.drive.B for joint in robot.joints]) @ N
    data = robot.model.createData()
    mass = pin.crba(robot.model, data, x.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    damping = N.T @ np.diag([DAMPING, DAMPING, DAMPING + VISCOUS]) @ N
    pull = TORQUE - damping @ x.v
    acc = np.linalg.solve(mass + B, pull - pin.nle(robot.model, data, x.q, x.v))
    rates = model.rates(x, TORQUE, None)
    np.testing.assert_allclose(rates.acc, acc, rtol=1e-10)  # two ways to solve the same small system
    np.testing.assert_allclose(rates.tau_t, pull - B @ acc, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("matrix", MATRICES)
def test_motors_of_flexible_joints_turn_by_the_transposed_matrix(matrix: Matrix) -> None:
    robot = coupled(matrix, rigid=False)
    model = FlexibleJointModel(robot, [effect("motor_inertia", "roll", scale=0.5)])
    x, N = somewhere(model), whole(matrix)
    inertia = np.array([joint.drive.B for joint in robot.joints]) * (1.0, 1.5, 1.0)
    K, D = (np.array([getattr(joint.drive, key) for joint in robot.joints]) for key in "KD")
    spring = K * (x.theta - x.q) + D * (x.dtheta - x.v)
    pull = TORQUE - spring - N.T @ (DAMPING * (N @ x.dtheta))
    expected = np.linalg.solve(N.T @ np.diag(inertia) @ N, pull)
    np.testing.assert_allclose(model.rates(x, TORQUE, None).ddtheta, expected, rtol=1e-10)


@pytest.mark.parametrize("rigid", [True, False])
def test_what_a_command_effect_changes_is_the_motors_torque(rigid: bool) -> None:
    """A gain of one motor of a differential turns the other joint as well: N' (1 + g) N^-T tau."""
    robot, N = coupled(DIFFERENTIAL, rigid=rigid), whole(DIFFERENTIAL)
    gain = [effect("torque_gain", "roll", gain=0.2)]
    acting = N.T @ (np.diag([1.0, 1.2, 1.0]) @ np.linalg.solve(N.T, TORQUE))
    changed, plain = FlexibleJointModel(robot, gain), FlexibleJointModel(robot, [])
    one, other = changed.rates(somewhere(changed), TORQUE, None), plain.rates(somewhere(plain), acting, None)
    np.testing.assert_allclose(one.acc, other.acc, rtol=1e-10)
    np.testing.assert_allclose(one.ddtheta, other.ddtheta, rtol=1e-10)


@pytest.mark.usefixtures("one_pass")  # as steps of coupled motors are
@pytest.mark.parametrize("rigid", [True, False])
def test_the_matrix_one_is_no_coupling(rigid: bool) -> None:
    effects = [effect("motor_viscous_friction", name, coefficient=0.5) for name in ("roll", "pitch")]
    effects += [effect("cogging", "pitch", amplitude=0.5, cycles=9.0)]
    ends = []
    for matrix in (None, UNITY):
        model = FlexibleJointModel(coupled(matrix, rigid=rigid), effects)
        run = rollout(model, somewhere(model), np.tile(TORQUE, (300, 1)), RunOptions(engine="pin"))
        ends.append(np.concatenate([run.q[-1], run.v[-1], run.theta[-1], run.dtheta[-1]]))
    # rounding of a small linear system, over 300 steps
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("matrix", [THROUGH, DIFFERENTIAL])
def test_energy_is_neither_made_nor_lost(matrix: Matrix, rigid: bool) -> None:
    robot = coupled(matrix, rigid=rigid)
    effects = [effect("coupled_friction", "pitch", level=0.0, coefficient=0.4)]
    run = simulate(FlexibleJointModel(robot, effects), swinging(robot, 1.0))
    assert_energy_balance(FlexibleJointModel(robot, effects), run.trajectory, 2e-3)


@pytest.mark.parametrize("rigid", [True, False])
def test_it_stays_where_the_static_law_says(rigid: bool) -> None:
    """Commands that go through gains of coupled motors, and hold the arm against gravity."""
    robot = coupled(DIFFERENTIAL, rigid=rigid)
    effects = [effect("torque_gain", "roll", gain=0.3), effect("torque_offset", "pitch", offset=0.7)]
    model = FlexibleJointModel(robot, effects)
    q = np.array([0.2, -0.6, 0.9])
    rest = equilibrium(model, q)
    x = model.rest(q)
    x.theta = rest.theta[0, list(model.flexible)]
    rates = model.rates(x, rest.tau_m[0], None)
    # of the gravity torques of some N m over inertias of 0.1 kg m^2
    assert np.max(np.abs(np.concatenate([rates.acc, rates.ddtheta]))) < 1e-9
    N = whole(DIFFERENTIAL)
    motors = np.linalg.solve(N.T, rest.tau_m[0]) * (1.0, 1.3, 1.0) + (0.0, 0.0, 0.7)
    np.testing.assert_allclose(N.T @ motors, rest.tau[0], rtol=1e-9)


def test_flexible_joints_with_shared_motors_are_linearised_and_rigid_ones_refused() -> None:
    model = FlexibleJointModel(coupled(THROUGH, rigid=False), [])
    linear = linearise(model, np.array([0.1, 0.2, 0.3]))
    start = model.rest(np.array([0.1, 0.2, 0.3]))
    start.theta = equilibrium(model, start.q).theta[0]
    h, x, nv = 1e-6, model.pack(start), model.nv
    tau = equilibrium(model, start.q).tau_m[0]
    for k in (2 * nv + 1, 2 * nv + model.nf + 2):  # a motor's position and another's speed
        moved = x.copy()
        moved[k] += h
        slope = (model.rhs(moved, tau, 1.0) - model.rhs(x, tau, 1.0)) / h
        np.testing.assert_allclose(linear.A[:, k], slope, atol=2e-3)  # of entries of 1e4, at a step of 1e-6
    with pytest.raises(ModelError, match="roll and pitch are rigid and share a motor"):
        linearise(FlexibleJointModel(coupled(THROUGH, rigid=True), []))


def test_late_commands_of_shared_motors_are_refused() -> None:
    with pytest.raises(ModelError, match="late commands of such are not modelled"):
        FlexibleJointModel(coupled(THROUGH, rigid=True), [effect("torque_delay", "pitch", delay=0.002)])
