"""Friction that a joint shares with the one before it: torques on both, typed here."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.arms import SPATIAL, make
from support.robots.coupled_robots import coupled

from flexjoint.core.errors import ModelError
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.schemes import make_step

LEVEL, COEFFICIENT, WIDTH = 1.5, 0.8, 0.02


@pytest.mark.parametrize(("speed", "sign"), [("sum", 1.0), ("difference", -1.0)])
@pytest.mark.parametrize("rigid", [True, False])
def test_it_acts_on_both_joints_by_the_speed_of_what_it_rubs_on(speed: str, sign: float, rigid: bool) -> None:
    """w = dtheta + sign dtheta_before; the torque f(w) on this joint, and sign f(w) on the one before."""
    robot = coupled(None, rigid=rigid)
    friction = effect("coupled_friction", "pitch", level=LEVEL, coefficient=COEFFICIENT, speed=speed)
    with_it, without = FlexibleJointModel(robot, [friction]), FlexibleJointModel(robot, [])
    x = with_it.rest(np.array([0.1, 0.2, 0.3]))
    x.v[:] = 0.4, 0.03, -0.05
    x.dtheta = x.dtheta + np.array([0.4, 0.03, -0.05])[: with_it.nf]
    w = -0.05 + sign * 0.03
    f = -(LEVEL * np.tanh(w / WIDTH) + COEFFICIENT * w)
    tau = np.array([1.0, 2.0, 3.0])
    one = with_it.rates(x, tau, WIDTH)
    other = without.rates(x, tau + np.array([0.0, sign * f, f]), WIDTH)
    np.testing.assert_allclose(one.acc, other.acc, rtol=1e-10)
    np.testing.assert_allclose(one.ddtheta, other.ddtheta, rtol=1e-10)
    np.testing.assert_allclose(one.tau_t, other.tau_t, rtol=1e-9)


@pytest.mark.parametrize("rigid", [True, False])
def test_opposite_motion_does_not_feel_the_friction_of_the_sum(rigid: bool) -> None:
    """Two joints that are held together by a sticking shaft can only turn against each other."""
    robot = coupled(None, rigid=rigid)
    model = FlexibleJointModel(robot, [effect("coupled_friction", "pitch", level=30.0)])
    x, step = model.rest(), make_step(model, 1e-3)
    for _ in range(150):
        x = step(x, np.array([0.0, 5.0, -5.0]))
    roll, pitch = (x.v[1], x.v[2]) if rigid else (x.dtheta[1], x.dtheta[2])
    assert abs(roll) > 0.3 and abs(roll + pitch) < 1e-6 * abs(roll)


def test_the_first_joint_has_none_before_it() -> None:
    with pytest.raises(ModelError, match="there is no joint before it; name the later one"):
        FlexibleJointModel(make(SPATIAL), [effect("coupled_friction", "yaw")])


def test_joints_of_both_kinds_are_refused() -> None:
    robot = make(SPATIAL, {"pitch": {"stiffness": float("inf")}})
    with pytest.raises(ModelError, match="roll and pitch share a motor, and not all are rigid"):
        FlexibleJointModel(robot, [effect("coupled_friction", "pitch")])
