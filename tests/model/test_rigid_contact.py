"""Rigid ground: stick, slip, rolling, landing, energy and order, of closed-form blocks and of CENTAURO."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from support.robots.arms import waves
from support.robots.ground_robots import (
    BOX,
    FLYWHEEL,
    box,
    cart,
    driven_landing,
    energy_left,
    growth,
    hold,
    lifted,
)
from support.thorough import thorough

from flexjoint.core.errors import ModelError, RobotError, SimulationError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.model.contact.rigid import RigidGround
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.standing import Standing, standing
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build, load
from flexjoint.simulation.compiled import engine
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs.live import LiveSimulation
from flexjoint.simulation.schemes import DEFAULT, SCHEMES, make_step
from flexjoint.simulation.trajectory import Trajectory

G = 9.81
WEIGHT = (BOX + FLYWHEEL) * G
SOLVED = 1e-8  # [m/s, N s] of the contact solver's 1e-10, over the masses and steps here
MU = 0.3


def rigid(robot: Robot) -> FlexibleJointModel:
    return FlexibleJointModel(replace(robot, ground="rigid"))


def passive(model: FlexibleJointModel, start: State, seconds: float) -> Trajectory:
    """Without motor torque, at 1 kHz."""
    return rollout(
        model, start, np.zeros((round(seconds * 1000), len(model.joints))), RunOptions(rate=1000.0)
    )


def forces(model: FlexibleJointModel, tape: Trajectory) -> np.ndarray:
    """(rows, c, 3) over the step that ends at each row [N]."""
    assert isinstance(model.ground, RigidGround)
    return np.array([model.ground.forces(z) for z in tape.z])


def heights(model: FlexibleJointModel, tape: Trajectory, every: int = 1) -> np.ndarray:
    assert model.ground is not None
    return np.array([model.ground.places(model.body, q)[0][:, 2] for q in tape.q[::every]])


# --- blocks --------------------------------------------------------------------------------------
def test_a_dropped_box_lands_and_neither_sinks_nor_bounces() -> None:
    model = rigid(box())
    tape = passive(model, lifted(model, 0.11), 0.3)
    assert np.min(heights(model, tape)) > -1e-9
    landed = np.flatnonzero(tape.q[:, 2] < 0.1 + 1e-9)[0]
    assert landed * 1e-3 == pytest.approx(np.sqrt(2.0 * 0.01 / G), abs=2e-3)  # two steps
    np.testing.assert_allclose(tape.q[landed:, 2], 0.1, atol=1e-9)
    # required: 1e-3; after the step in which it lands
    np.testing.assert_allclose(forces(model, tape)[landed + 2 :, :, 2].sum(axis=1), WEIGHT, rtol=1e-6)


def test_a_box_on_its_edge_lands_foot_by_foot() -> None:
    model = rigid(box())
    start = lifted(model, 0.2)
    start.q[3:7] = [np.sin(0.15), 0.0, 0.0, np.cos(0.15)]
    tape = passive(model, start, 1.0)
    assert np.min(heights(model, tape)) > -2e-4  # it turns by 1 mrad in a step: its square, times the size
    np.testing.assert_allclose(heights(model, tape)[-1], 0.0, atol=1e-6)
    assert np.max(np.abs(tape.v[-1])) < 1e-6


@pytest.mark.parametrize("slope", [0.0, 0.5 * MU, 0.999 * MU])
def test_within_the_cone_it_sticks(slope: float) -> None:
    model = rigid(box({"friction": MU}, gravity=(slope * G, 0.0, -G)))
    tape = passive(model, lifted(model, 0.1), 1.0)
    np.testing.assert_allclose(tape.q[-1, :3], [0.0, 0.0, 0.1], atol=SOLVED)
    total = forces(model, tape)[-1].sum(axis=0)
    np.testing.assert_allclose(total, [-slope * WEIGHT, 0.0, WEIGHT], atol=1e-5 * WEIGHT)


@pytest.mark.parametrize("slope", [1.001 * MU, 0.5])
def test_beyond_the_cone_it_slides_as_the_closed_form_says(slope: float) -> None:
    model = rigid(box({"friction": MU}, gravity=(slope * G, 0.0, -G)))
    tape = passive(model, lifted(model, 0.1), 1.0)
    # the midpoint rule is exact on a constant acceleration
    assert tape.v[-1, 0] == pytest.approx((slope - MU) * G, abs=1e-6)
    assert tape.q[-1, 0] == pytest.approx(0.5 * (slope - MU) * G, abs=1e-6)


def test_a_sliding_box_stops_where_it_should_and_stays() -> None:
    model = rigid(box({"friction": MU}))
    start = lifted(model, 0.1)
    start.v[:2] = [0.6, 0.8]
    tape = passive(model, start, 0.8)
    way = 1.0 / (2.0 * MU * G)
    assert tape.v[100, 0] == pytest.approx(0.6 * (1.0 - 0.1 * MU * G), abs=1e-6)
    np.testing.assert_allclose(
        tape.q[-1, :2], [0.6 * way, 0.8 * way], atol=MU * G * 1e-6
    )  # h^2: the last step
    assert np.max(np.abs(tape.v[-100:])) < SOLVED


def test_wheels_roll_without_slip_and_resist_sideways() -> None:
    model = rigid(cart({"friction": 2.0}))
    tape = rollout(model, lifted(model, 0.2), np.full((800, 4), 3.0), RunOptions(rate=1000.0))
    assert tape.v[-1, 0] > 0.2
    np.testing.assert_allclose(0.1 * tape.v[1:, 6:], np.tile(tape.v[1:, :1], 4), atol=1e-6)
    np.testing.assert_allclose(0.1 * tape.q[-1, 7:], tape.q[-1, 0], atol=1e-6)
    pushed = (0.1 * G, 0.1 * G, -G)
    for axis, free in (("0 1 0", 0), ("-1 0 0", 1)):
        model = rigid(cart({"friction": 0.5}, axis=axis, gravity=pushed))
        tape = passive(model, lifted(model, 0.2), 0.5)
        assert tape.q[-1, free] > 5e-3
        assert abs(tape.q[-1, 1 - free]) < SOLVED


def test_order_two_while_it_rolls() -> None:
    """Halving the step divides the error by four, motors, springs and feet together."""
    model = rigid(cart({"friction": 5.0}))

    def end(rate: int) -> np.ndarray:
        time = (np.arange(rate // 5) + 0.5) / rate
        torque = np.tile(8.0 * np.sin(20.0 * time)[:, None], 4)
        tape = rollout(model, lifted(model, 0.2), torque, RunOptions(rate=float(rate)))
        return np.concatenate([tape.q[-1], tape.v[-1]])

    exact = end(16000)
    errors = [np.max(np.abs(end(rate) - exact)) for rate in (500, 1000, 2000)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.15)


def test_energy_does_not_grow_beyond_the_motors_work() -> None:
    model = rigid(cart({"friction": 0.4}))
    left = energy_left(model, driven_landing(model))
    lost = left[0] - left[-1]
    assert lost > 0.5
    assert growth(left) < 1e-3 * lost


def test_what_has_sunk_in_comes_up_slowly_and_without_a_jump() -> None:
    model = rigid(box())
    tape = passive(model, lifted(model, 0.095), 0.2)
    assert np.max(np.diff(tape.q[:, 2])) < 1.1e-4  # 0.1 m/s at 1 kHz
    np.testing.assert_allclose(tape.q[100:, 2], 0.1, atol=1e-8)


# --- CENTAURO ------------------------------------------------------------------------------------
def held(model: FlexibleJointModel, pose: str, seconds: float, lift: float) -> tuple[Standing, Trajectory]:
    """Commanded to hold a pose by g - J_c' lambda, released `lift` metres above its rest."""
    rest = standing(model, model.robot.configuration(pose))
    start = replace(rest.state, q=rest.state.q.copy())
    start.q[2] += lift
    ticks = round(seconds * model.robot.rates.control)
    return rest, closed_loop(
        model, start, law_of(model.robot), hold(model, rest, ticks), RunOptions(rate=1000.0)
    )


