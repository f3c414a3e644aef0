"""Every scheme, compiled: with all effects and laws at once, and what is special where a scheme iterates."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.loops import FRICTIONS, GAINS, agree, loops_agree, moving, references
from support.robots.arms import PLANAR, SPATIAL, make, one_of_each, waves
from support.robots.example_robots import ur5
from support.robots.ground_robots import cart, lifted
from support.thorough import sample

from flexjoint.core.errors import SimulationError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.compiled import CompiledRates, shared
from flexjoint.simulation.controllers import LAWS, gain_names, law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.runs.batch import rollouts
from flexjoint.simulation.schemes import SCHEMES, implicit
from flexjoint.simulation.schemes.reference import continuous_control

ITERATING = ("implicit_midpoint", "reference")
WIDTH = 0.05  # [rad/s] of smoothed dry friction
JOINTS = ("yaw", "roll", "pitch")
pytestmark = pytest.mark.usefixtures("own_cache")


def every_effect() -> list[Planned]:
    """The catalogue, its effects in turn on the three joints; those on two are in test_coupled_schemes.py."""
    found = [e for e in one_of_each(JOINTS[0]) if not e.effect.reaches_before]
    return [e if e.joint is None else replace(e, joint=JOINTS[k % 3]) for k, e in enumerate(found)]


def controlled_by(names: tuple[str, str, str]) -> dict[str, dict[str, object]]:
    laws = {}
    for joint, name in zip(JOINTS, names, strict=True):
        own = {gain: value for gain, value in GAINS.items() if gain in gain_names(LAWS[name])}
        laws[joint] = {"controller": {"name": name, **own}}
    return laws


# ------------------------------------------------------------------ agreement over a second
@pytest.mark.parametrize("scheme", sample(SCHEMES, one_in=2))
def test_every_scheme_agrees_with_all_effects_at_once(scheme: str) -> None:
    """Under three laws, with what they read late, two steps to a tick. The motion multiplies what its start
    differs by, 1e-12 and 1e-11, to 1e-9 and 6e-9: rounding is seen a thousandfold."""
    laws = controlled_by(("motor_pd", "full_state", "torque_loop"))
    robot = make(SPATIAL, laws, rates={"physics": 1000, "control": 500}, sensing_delay=0.0013)
    loops_agree(robot, every_effect(), 1000.0, scheme, WIDTH, atol=1e-8)


@pytest.mark.parametrize("scheme", sample(SCHEMES, one_in=3))
def test_every_scheme_agrees_on_a_floating_base_with_a_rigid_joint(scheme: str) -> None:
    """Rubbing links, a motor that sticks, the two laws that are left."""
    laws = {**controlled_by(("motor_pd", "link_pd", "velocity")), "yaw": {"stiffness": math.inf}}
    robot = make(SPATIAL, laws, base="floating", rates={"physics": 2000, "control": 500})
    loops_agree(robot, FRICTIONS, 2000.0, scheme, WIDTH)


@pytest.mark.parametrize("scheme", ITERATING)
def test_schemes_that_iterate_agree_on_an_arm_of_six_joints(scheme: str) -> None:
    loops_agree(ur5(), None, 1000.0, scheme, WIDTH)


@pytest.mark.parametrize("scheme", ITERATING)
def test_schemes_that_iterate_agree_through_onsets(scheme: str) -> None:
    late = [
        replace(effect("spring_hysteresis", "hip"), since=0.2),
        replace(effect("payload", "knee", mass=0.6), since=0.4),
        replace(effect("torque_delay", "hip", delay=0.0043), since=0.6),
    ]
    loops_agree(make(PLANAR), late, 1000.0, scheme, WIDTH)


def test_implicit_midpoint_agrees_on_contacts() -> None:
    model = FlexibleJointModel(cart({"friction": 0.4}))
    start = lifted(model, 0.21)
    start.v[:3] = [0.3, 0.4, 0.0]
    torque = waves(4, 500, 1000.0, size=3.0)  # it lands within 0.05 s
    tapes = [
        rollout(model, start, torque, RunOptions(rate=1000.0, scheme="implicit_midpoint", engine=kind))
        for kind in ("pin", "compiled")
    ]
    agree(*tapes)


# ------------------------------------------------------------------ Newton's method in C
def test_a_run_repeats_bit_by_bit_where_a_scheme_iterates() -> None:
    model = FlexibleJointModel(make(PLANAR), every_effect_on("knee"))
    for scheme in ITERATING:
        runs = [
            rollout(
                model,
                moving(model),
                waves(2, 200, 1000.0),
                RunOptions(rate=1000.0, scheme=scheme, width=WIDTH, engine="compiled"),
            )
            for _ in range(2)
        ]
        np.testing.assert_array_equal(runs[0].q, runs[1].q)


def every_effect_on(joint: str) -> list[Planned]:
    return [effect(name, joint) for name in ("backlash", "stribeck_friction", "spring_hysteresis")]


def test_a_step_that_does_not_converge_is_an_error_in_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same step and joint in the same words; a batch names the time."""
    model = FlexibleJointModel(make(PLANAR), [effect("hardening_spring", "knee", cubic=1e5)])
    start = moving(model)
    start.theta[1] += 0.3
    torque = np.zeros((40, 2))
    monkeypatch.setattr(implicit, "ITERATIONS", 2)
    shared._made.clear()
    said = []
    for kind in ("pin", "compiled"):
        with pytest.raises(SimulationError, match=r"did not converge in the step from t = .* knee") as caught:
            rollout(model, start, torque, RunOptions(rate=200.0, scheme="implicit_midpoint", engine=kind))
        said.append(str(caught.value))
    many = rollouts(
        model, start, torque, RunOptions(rate=200.0, scheme="implicit_midpoint", engine="compiled")
    )
    assert said[0] == said[1]
    assert many.failed_at[0] == pytest.approx(0.005, abs=1e-12)  # the first step
    shared._made.clear()  # these programs iterate twice


