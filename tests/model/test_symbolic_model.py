"""The CasADi model against the numeric one: the same lines, so they agree to rounding."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from support.robots.arms import PENDULUM, SPATIAL, make, one_of_each, waves

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes.discrete import DiscreteModel
from flexjoint.simulation.sensors import readings

STEPS = 60


def agree(robot: Robot, effects: list[Planned], atol: float = 1e-11) -> None:
    """Step and readings over 60 steps, and the continuous dynamics, against the numeric path."""
    numeric, symbolic = FlexibleJointModel(robot, effects), SymbolicModel(robot, effects)
    n = len(robot.joints)
    start = numeric.rest()
    start.v = start.v + np.linspace(0.5, -1.0, numeric.nv)
    start.dtheta = start.dtheta + np.linspace(0.4, -0.9, numeric.nf)
    torque = waves(n, STEPS, 50.0, size=12.0)
    tape = rollout(numeric, start, torque, RunOptions(rate=1000.0))
    seen = readings(numeric, tape)
    discrete = DiscreteModel(symbolic, 1000.0)
    step, measure = discrete.step(), discrete.measure()
    x = discrete.start(start, torque[0])
    for k in range(STEPS):
        y = measure(x, torque[k], symbolic.values, 1e-3 * k).full().ravel()
        expected = [seen[tuple(name.split(".", 1))][k] for name in symbolic.reading_names]
        # readings hold K phi and hysteresis: stiffnesses of some hundreds scale the rounding of states
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e3 * atol)
        x = step(x, torque[k], symbolic.values, 1e-3 * k).full().ravel()
    parts = (tape.q, tape.v, tape.theta, tape.dtheta, tape.z)
    np.testing.assert_allclose(x[: numeric.nx], np.concatenate([p[-1] for p in parts]), rtol=0, atol=atol)
    if numeric.nq == numeric.nv:
        x0 = numeric.pack(start) + 0.01
        dx = symbolic.dynamics(0.02)(x0, torque[3], symbolic.values, 0.3).full().ravel()
        np.testing.assert_allclose(dx, numeric.rhs(x0, torque[3], 0.02, 0.3), rtol=1e-12, atol=1e-11)


@pytest.mark.usefixtures("one_pass")
@pytest.mark.parametrize("planned", one_of_each("roll"), ids=lambda planned: planned.effect.name)
def test_every_effect_agrees(planned: Planned) -> None:
    agree(make(SPATIAL), [planned])


@pytest.mark.usefixtures("one_pass")
def test_rigid_joints_several_frictions_and_a_floating_base_agree() -> None:
    frictions = [
        effect("link_coulomb_friction", "yaw", level=0.3),
        effect("link_coulomb_friction", "pitch", level=0.2),
        effect("motor_coulomb_friction", "roll", level=0.5),
    ]
    agree(make(SPATIAL, {"roll": {"stiffness": math.inf}}), frictions)
    agree(make(SPATIAL, base="floating"), frictions)


def test_parameters_are_named_and_set_by_name() -> None:
    effects = [effect("backlash", "roll", gap=0.01), effect("payload", "pitch", mass=0.4)]
    symbolic = SymbolicModel(make(SPATIAL), effects)
    assert symbolic.parameters == (
        "backlash.roll.gap",
        "payload.pitch.mass",
        "payload.pitch.position[0]",
        "payload.pitch.position[1]",
        "payload.pitch.position[2]",
    )
    np.testing.assert_array_equal(symbolic.set_values({"payload.pitch.mass": 1.0}), [0.01, 1.0, 0, 0, 0])
    with pytest.raises(UnknownNameError, match=r"backlash\.roll\.gap"):
        symbolic.set_values({"backlash.gap": 1.0})
    with pytest.raises(ModelError, match="rate"):
        DiscreteModel(symbolic, 0.0)


@pytest.mark.parametrize(
    ("planned", "name"),
    [
        (effect("spring_stiffness", "roll", scale=0.1), "scale"),
        (effect("hardening_spring", "roll", cubic=1e4), "cubic"),
        (effect("torque_delay", "roll", delay=0.0033), "delay"),
        (effect("sensor_delay", "roll", delay=0.0033), "delay"),
        (effect("payload", "pitch", mass=0.3, position=(0.1, 0.0, -0.2)), "mass"),
        (effect("spring_hysteresis", "roll"), "level"),
    ],
    ids=lambda value: value.effect.name if isinstance(value, Planned) else value,
)
def test_derivatives_by_parameters_exist_and_match_differences(planned: Planned, name: str) -> None:
    """The end of a rollout by one effect parameter: identification needs it, delays included."""
    robot = make(SPATIAL)
    symbolic = SymbolicModel(robot, [planned])
    numeric = FlexibleJointModel(robot, [planned])
    discrete = DiscreteModel(symbolic, 1000.0)
    torque = waves(3, STEPS, 200.0, size=12.0)
    roll = discrete.step().mapaccum("roll", STEPS)
    p = ca.MX.sym("p", len(symbolic.values))
    start = discrete.start(numeric.rest(np.array([0.1, 0.4, -0.3])), torque[0])
    path = roll(start, torque.T, ca.repmat(p, 1, STEPS), np.arange(STEPS)[None, :] * 1e-3)
    y = discrete.measure()(path[:, -1], torque[-1], p, STEPS * 1e-3)
    place = symbolic.parameters.index(f"{planned.effect.name}.{planned.joint}.{name}")
    gradient = ca.Function("g", [p], [ca.jacobian(y, p)[:, place]])(symbolic.values).full().ravel()
    output = ca.Function("y", [p], [y])
    step = 1e-5 * max(abs(symbolic.values[place]), 1e-2)
    ahead, behind = (
        output(symbolic.set_values({symbolic.parameters[place]: symbolic.values[place] + side * step}))
        .full()
        .ravel()
        for side in (1, -1)
    )
    difference = (ahead - behind) / (2 * step)
    assert np.max(np.abs(gradient)) > 0.0
    # central differences: truncation of 1e-10, rounding of 1e-14 over the step
    np.testing.assert_allclose(gradient, difference, rtol=1e-5, atol=1e-5 * np.max(np.abs(gradient)))


def test_readings_are_named_and_rigid_joints_have_no_spring_torque() -> None:
    symbolic = SymbolicModel(make(PENDULUM, {"joint": {"stiffness": math.inf}}), [])
    assert symbolic.reading_names == ("q.joint", "dq.joint", "theta.joint", "dtheta.joint")
    y = symbolic.measure()(np.array([0.3, -0.2]), [1.0], symbolic.values, 0.0).full().ravel()
    np.testing.assert_array_equal(y, [0.3, -0.2, 0.3, -0.2])
