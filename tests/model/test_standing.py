"""At rest on the ground: forces, sinking, and that nothing moves from there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.robots.ground_robots import BOX, FEET, FLYWHEEL, box, energy_left, growth, hold

from flexjoint.core.errors import ModelError
from flexjoint.design.linearise import linearise, symbolic_linearisation
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.standing import standing
from flexjoint.robot.robot import load
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs.live import LiveSimulation
from flexjoint.simulation.trajectory import Trajectory

WEIGHT = (BOX + FLYWHEEL) * 9.81


@cache
def centauro() -> FlexibleJointModel:
    return FlexibleJointModel(load("centauro"))


def held(pose: str, seconds: float, lift: float = 0.0, which: Engine = "compiled") -> Trajectory:
    """CENTAURO commanded to hold a pose by g - J_c' lambda, released `lift` metres above its rest."""
    model = centauro()
    rest = standing(model, model.robot.configuration(pose))
    start = replace(rest.state, q=rest.state.q.copy())
    start.q[2] += lift
    ticks = round(seconds * model.robot.rates.control)
    return closed_loop(
        model, start, law_of(model.robot), hold(model, rest, ticks), RunOptions(rate=2000.0, engine=which)
    )


def carried(tape: Trajectory) -> np.ndarray:
    ground = centauro().ground
    assert ground is not None
    return np.array(ground.touch(centauro().body, tape.q[-1], tape.v[-1], tape.z[-1]).forces)


def test_a_box_sinks_as_its_weight_demands() -> None:
    model = FlexibleJointModel(box())
    rest = standing(model, model.body.neutral)
    np.testing.assert_allclose(rest.forces, np.tile([0.0, 0.0, WEIGHT / 4], (4, 1)), atol=1e-9)
    assert rest.state.q[2] == pytest.approx(0.1 - WEIGHT / 4 / FEET["stiffness"], abs=1e-12)


def test_a_slope_is_held_by_the_anchors() -> None:
    """Balance demands forces along the ground; the springs to the anchors give them at once."""
    model = FlexibleJointModel(box(gravity=(1.0, 0.5, -9.81)))
    rest = standing(model, model.body.neutral)
    total = (BOX + FLYWHEEL) * np.array([-1.0, -0.5, 9.81])
    np.testing.assert_allclose(rest.forces.sum(axis=0), total, atol=1e-8)
    tape = rollout(model, rest.state, np.zeros((500, 1)), RunOptions(rate=1000.0))
    np.testing.assert_allclose(tape.q[-1], rest.state.q, atol=1e-10)


@pytest.mark.parametrize("pose", ["initial", "spider", "mammal"])
def test_centauro_does_not_move_from_there(pose: str) -> None:
    tape = held(pose, 0.5)
    np.testing.assert_allclose(tape.q, np.tile(tape.q[0], (len(tape.q), 1)), atol=1e-10)


def test_contacts_carry_the_weight_after_a_landing_and_feet_do_not_drift() -> None:
    """Ten seconds at 2 kHz after a fall of 1 cm; required: 1e-3 of the weight, 0.1 mm, no energy gained."""
    model = centauro()
    tape = held("spider", 12.0, lift=0.01)
    forces = carried(tape)
    assert forces[:, 2].sum() == pytest.approx(model.robot.mass * 9.81, rel=1e-6)
    assert np.max(np.abs(forces[:, :2].sum(axis=0))) < 1e-3 * model.robot.mass * 9.81
    feet = [model.body.frame_placement(tape.q[row], "contact_1")[:3, 3] for row in (4000, 14000, 24000)]
    assert np.max(np.abs(np.array(feet) - feet[-1])) < 1e-4
    left = energy_left(model, tape, 20)
    assert left[0] - left[-1] > 5.0  # of the landing
    assert growth(left) < 1e-8  # rounding of some 900 J in 24000 steps


def test_engines_agree_on_a_landing() -> None:
    """1e-8 over the first second; the same bits on a second run."""
    numeric, compiled, again = (held("mammal", 1.0, 0.02, which) for which in ("pin", "compiled", "compiled"))
    for name in ("q", "v", "theta", "z"):
        expected = getattr(compiled, name)
        np.testing.assert_allclose(getattr(numeric, name), expected, rtol=0.0, atol=1e-8)
        np.testing.assert_array_equal(getattr(again, name), expected)


def test_springs_that_are_not_linear_stand_too() -> None:
    model = centauro()
    hard = effect("hardening_spring", "hip_pitch_1", cubic=1e11)
    stiff = FlexibleJointModel(model.robot, [hard])
    q = model.robot.configuration("spider")
    place = [joint.name for joint in model.joints].index("hip_pitch_1")
    k = model.flexible.index(place)
    soft, less = (standing(m, q).state for m in (model, stiff))
    link = q[model.joints[place].idx_q]
    assert 0.0 < abs(less.theta[k] - link) < abs(soft.theta[k] - link)


def test_what_cannot_stand_is_refused() -> None:
    tipping = FlexibleJointModel(box(gravity=(30.0, 0.0, -9.81)))
    with pytest.raises(ModelError, match="cannot carry the robot by pushing"):
        standing(tipping, tipping.body.neutral)
    without = FlexibleJointModel(replace(box(), contacts=()))
    with pytest.raises(ModelError, match="with contacts"):
        standing(without, without.body.neutral)


def test_a_live_simulation_stands_where_it_starts() -> None:
    sim = LiveSimulation(centauro())
    before = sim.full_state.q
    sim.run(0.2)
    np.testing.assert_allclose(sim.full_state.q, before, atol=1e-9)


def test_linear_models_refuse_contacts() -> None:
    with pytest.raises(ModelError, match="stands on contacts"):
        linearise(centauro())
    with pytest.raises(ModelError, match="stands on contacts"):
        symbolic_linearisation(centauro())
