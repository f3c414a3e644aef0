"""The static law: theta_d = q_d + g(q_d)/K, springs that are not linear, and that a robot stays there."""

from __future__ import annotations

import math

import numpy as np
import pytest
from arms import PENDULUM, PLANAR, make

from flexjoint.clockwork import rollout
from flexjoint.effect import Planned, Signals, plan
from flexjoint.equilibrium import equilibrium, holding_torque
from flexjoint.errors import ModelError
from flexjoint.model import FlexibleJointModel

Q = np.array([[0.3, -0.9], [-1.2, 0.4], [0.0, 0.0]])


def gravity(q: np.ndarray) -> np.ndarray:
    """(N, 2) of the planar arm, written out: masses 3.2 and 1.5 kg, joint to joint 0.4 m."""
    hip, both = q[:, 0], q[:, 0] + q[:, 1]
    knee = 1.5 * 9.81 * 0.17 * np.sin(both)
    # +y axis: a centre of mass ahead of the axis (+x) pulls the angle up
    thigh = 3.2 * 9.81 * (0.2 * np.sin(hip) - 0.01 * np.cos(hip)) + 1.5 * 9.81 * 0.4 * np.sin(hip)
    return np.stack([thigh + knee, knee], axis=1)


def test_linear_springs_deflect_by_g_over_K() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    rest = equilibrium(model, Q)
    np.testing.assert_allclose(rest.tau, gravity(Q), atol=1e-12)
    np.testing.assert_allclose(rest.theta, Q + gravity(Q) / [800.0, 420.0], atol=1e-14)


def test_a_rigid_joint_does_not_deflect() -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": {"stiffness": math.inf}}), [])
    np.testing.assert_array_equal(equilibrium(model, Q).theta[:, 1], Q[:, 1])


def test_link_effects_share_the_load() -> None:
    model = FlexibleJointModel(make(PLANAR), [plan("cable_spring", "hip", {"stiffness": 9.0, "rest": 0.2})])
    load = holding_torque(model, Q)
    np.testing.assert_allclose(load[:, 0], gravity(Q)[:, 0] - 9.0 * (0.2 - Q[:, 0]), atol=1e-12)


def test_a_play_is_crossed_by_half_its_gap() -> None:
    model = FlexibleJointModel(make(PLANAR), [plan("backlash", "knee", {"gap": 0.02})])
    load = gravity(Q)[:2, 1]
    phi = equilibrium(model, Q[:2]).theta[:, 1] - Q[:2, 1]
    np.testing.assert_allclose(phi, load / 420.0 + 0.01 * np.sign(load), atol=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        [plan("hardening_spring", "hip", {"cubic": 1e7})],
        [plan("hardening_spring", "hip", {"cubic": 1e12})],
        [plan("transmission_error", "hip", {"amplitude": 4e-3, "cycles": 30.0, "phase": 1.0})],
        [plan("spring_preload", "hip", {"torque": 2.0}), plan("backlash", "hip", {"gap": 0.01})],
    ],
    ids=lambda effects: effects[0].effect.name,
)
def test_any_spring_then_carries_its_load(effects: list[Planned]) -> None:
    model = FlexibleJointModel(make(PLANAR), effects)
    q = np.stack([np.linspace(-1.5, 1.5, 40), np.zeros(40)], axis=1)
    rest = equilibrium(model, q)
    phi = rest.theta[:, 0] - q[:, 0]
    carried = model.flows[0].transmission(Signals(q=q[:, 0], theta=rest.theta[:, 0], phi=phi), [])
    # at a stiffness of 3e5 the last digit of phi is worth 1e-12 N m
    np.testing.assert_allclose(carried, rest.tau[:, 0], atol=1e-9)


def test_the_robot_stays_where_its_equilibrium_is() -> None:
    effects = [plan("hardening_spring", "hip", {"cubic": 1e6}), plan("backlash", "knee", {"gap": 0.01})]
    model = FlexibleJointModel(make(PLANAR), effects)
    rest = equilibrium(model, Q[:1])
    state = model.rest(Q[0])
    state.theta = rest.theta[0]
    tape = rollout(model, state, np.tile(rest.tau, (1000, 1)), 1000.0)
    np.testing.assert_allclose(tape.q[-1], Q[0], atol=1e-10)  # rounding over a second of a stable rest


def test_shapes_and_impossible_loads_are_refused() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    with pytest.raises(ModelError, match=r"\(N, 2\)"):
        equilibrium(model, np.zeros((3, 3)))
    softening = Planned(plan("hardening_spring", "joint", {}).effect, "joint", {"cubic": -1e9})
    bent = FlexibleJointModel(make(PENDULUM), [softening])
    with pytest.raises(ModelError, match="cannot carry the load"):
        equilibrium(bent, np.array([[1.2]]))