@pytest.mark.parametrize("pose", ["initial", "mammal"])
def test_at_rest_forces_are_those_that_balance(pose: str) -> None:
    """Found by dynamics and by statics; on compliant ground the same but for the depth to which it sinks."""
    model, soft = rigid(load("centauro")), FlexibleJointModel(load("centauro"))
    rest, tape = held(model, pose, 0.1, 0.0)
    np.testing.assert_allclose(tape.q, np.tile(tape.q[0], (len(tape.q), 1)), atol=1e-9)
    np.testing.assert_allclose(forces(model, tape)[-1], rest.forces, atol=1e-3)
    sunk = standing(soft, soft.robot.configuration(pose))
    np.testing.assert_allclose(sunk.forces, rest.forces, atol=0.01 * sunk.forces[:, 2].min())
    np.testing.assert_allclose(
        sunk.tau, rest.tau, atol=1.0
    )  # 2 mm deep, tilted by 1 mrad; the largest is 90 N m


@thorough
def test_it_lands_and_stands_for_ten_seconds() -> None:
    """Required: 1e-3 of the weight, 0.1 mm of the feet in 10 s."""
    model = rigid(load("centauro"))
    _, tape = held(model, "spider", 10.5, 1e-3)
    weight = model.robot.mass * G
    assert forces(model, tape)[-1, :, 2].sum() == pytest.approx(weight, rel=1e-3)
    assert model.ground is not None
    feet = np.array([model.ground.places(model.body, tape.q[row])[0] for row in (500, 5500, 10500)])
    assert np.max(np.abs(feet - feet[0])) < 1e-4
    assert np.min(feet[:, :, 2]) > -1e-6
    assert growth(energy_left(model, tape, 20)) < 1e-6  # what the contact solver's 1e-10 adds up to


