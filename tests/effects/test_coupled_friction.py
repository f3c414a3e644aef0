"""Friction that a joint shares with the one before it, by one motor or by two of a differential: torques on
both, typed here."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.arms import SPATIAL, make
from support.robots.coupled_robots import coupled

from flexjoint.core.errors import ModelError
from flexjoint.design.quasilinear import describing
from flexjoint.effects import Planned, Signals, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.schemes import make_step

LEVEL, COEFFICIENT, WIDTH = 1.5, 0.8, 0.02


SUM, DIFFERENCE = (
    effect("coupled_friction", "pitch", level=LEVEL, coefficient=COEFFICIENT, speed=speed)
    for speed in ("sum", "difference")
)
BOTH = effect(
    "differential_friction",
    "pitch",
    level_sum=LEVEL,
    coefficient_sum=COEFFICIENT,
    level_difference=0.6,
    coefficient_difference=0.3,
)
SHAFTS: tuple[tuple[Planned, tuple[tuple[float, float, float], ...]], ...] = (  # sign, level, coefficient
    (SUM, ((1.0, LEVEL, COEFFICIENT),)),
    (DIFFERENCE, ((-1.0, LEVEL, COEFFICIENT),)),
    (BOTH, ((1.0, LEVEL, COEFFICIENT), (-1.0, 0.6, 0.3))),
)


@pytest.mark.parametrize(("friction", "shafts"), SHAFTS, ids=["sum", "difference", "differential"])
@pytest.mark.parametrize("rigid", [True, False])
def test_it_acts_on_both_joints_by_the_speed_of_what_it_rubs_on(
    friction: Planned, shafts: tuple[tuple[float, float, float], ...], rigid: bool
) -> None:
    """w = dtheta + sign dtheta_before; the torque f(w) on this joint, and sign f(w) on the one before."""
    robot = coupled(None, rigid=rigid)
    with_it, without = FlexibleJointModel(robot, [friction]), FlexibleJointModel(robot, [])
    x = with_it.rest(np.array([0.1, 0.2, 0.3]))
    x.v[:] = 0.4, 0.03, -0.05
    x.dtheta = x.dtheta + np.array([0.4, 0.03, -0.05])[: with_it.nf]
    rubbing = np.zeros(3)
    for sign, level, coefficient in shafts:
        w = -0.05 + sign * 0.03
        f = -(level * np.tanh(w / WIDTH) + coefficient * w)
        rubbing += np.array([0.0, sign * f, f])
    tau = np.array([1.0, 2.0, 3.0])
    one = with_it.rates(x, tau, WIDTH)
    other = without.rates(x, tau + rubbing, WIDTH)
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


@pytest.mark.parametrize("rigid", [True, False])
def test_a_differential_holds_both_joints(rigid: bool) -> None:
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


def test_the_first_joint_has_none_before_it() -> None:
    with pytest.raises(ModelError, match="there is no joint before it; name the later one"):
        FlexibleJointModel(make(SPATIAL), [effect("coupled_friction", "yaw")])


def test_joints_of_both_kinds_are_refused() -> None:
    robot = make(SPATIAL, {"pitch": {"stiffness": float("inf")}})
    with pytest.raises(ModelError, match="roll and pitch share a motor, and not all are rigid"):
        FlexibleJointModel(robot, [effect("coupled_friction", "pitch")])


def test_its_special_cases_are_its_motors() -> None:
    """Each with its own numbers."""
    assert [(one.key, dict(one.values)) for one in BOTH.special_cases("coupled_friction")] == [
        (SUM.key, dict(SUM.values)),
        (DIFFERENCE.key, {"level": 0.6, "coefficient": 0.3, "speed": "difference"}),
    ]


@pytest.mark.parametrize(("friction", "shafts"), SHAFTS, ids=["sum", "difference", "differential"])
def test_its_describing_function_is_that_of_its_shafts(
    friction: Planned, shafts: tuple[tuple[float, float, float], ...]
) -> None:
    """A dry friction of level F whose speed swings by A is a damper of 4 F / (pi A) (Gelb and Vander Velde
    1968): beside the viscous friction, torques on both joints."""
    swing, robot = 0.5, coupled(None, rigid=True)
    line = describing(friction, Signals(), {"dtheta": swing})
    rates = [FlexibleJointModel(robot, some) for some in ([line], [])]
    x = rates[0].rest(np.array([0.1, 0.2, 0.3]))
    x.v[:] = 0.4, 0.03, -0.05
    rubbing = np.zeros(3)
    for sign, level, coefficient in shafts:
        f = -(coefficient + 4.0 * level / (np.pi * swing)) * (-0.05 + sign * 0.03)
        rubbing += np.array([0.0, sign * f, f])
    one, other = rates[0].rates(x, np.zeros(3), WIDTH), rates[1].rates(x, rubbing, WIDTH)
    np.testing.assert_allclose(one.acc, other.acc, rtol=1e-6)
