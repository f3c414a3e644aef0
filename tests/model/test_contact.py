"""Contact with the ground: depth, stick, slip, rolling, energy, in every scheme and both engines."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.robots.arms import waves
from support.robots.ground_robots import (
    BOX,
    FEET,
    FLYWHEEL,
    HALF,
    box,
    cart,
    driven_landing,
    energy_left,
    growth,
    lifted,
)

from flexjoint.core.errors import ModelError, RobotError, StabilityWarning
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build, load
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes import DEFAULT, SCHEMES
from flexjoint.simulation.schemes.reference import continuous_control
from flexjoint.simulation.schemes.stability import check_stability
from flexjoint.simulation.trajectory import Trajectory

G = 9.81
WEIGHT = (BOX + FLYWHEEL) * G
DEPTH = WEIGHT / 4 / FEET["stiffness"]
ONE_STEP = [scheme for scheme in SCHEMES if scheme not in ("implicit_midpoint", "reference")]
CALM = {"dissipation": 20.0}  # comes to rest within a second


def passive(model: FlexibleJointModel, start: State, seconds: float, scheme: str = DEFAULT) -> Trajectory:
    """Without motor torque, at 1 kHz."""
    torque = np.zeros((round(seconds * 1000), len(model.joints)))
    return rollout(model, start, torque, RunOptions(rate=1000.0, scheme=scheme))


def forces(model: FlexibleJointModel, tape: Trajectory, row: int) -> np.ndarray:
    """(c, 3) on the robot [N]."""
    assert model.ground is not None
    return np.array(model.ground.touch(model.body, tape.q[row], tape.v[row], tape.z[row]).forces)


@pytest.mark.parametrize("scheme", ONE_STEP)
def test_a_dropped_box_settles_at_the_depth_that_carries_it(scheme: str) -> None:
    model = FlexibleJointModel(box(CALM))
    tape = passive(model, lifted(model, 0.11), 1.5, scheme)
    # explicit Euler feeds the bounce: about a tenth of the depth is left of it
    close = 0.2 if scheme == "explicit_euler" else 1e-3
    assert tape.q[-1, 2] == pytest.approx(0.1 - DEPTH, abs=close * DEPTH)
    assert forces(model, tape, -1)[:, 2].sum() == pytest.approx(WEIGHT, rel=close)
    np.testing.assert_allclose(tape.q[-1, :2], 0.0, atol=1e-9)  # nothing pushes sideways


def test_a_sphere_stands_a_radius_higher() -> None:
    model = FlexibleJointModel(box({**CALM, "radius": 0.03}))
    tape = passive(model, lifted(model, 0.14), 1.5)
    assert tape.q[-1, 2] == pytest.approx(0.13 - DEPTH, abs=1e-3 * DEPTH)


@pytest.mark.parametrize("scheme", ["implicit_midpoint", "reference"])
def test_schemes_that_iterate_take_contacts(scheme: str) -> None:
    """Against the default at a quarter of its step, over a landing and its first bounce."""
    model = FlexibleJointModel(box(CALM))
    start = lifted(model, 0.1005)
    tape = rollout(model, start, np.zeros((40, 1)), RunOptions(rate=1000.0, scheme=scheme))
    fine = rollout(model, start, np.zeros((160, 1)), RunOptions(rate=4000.0))
    np.testing.assert_allclose(tape.q[-1], fine.q[-1], atol=2e-6)  # the landing is a kink: order 1 there


def test_order_two_while_it_stands() -> None:
    """Halving the step divides the error by four: a box that rocks on its feet; none lifts or slips."""
    model = FlexibleJointModel(box({"friction": 5.0}))
    start = lifted(model, 0.1 - DEPTH)
    start.v[:7] = [2e-3, 1e-3, 5e-3, 0.01, -0.02, 0.01, 1.0]

    def end(scheme: str, rate: int) -> np.ndarray:
        tape = rollout(model, start, np.zeros((rate // 20, 1)), RunOptions(rate=float(rate), scheme=scheme))
        return np.concatenate([tape.q[-1, :7], tape.v[-1, :6]])

    exact = end("rk4", 16000)
    errors = [np.max(np.abs(end(DEFAULT, rate) - exact)) for rate in (2000, 4000, 8000)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("scheme", ONE_STEP)
def test_a_sliding_box_brakes_by_mu_g(scheme: str) -> None:
    mu, speed = 0.3, 1.0
    model = FlexibleJointModel(box({**CALM, "friction": mu}))
    start = lifted(model, 0.1 - DEPTH)
    start.v[0] = speed
    tape = passive(model, start, 0.2, scheme)
    # the feet's heights adapt to the new load at first: half a per cent of mu g over this time
    assert (tape.v[50, 0] - tape.v[200, 0]) / 0.15 == pytest.approx(mu * G, rel=0.01)


def test_a_sliding_box_comes_to_rest_and_stays() -> None:
    mu, speed = 0.3, 1.0
    model = FlexibleJointModel(box({**CALM, "friction": mu}))
    start = lifted(model, 0.1 - DEPTH)
    start.v[0] = speed
    tape = passive(model, start, 1.5)
    assert tape.q[-1, 0] == pytest.approx(speed**2 / (2.0 * mu * G), rel=0.02)  # it rocks at the start
    assert np.ptp(tape.q[1000:, 0]) < 1e-5


def test_it_sticks_on_a_slope_for_ten_seconds() -> None:
    """Gravity at atan(0.2); smoothed friction would creep by 1 mm (docs/howto/contact.md)."""
    model = FlexibleJointModel(box({**CALM, "friction": 0.3}, gravity=(0.2 * G, 0.0, -G)))
    tape = passive(model, lifted(model, 0.1 - DEPTH), 12.0)
    moved = np.abs(tape.q[2000:, :3] - tape.q[2000, :3])
    assert np.max(moved) < 1e-6  # required: 1e-4
    total = forces(model, tape, -1).sum(axis=0)
    np.testing.assert_allclose(total, [-0.2 * WEIGHT, 0.0, WEIGHT], atol=1e-3 * WEIGHT)


def test_it_slides_on_a_steeper_slope() -> None:
    mu, slope = 0.3, 0.5
    model = FlexibleJointModel(box({**CALM, "friction": mu}, gravity=(slope * G, 0.0, -G)))
    tape = passive(model, lifted(model, 0.1 - DEPTH), 0.6)
    gained = tape.v[600, 0] - tape.v[300, 0]
    assert gained / 0.3 == pytest.approx((slope - mu) * G, rel=0.02)  # it rocks a little


@pytest.mark.parametrize("scheme", [DEFAULT, "semi_implicit_euler", "rk4"])
def test_anchors_follow_feet_in_the_air(scheme: str) -> None:
    """So that a foot is held where it lands, and not where it started."""
    model = FlexibleJointModel(box())
    start = lifted(model, 0.15)
    start.v[0] = 0.5
    tape = passive(model, start, 0.09, scheme)
    assert np.all(forces(model, tape, -1) == 0.0)
    late = tape.q[-1, 0] + HALF - tape.z[-1, 0]
    assert abs(late) <= 0.5 * 1e-3 + 1e-12  # a step at most


@pytest.mark.parametrize("scheme", [DEFAULT, "semi_implicit_euler", "rk4"])
def test_wheels_roll_without_slip(scheme: str) -> None:
    model = FlexibleJointModel(cart(CALM))
    start = lifted(model, 0.2 - DEPTH)
    tape = rollout(model, start, np.full((800, 4), 3.0), RunOptions(rate=1000.0, scheme=scheme))
    speed, spin = tape.v[-1, 0], tape.v[-1, 6:]
    assert speed > 0.2
    np.testing.assert_allclose(0.1 * spin, speed, rtol=2e-3)  # what the anchors' springs still give way
    turned = tape.q[-1, 7:] - tape.q[0, 7:]
    np.testing.assert_allclose(0.1 * turned, tape.q[-1, 0], rtol=2e-3)


def test_wheels_resist_sideways_and_turned_wheels_roll_there() -> None:
    pushed = (0.1 * G, 0.1 * G, -G)
    rests = {"friction": 0.5}
    along = FlexibleJointModel(cart({**CALM, **rests}, gravity=pushed))
    across = FlexibleJointModel(cart({**CALM, **rests}, axis="-1 0 0", gravity=pushed))
    for model, free in ((along, 0), (across, 1)):
        tape = passive(model, lifted(model, 0.2 - DEPTH), 0.5)
        assert tape.q[-1, free] > 5e-3  # the motors' damping brakes
        assert abs(tape.q[-1, 1 - free]) < 1e-3


def test_energy_does_not_grow_beyond_the_motors_work() -> None:
    robot = cart({"dissipation": 2.0, "friction": 0.4})
    model = FlexibleJointModel(robot)
    left = energy_left(model, driven_landing(model))
    lost = left[0] - left[-1]
    assert lost > 0.5  # the landing and the slip cost something
    # a landing at 1 kHz: its order-1 error, which halves with the step
    assert growth(left) < 0.01 * lost


def test_engines_agree_and_repeat(tmp_path: Path) -> None:
    model = FlexibleJointModel(cart({"friction": 0.4}))
    start = lifted(model, 0.21)
    start.v[:3] = [0.3, 0.4, 0.0]
    torque = waves(4, 1000, 1000.0, size=3.0)
    tapes = [
        rollout(model, start, torque, RunOptions(rate=1000.0, engine=which))
        for which in ("pin", "pin", "compiled", "compiled")
    ]
    for name in ("q", "v", "theta", "z"):
        rows = [getattr(tape, name) for tape in tapes]
        np.testing.assert_array_equal(rows[0], rows[1])
        np.testing.assert_array_equal(rows[2], rows[3])
        np.testing.assert_allclose(rows[0], rows[2], rtol=0.0, atol=1e-8)


def test_contact_numbers_are_part_of_the_compiled_structure() -> None:
    torque = np.zeros((400, 4))
    heights = []
    for stiffness in (2e4, 8e4):
        model = FlexibleJointModel(cart({**CALM, "stiffness": stiffness}))
        tape = rollout(model, lifted(model, 0.2), torque, RunOptions(rate=1000.0, engine="compiled"))
        heights.append(tape.q[-1, 2])
    assert heights[0] < heights[1] - 1e-4


@pytest.mark.parametrize(
    ("number", "value"), [("stiffness", 1e8), ("tangential_stiffness", 1e8), ("tangential_damping", 600.0)]
)
def test_a_contact_that_a_step_cannot_hold_is_named(number: str, value: float) -> None:
    model = FlexibleJointModel(cart({number: value}))
    with pytest.warns(StabilityWarning, match=f"contact of hub_0.*{number}"):
        check_stability(model, lifted(model, 0.2), 1e-3, DEFAULT)


def test_contacts_within_the_limits_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for robot in (box(), cart(), load("centauro")):
            model = FlexibleJointModel(robot)
            check_stability(model, model.rest(), 1.0 / robot.rates.physics, DEFAULT)


# --- robot files ---------------------------------------------------------------------------------
def test_names_of_anchors_and_no_contacts_without_a_floating_base() -> None:
    robot = box()
    model = FlexibleJointModel(robot)
    assert model.state_names[-2:] == ("anchor_x.foot_3", "anchor_y.foot_3")
    assert model.nz == 8
    fixed = build(robot.file.model_copy(update={"base": "fixed"}), robot.path)
    assert fixed.contacts == ()
    assert FlexibleJointModel(replace(robot, contacts=())).nz == 0


def test_continuous_control_says_that_it_knows_no_contacts() -> None:
    model = FlexibleJointModel(box())
    with pytest.raises(ModelError, match="cannot have contacts"):
        continuous_control(model, model.rest(), None, dict, np.array([0.0, 1.0]))  # type: ignore[arg-type]


def rebuilt(robot: Robot, contacts: list[dict[str, object]]) -> Robot:
    raw = {**robot.file.model_dump(exclude_unset=True), "contacts": contacts}
    return build(robot_schema.parse(raw, "box.yaml"), robot.path)


@pytest.mark.parametrize(
    ("contact", "message"),
    [
        ({"frame": "sole"}, "unknown frame 'sole'"),
        ({"frame": "foot_0", "radius": -1}, "radius"),
        ({"frame": "foot_0", "stiffness": 0}, "stiffness"),
        ({"frame": "foot_0", "friktion": 1}, "unknown key 'friktion'.*friction"),
        ({"frame": "foot_0", "rolls": "spin"}, "has no radius"),
        ({"frame": "foot_0", "rolls": "wheel", "radius": 0.1}, "unknown joint 'wheel'"),
        ({"radius": 0.1}, "frame is missing"),
    ],
)
def test_what_is_wrong_with_a_contact_is_said(contact: dict[str, object], message: str) -> None:
    with pytest.raises(RobotError, match=message):
        rebuilt(box(), [contact])


def test_a_contact_is_listed_once() -> None:
    with pytest.raises(RobotError, match="listed twice"):
        rebuilt(box(), [{"frame": "foot_0"}, {"frame": "foot_0"}])