@pytest.mark.parametrize("scheme", ITERATING)
def test_a_batch_of_a_scheme_that_iterates_is_the_single_run(scheme: str) -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    torque, stiffness = waves(2, 100, 1000.0), np.array([420.0, 300.0])
    parameters = {"drive.knee.stiffness": stiffness}
    ends = [
        rollouts(
            model,
            moving(model),
            torque,
            RunOptions(rate=1000.0, scheme=scheme, engine=kind),
            parameters=parameters,
            workers=1,
        ).final
        for kind in ("pin", "compiled")
    ]
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-10)  # 0.1 s of test_compiled's 1e-9 a second
    assert np.max(np.abs(ends[0][0] - ends[0][1])) > 1e-4


# ------------------------------------------------------------------ the right-hand side in C
def test_continuous_control_takes_compiled_rates() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("link_coulomb_friction", "knee", level=0.3)])
    law, told = law_of(model.robot), {k: v[200] for k, v in references(model.robot).items()}
    ends = [
        continuous_control(one, moving(model), law, lambda _t: told, np.linspace(0, 0.3, 7), width=WIDTH).x
        for one in (model, CompiledRates(model))
    ]
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-9)  # the solver's own tolerance


def test_compiled_rates_are_those_of_the_model() -> None:
    model = FlexibleJointModel(make(SPATIAL, base="floating"), every_effect())
    compiled, x = CompiledRates(model), moving(model)
    x.z, tau_m = x.z + 0.01, np.array([3.0, -2.0, 1.0])
    for width in (WIDTH, None):
        one, other = model.rates(x, tau_m, width), compiled.rates(x, tau_m, width)
        for name in ("v", "acc", "dtheta", "ddtheta", "dz", "tau_t"):
            # two orders of the same sums
            np.testing.assert_allclose(
                getattr(other, name), getattr(one, name), rtol=1e-10, atol=1e-10, err_msg=name
            )
