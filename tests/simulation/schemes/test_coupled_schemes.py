"""Motors that turn with several joints, in the schemes and compiled."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.coupled_robots import DIFFERENTIAL, THROUGH, Matrix, coupled, swinging

from flexjoint.core.errors import SimulationError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.schemes import DEFAULT, make_step
from flexjoint.simulation.simulate import simulate

TORQUE = np.array([2.0, -3.0, 1.5])
SMOOTH = [
    effect("motor_viscous_friction", "pitch", coefficient=0.4),
    effect("coupled_friction", "pitch", level=0.0, coefficient=0.5, speed="difference"),
    effect("differential_friction", "pitch", level_sum=0.0, level_difference=0.0, coefficient_sum=0.3),
    effect("hardening_spring", "roll", cubic=1e5),
]
DRY = [
    effect("motor_coulomb_friction", "roll", level=0.9),
    effect("motor_coulomb_friction", "pitch", level=0.7),
    effect("coupled_friction", "pitch", level=0.5, coefficient=0.1),
    effect("differential_friction", "pitch", level_sum=0.3, level_difference=0.4, coefficient_sum=0.0),
    effect("link_coulomb_friction", "pitch", level=0.3),
]


def planned(rigid: bool) -> list[Planned]:
    return [e for e in SMOOTH if not (rigid and e.effect.name == "hardening_spring")]


def end(
    model: FlexibleJointModel, h: float, seconds: float, scheme: str = DEFAULT, width: float | None = None
) -> np.ndarray:
    x, step = model.rest(np.array([0.2, -0.4, 0.7])), make_step(model, h, scheme, width)
    for _ in range(round(seconds / h)):
        x = step(x, TORQUE)
    return np.concatenate([x.q, x.v, x.theta, x.dtheta])


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("matrix", [THROUGH, DIFFERENTIAL])
def test_the_default_scheme_is_of_order_2(matrix: Matrix, rigid: bool) -> None:
    model = FlexibleJointModel(coupled(matrix, rigid=rigid), planned(rigid))
    exact = end(model, 0.05, 0.1, "reference", 1.0)  # where no dry friction is, none is smoothed
    coarse, fine = (np.max(np.abs(end(model, h, 0.1) - exact)) for h in (5e-4, 2.5e-4))
    assert 1.85 < np.log2(coarse / fine) < 2.15


@pytest.mark.parametrize(("matrix", "rigid"), [(THROUGH, False), (DIFFERENTIAL, True)])
def test_dry_friction_is_that_of_a_narrow_smoothing(matrix: Matrix, rigid: bool) -> None:
    model = FlexibleJointModel(coupled(matrix, rigid=rigid), DRY)
    narrow = end(model, 0.01, 0.04, "reference", 1e-3)
    # it creeps at up to 1e-3 rad/s and pushes less below that, amid speeds of some rad/s
    assert np.max(np.abs(end(model, 2e-4, 0.04) - narrow)) < 5e-3


@pytest.mark.parametrize("rigid", [True, False])
def test_a_motor_that_sticks_leaves_the_joints_their_common_motion(rigid: bool) -> None:
    """Of a differential the motor of the sum is held by friction; torques on both joints that only turn the
    other one do so, and the sum stands."""
    robot = coupled(((0.5, 0.5), (0.5, -0.5)), rigid=rigid)
    model = FlexibleJointModel(robot, [effect("motor_coulomb_friction", "roll", level=40.0)])
    x, step = model.rest(), make_step(model, 1e-3)
    for _ in range(200):
        x = step(x, np.array([0.0, 6.0, -6.0]))
    roll, pitch = (x.v[1], x.v[2]) if rigid else (x.dtheta[1], x.dtheta[2])
    assert abs(roll) > 0.3 and abs(roll + pitch) < 1e-6 * abs(roll)


@pytest.mark.parametrize("rigid", [True, False])
def test_redundant_friction_holds_at_rest(rigid: bool) -> None:
    """Three shafts stick on two joints: nothing creeps, nothing is singular."""
    robot = coupled(THROUGH, rigid=rigid)
    model = FlexibleJointModel(robot, [*DRY[:2], effect("coupled_friction", "pitch", level=5.0)])
    x, step = model.rest(), make_step(model, 1e-3)
    for _ in range(300):
        x = step(x, np.array([0.0, 0.4, -0.3]))
    speed = x.v[1:] if rigid else x.dtheta[1:]
    assert np.max(np.abs(speed)) < 1e-8


@pytest.mark.parametrize("rigid", [True, False])
def test_compiled_runs_are_the_same(rigid: bool) -> None:
    robot = coupled(DIFFERENTIAL, rigid=rigid)
    effects = [
        *DRY,
        effect("breakaway_friction", "roll", level=0.3),
        effect("torque_gain", "pitch", gain=0.1),
    ]
    model = FlexibleJointModel(robot, effects)
    runs = [
        simulate(model, swinging(robot, 0.4), RunOptions(engine=engine)).trajectory
        for engine in ("pin", "compiled")
    ]
    for name in ("q", "v", "theta", "dtheta", "z", "tau_rigid"):
        one, other = (getattr(run, name) for run in runs)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=5e-6)
    # 5e-6 rad/s: where more shafts stick than there are joints, sweeps stop by another rule


def test_a_scheme_that_knows_no_shared_friction_refuses_it() -> None:
    model = FlexibleJointModel(coupled(THROUGH, rigid=True), DRY)
    with pytest.raises(SimulationError, match="takes no dry friction beside coupled motors"):
        make_step(model, 1e-3, "semi_implicit_euler")
    smooth = FlexibleJointModel(coupled(THROUGH, rigid=True), SMOOTH[:1])
    errors = [
        np.max(np.abs(end(smooth, h, 0.1, "semi_implicit_euler") - end(smooth, 0.05, 0.1, "reference", 1.0)))
        for h in (1e-3, 5e-4)
    ]
    assert 0.8 < np.log2(errors[0] / errors[1]) < 1.2  # order 1