def test_it_stands_where_a_live_simulation_starts() -> None:
    sim = LiveSimulation(rigid(load("centauro")))
    before = sim.full_state.q
    sim.run(0.05)
    np.testing.assert_allclose(sim.full_state.q, before, atol=1e-8)


# --- what goes with it ---------------------------------------------------------------------------
def test_it_repeats_bit_by_bit_and_remembers_nothing_but_its_state() -> None:
    """The solver's first guess is in the state, so a new step function gives what a used one gives."""
    model = rigid(cart({"friction": 0.4}))
    one = other = lifted(model, 0.203)
    one.v[:2] = [0.3, 0.4]
    used = make_step(model, 1e-3)
    for torque in waves(4, 60, 1000.0, size=3.0):
        one, other = used(one, torque), make_step(model, 1e-3)(other, torque)
        for name in ("q", "v", "theta", "z"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert np.any(one.z != 0.0)  # it has landed


def test_forces_are_states() -> None:
    model = rigid(box())
    assert model.state_names[-3:] == ("force_x.foot_3", "force_y.foot_3", "force_z.foot_3")
    assert model.nz == 12


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name != DEFAULT])
def test_other_schemes_are_refused(scheme: str) -> None:
    model = rigid(box())
    with pytest.raises(SimulationError, match=f"{scheme} takes no rigid ground.*{DEFAULT}"):
        rollout(model, lifted(model, 0.1), np.zeros((1, 1)), RunOptions(rate=1000.0, scheme=scheme))


@pytest.mark.parametrize("scheme", [DEFAULT, "implicit_midpoint", "reference"])
def test_the_compiled_engine_is_refused_also_after_the_compliant_twin_was_compiled(scheme: str) -> None:
    """Explicit, iterating and adaptive schemes, each compiled in its own way. The twin shares the robot's
    description, contacts and numbers."""
    robot = box()
    soft, model = FlexibleJointModel(robot), rigid(robot)
    torque = np.zeros((5, 1))
    rollout(soft, lifted(soft, 0.1), torque, RunOptions(rate=1000.0, scheme=scheme, engine="compiled"))
    refused = pytest.raises(ModelError, match=r"rigid ground.*engine='pin'")
    with refused:
        rollout(model, lifted(model, 0.1), torque, RunOptions(rate=1000.0, scheme=scheme, engine="compiled"))
    with refused:
        LiveSimulation(model, RunOptions(scheme=scheme, engine="compiled"))


def test_auto_takes_the_pin_loop(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "LONG", 10)
    monkeypatch.setattr(engine, "_said", set())
    model = rigid(box())
    start, torque = lifted(model, 0.1), np.zeros((20, 1))
    with caplog.at_level(logging.INFO, logger="flexjoint"):
        tape = rollout(model, start, torque, RunOptions(rate=1000.0))
    pin_loop = rollout(model, start, torque, RunOptions(rate=1000.0, engine="pin"))
    np.testing.assert_array_equal(tape.q, pin_loop.q)
    assert "simulating by the pin loop" in caplog.text


def test_dry_friction_of_links_is_refused() -> None:
    model = FlexibleJointModel(
        replace(box(), ground="rigid"), [effect("link_coulomb_friction", "spin", level=1.0)]
    )
    with pytest.raises(ModelError, match="spin has some"):
        rollout(model, lifted(model, 0.1), np.zeros((1, 1)), RunOptions(rate=1000.0))


def test_the_robot_file_says_which_ground() -> None:
    robot = box(ground="rigid")
    assert isinstance(FlexibleJointModel(robot).ground, RigidGround)
    assert build(robot.file.model_copy(update={"base": "fixed"}), robot.path).contacts == ()
    raw = {**robot.file.model_dump(exclude_unset=True), "ground": "icy"}
    with pytest.raises(RobotError, match=r"ground.*compliant.*rigid"):
        robot_schema.parse(raw, "box.yaml")
    with pytest.raises(UnknownNameError, match=r"'icy'.*compliant, rigid"):
        FlexibleJointModel(replace(robot, ground="icy"))
