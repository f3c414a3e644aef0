"""Friction of the two motors of a differential: two frictions of shafts, one on the sum and one on the
difference."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.coupled_robots import coupled

from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.schemes import make_step

LEVELS, COEFFICIENTS, WIDTH = (1.5, 0.6), (0.8, 0.3), 0.02
BOTH = effect(
    "differential_friction",
    "pitch",
    level_sum=LEVELS[0],
    coefficient_sum=COEFFICIENTS[0],
    level_difference=LEVELS[1],
    coefficient_difference=COEFFICIENTS[1],
)


@pytest.mark.parametrize("rigid", [True, False])
def test_each_motor_acts_on_both_joints_by_its_own_speed(rigid: bool) -> None:
    """w = dtheta + sign dtheta_before, of one motor and of the other; f(w) here, sign f(w) before."""
    robot = coupled(None, rigid=rigid)
    with_it, without = FlexibleJointModel(robot, [BOTH]), FlexibleJointModel(robot, [])
    x = with_it.rest(np.array([0.1, 0.2, 0.3]))
    speeds = np.array([0.4, 0.03, -0.05])
    x.v[:] = speeds
    x.dtheta = x.dtheta + speeds[: with_it.nf]
    friction = np.zeros(3)
    for sign, level, coefficient in zip((1.0, -1.0), LEVELS, COEFFICIENTS, strict=True):
        w = speeds[2] + sign * speeds[1]
        f = -(level * np.tanh(w / WIDTH) + coefficient * w)
        friction += np.array([0.0, sign * f, f])
    tau = np.array([1.0, 2.0, 3.0])
    one, other = with_it.rates(x, tau, WIDTH), without.rates(x, tau + friction, WIDTH)
    np.testing.assert_allclose(one.acc, other.acc, rtol=1e-10)
    np.testing.assert_allclose(one.ddtheta, other.ddtheta, rtol=1e-10)
    np.testing.assert_allclose(one.tau_t, other.tau_t, rtol=1e-9)


@pytest.mark.parametrize("rigid", [True, False])
def test_it_holds_both_joints(rigid: bool) -> None:
    """Below what both motors hold, neither joint moves; where one of them is free, both turn."""
    robot = coupled(None, rigid=rigid)
    moved = {}
    for name, level in (("held", 30.0), ("free", 0.0)):
        both = effect(
            "differential_friction",
            "pitch",
            level_sum=30.0,
            level_difference=level,
            coefficient_sum=0.0,
            coefficient_difference=0.0,
        )
        model = FlexibleJointModel(robot, [both])
        x, step = model.rest(), make_step(model, 1e-3)
        for _ in range(100):
            x = step(x, np.array([0.0, 5.0, -5.0]))
        moved[name] = np.abs(x.v[1:] if rigid else x.dtheta[1:])
    assert np.max(moved["held"]) < 1e-6
    assert np.min(moved["free"]) > 0.1
