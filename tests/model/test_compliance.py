"""A rigid joint that bends is the joint with that spring, for numbers, symbols and compiled code alike."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.robots.arms import PENDULUM, SPATIAL, make, waves

from flexjoint.core.errors import ModelError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

STIFFNESS, RELAXATION = 300.0, 2e-3  # N m/rad, s
RIGID = {"stiffness": math.inf, "damping": 0.0}


def bends(joint: str = "roll", compliance: float = 1.0 / STIFFNESS) -> Planned:
    return effect("joint_compliance", joint, compliance=compliance, relaxation=RELAXATION)


def rigid() -> Robot:
    return make(SPATIAL, {"roll": RIGID})


def sprung() -> Robot:
    return make(SPATIAL, {"roll": {"stiffness": STIFFNESS, "damping": RELAXATION * STIFFNESS}})


@pytest.mark.parametrize("engine", ["pin", "compiled"])
def test_it_moves_as_the_joint_with_that_spring(engine: str) -> None:
    torque = waves(3, 300, 1000.0, size=12.0)
    friction = effect("motor_coulomb_friction", "roll", level=0.4)
    tapes = [
        rollout(model, model.rest(), torque, RunOptions(rate=1000.0, engine=engine))
        for model in (
            FlexibleJointModel(rigid(), [bends(), friction]),
            FlexibleJointModel(sprung(), [friction]),
        )
    ]
    for name in ("q", "v", "theta", "dtheta"):
        one, other = (getattr(tape, name) for tape in tapes)
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    assert np.max(np.abs(tapes[0].theta[:, 1] - tapes[0].q[:, 1])) > 1e-3


def test_symbols_for_its_numbers_give_the_same_rates() -> None:
    symbolic, numeric = SymbolicModel(rigid(), [bends()]), FlexibleJointModel(sprung(), [])
    assert symbolic.parameters == ("joint_compliance.roll.compliance", "joint_compliance.roll.relaxation")
    x, torque = numeric.pack(numeric.rest()), np.array([1.0, 3.0, -2.0])
    x = x + np.linspace(0.02, -0.03, x.size)
    dx = symbolic.dynamics(0.02)(x, torque, symbolic.values, 0.0).full().ravel()
    np.testing.assert_allclose(dx, numeric.rhs(x, torque, 0.02), rtol=1e-11, atol=1e-10)
    softer = symbolic.set_values({"joint_compliance.roll.compliance": 2.0 / STIFFNESS})
    assert not np.allclose(symbolic.dynamics(0.02)(x, torque, softer, 0.0).full().ravel(), dx)


def test_the_stiffer_the_nearer_to_the_rigid_joint() -> None:
    """The deflection falls as 1/K, and so does what it makes of the motion."""
    torque = waves(1, 800, 1000.0, size=3.0) * np.minimum(np.arange(800) / 300, 1.0)[:, None] ** 2
    stiff = make(PENDULUM, {"joint": RIGID})
    ends = []
    for compliance in (0.0, 1e-5, 1e-4):
        model = FlexibleJointModel(stiff, [effect("joint_compliance", "joint", compliance=compliance)])
        ends.append(rollout(model, model.rest(), torque, RunOptions(rate=1000.0)).q[:, 0])
    near, far = (float(np.sqrt(np.mean((q - ends[0]) ** 2))) for q in ends[1:])
    assert 0.0 < near < 0.2 * far
    plain = FlexibleJointModel(stiff, [])
    np.testing.assert_array_equal(
        ends[0], rollout(plain, plain.rest(), torque, RunOptions(rate=1000.0)).q[:, 0]
    )


def test_what_it_cannot_be_is_refused() -> None:
    with pytest.raises(ModelError, match="has a stiffness; spring_stiffness makes it softer"):
        FlexibleJointModel(sprung(), [bends()])
    with pytest.raises(ModelError, match="bends from the start; leave `since` out"):
        FlexibleJointModel(rigid(), [effect("joint_compliance", "roll", since=1.0, compliance=1e-3)])
    with pytest.raises(ModelError, match="given twice"):
        FlexibleJointModel(rigid(), [bends(), bends(compliance=1e-3)])
    FlexibleJointModel(rigid(), [bends(), effect("backlash", "roll", gap=1e-3)])  # it has a spring now
