"""Control laws: their torque by hand, on numbers and expressions, closed on a robot; ticks and references."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make

from flexjoint.core.errors import RobotError, SimulationError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.start import at_rest
from flexjoint.simulation.controllers import (
    LAWS,
    FullState,
    LinkPD,
    Mixed,
    MotorPD,
    TorqueLoop,
    Velocity,
    gain_names,
    gains_of,
    law_of,
    with_gain,
)
from flexjoint.simulation.loop import REFERENCES, Ticks
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.references import Profile, constant, tomei
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.sensors import true_signals

TOLD = {"q_ref": 0.5, "theta_ref": 0.6, "dtheta_ref": 0.4, "tau_ff": 7.0}
SEEN = {"q": 0.1, "dq": -0.3, "theta": 0.15, "dtheta": -0.2, "tau_t": 5.0}
GAINS = {"kp": 10.0, "kd": 2.0, "kp_link": 30.0, "kd_link": 4.0, "k_torque": 1.5, "kd_spring": 0.5}
BY_HAND = {  # N m
    "motor_pd": 7 + 10 * (0.6 - 0.15) + 2 * (0.4 + 0.2),
    "link_pd": 7 + 10 * (0.5 - 0.1) - 2 * -0.3,
    "full_state": 7 + 10 * 0.45 + 2 * 0.6 + 30 * 0.4 + 4 * (0.4 + 0.3) + 1.5 * (7 - 5),
    "torque_loop": 2.5 * (7 + 10 * 0.4 + 2 * 0.7) - 1.5 * 5 - 0.5 * (-0.2 + 0.3),
    "velocity": 7 + 2 * 0.6,
}


def law(name: str, limit: float = 1e3, size: int = 1) -> Any:
    values = {gain: np.full(size, {**GAINS, "limit": limit}[gain]) for gain in gain_names(LAWS[name])}
    return LAWS[name](**values)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_what_its_equation_says_and_saturates_the_total(name: str) -> None:
    told, seen = ({k: np.array([v]) for k, v in table.items()} for table in (TOLD, SEEN))
    assert law(name).torque(told, seen)[0] == pytest.approx(BY_HAND[name], abs=1e-12)
    assert law(name, limit=3.0).torque(told, seen)[0] == 3.0
    assert law(name, limit=3.0).demand(told, seen)[0] == pytest.approx(BY_HAND[name], abs=1e-12)
    symbols = {k: ca.SX.sym(k, 1) for k in (*TOLD, *SEEN)}
    given = {k: symbols[k] for k in TOLD}, {k: symbols[k] for k in SEEN}
    same = ca.Function("law", list(symbols.values()), [law(name).torque(*given)])
    assert float(same(*TOLD.values(), *SEEN.values())) == pytest.approx(BY_HAND[name], abs=1e-12)


def test_five_named_gains_a_joint() -> None:
    assert gain_names(FullState) == ("kp", "kd", "kp_link", "kd_link", "k_torque", "limit")


def test_joints_may_have_different_laws() -> None:
    wheel = {"controller": {"name": "velocity", "kd": 3.0}}
    loop = {"controller": {"name": "torque_loop", "kp": 40.0, "k_torque": 2.0}}
    mixed = law_of(make(SPATIAL, {"yaw": wheel, "pitch": loop}))
    assert isinstance(mixed, Mixed)
    assert set(mixed.reads) == {"theta", "dtheta", "q", "dq", "tau_t"}
    told, seen = ({k: np.full(3, v) for k, v in table.items()} for table in (TOLD, SEEN))
    expected = [
        Velocity(np.array([3.0]), np.array([60.0])),
        MotorPD(np.array([1600.0]), np.array([17.0]), np.array([60.0])),
        TorqueLoop(*(np.array([x]) for x in (40.0, 8.0, 2.0, 0.0, 28.0))),
    ]
    one = ({k: v[:1] for k, v in told.items()}, {k: v[:1] for k, v in seen.items()})
    np.testing.assert_allclose(mixed.torque(told, seen), [float(x.torque(*one)[0]) for x in expected])
    np.testing.assert_array_equal(mixed.limit, [60.0, 60.0, 28.0])
    symbols = {k: ca.SX.sym(k, 3) for k in (*TOLD, *SEEN)}
    out = mixed.torque({k: symbols[k] for k in TOLD}, {k: symbols[k] for k in SEEN})
    same = ca.Function("law", list(symbols.values()), [out])(*told.values(), *seen.values())
    np.testing.assert_allclose(np.array(same).ravel(), mixed.torque(told, seen), rtol=1e-14)


def test_gains_are_read_and_changed_by_joint_and_name() -> None:
    none = {"kp_link": 0.0, "kd_link": 0.0, "k_torque": 0.0}
    for robot in (make(PLANAR), make(PLANAR, {"hip": {"controller": "link_pd"}})):
        old = law_of(robot)
        new = with_gain(old, 1, "kp", 7.0)
        assert gains_of(old, 1) == {"kp": 1500.0, "kd": 15.0, "limit": 60.0, **none}
        assert gains_of(new, 1)["kp"] == 7.0 and gains_of(new, 0) == gains_of(old, 0)
        with pytest.raises(UnknownNameError, match="k_torque, kd, kd_link, kp, kp_link, limit"):
            with_gain(old, 1, "ki", 1.0)
        for name, value in (("kp", math.nan), ("limit", 0.0), ("kd", math.inf)):
            with pytest.raises(RobotError, match=f"gain {name}"):
                with_gain(old, 1, name, value)


def test_a_motor_pd_that_gets_another_gain_becomes_a_full_state_law() -> None:
    told, seen = ({k: np.full(2, v) for k, v in table.items()} for table in (TOLD, SEEN))
    plain = law_of(make(PLANAR))
    same = with_gain(plain, 0, "kp_link", 0.0)
    assert isinstance(same, FullState)
    np.testing.assert_array_equal(same.torque(told, seen), plain.torque(told, seen))  # to the last bit
    other = with_gain(plain, 0, "kp_link", 2.0)
    np.testing.assert_allclose(
        other.demand(told, seen) - plain.demand(told, seen), [2.0 * 0.4, 0.0], atol=1e-9
    )


# ------------------------------------------------------------------ in the loop
def settled(controller: dict[str, Any], effects: list[Any] | None = None, seconds: float = 6.0) -> np.ndarray:
    """q, theta, dq of the pendulum after it was sent to 0.5 rad."""
    robot = make(PENDULUM, {"joint": {"controller": controller}})
    model = FlexibleJointModel(robot, effects or [])
    told = tomei(model, np.full((round(seconds * 1000), 1), 0.5))
    tape = closed_loop(model, at_rest(model, np.zeros(1)), law_of(robot), told, RunOptions(rate=1000.0))
    return np.array([tape.q[-1, 0], tape.theta[-1, 0], tape.v[-1, 0]])


LOAD = 2.4 * 9.81 * 0.26 * math.sin(0.5)  # N m at 0.5 rad


@pytest.mark.parametrize(
    "controller",
    [
        {"name": "motor_pd", "kp": 300.0, "kd": 10.0},
        {"name": "link_pd", "kp": 60.0, "kd": 2.0},
        {"name": "full_state", "kp": 300.0, "kd": 5.0, "kp_link": 50.0, "kd_link": 3.0, "k_torque": 0.5},
        {"name": "torque_loop", "kp": 60.0, "kd": 4.0, "k_torque": 1.0, "kd_spring": 2.0},
    ],
    ids=lambda c: c["name"],
)
def test_with_gravity_compensation_every_position_law_gets_there(controller: dict[str, Any]) -> None:
    q, theta, dq = settled(controller)
    # what is left of the decay after 6 s
    assert (q, theta, dq) == pytest.approx((0.5, 0.5 + LOAD / 340, 0.0), abs=2e-5)


def test_an_unknown_load_deflects_a_joint_as_its_stiffness_says() -> None:
    # a weaker gravity than the law thinks, as a constant pull at the link: a cable with its rest far away
    pull, cable = 3.0, effect("cable_spring", "joint", stiffness=0.03, rest=100.0)
    robot = make(PENDULUM, {"joint": {"controller": {"name": "torque_loop", "kp": 60.0, "kd": 4.0}}})
    model = FlexibleJointModel(robot, [cable])
    told = tomei(FlexibleJointModel(robot, []), np.full((6000, 1), 0.5))
    tape = closed_loop(model, at_rest(model, np.zeros(1)), law_of(robot), told, RunOptions(rate=1000.0))
    error = tape.q[-1, 0] - 0.5
    # the link sees the impedance kp alone, whatever the spring; gravity's change over the error beside it
    stiffness = 60.0 + 2.4 * 9.81 * 0.26 * math.cos(0.5)
    assert error == pytest.approx(pull / stiffness, rel=0.02)


def test_a_wheel_turns_at_its_commanded_speed() -> None:
    drive = {"damping": 5.0, "controller": {"name": "velocity", "kd": 50.0}}
    robot = make(PENDULUM, {"joint": drive}, gravity=[0, 0, 0])
    model = FlexibleJointModel(robot, [])
    told = {name: np.zeros((2000, 1)) for name in REFERENCES}
    told["dtheta_ref"][:] = 2.0
    tape = closed_loop(model, model.rest(), law_of(robot), told, RunOptions(rate=1000.0))
    assert tape.v[-1, 0] == pytest.approx(2.0 * 50 / (50 + 4.0), rel=1e-6)  # against the motor's damping


def test_a_law_reads_the_torque_sensor_with_its_effects_and_delays() -> None:
    effects = [
        effect("torque_sensor_offset", "joint", offset=0.7),
        effect("sensor_delay", "joint", delay=2.5e-3, channel="tau_t"),
    ]
    robot = make(PENDULUM)
    model = FlexibleJointModel(robot, effects)
    only = FullState(*(np.array([x]) for x in (0.0, 0.0, 0.0, 0.0, 1.0, math.inf)))
    told = {name: np.full((300, 1), 2.0 if name == "tau_ff" else 0.0) for name in REFERENCES}
    tape = closed_loop(model, model.rest(), only, told, RunOptions(rate=1000.0))
    spring = true_signals(model, tape)["tau_t", "joint"]
    for row in tape.first + np.array([100, 250]):
        seen = 0.5 * (spring[row - 2] + spring[row - 3]) + 0.7
        assert tape.tau_m[row, 0] == pytest.approx(2.0 + (2.0 - seen), abs=1e-12)


# ------------------------------------------------------------------ ticks
@pytest.mark.parametrize(
    ("physics", "control"), [(1000, 1000), (2000, 1000), (1000, 300), (1000, 333.25), (500, 1000)]
)
def test_ticks_are_counted_and_not_measured(physics: float, control: float) -> None:
    ticks = Ticks(physics, control)
    steps = np.arange(40 * round(physics))  # forty seconds: a remainder of floats would have slipped
    acts = np.array([ticks.acts(int(k)) for k in steps])
    first = [0, *np.flatnonzero(np.diff(np.array([ticks.last(int(k)) for k in steps]))) + 1]
    assert np.flatnonzero(acts).tolist() == first
    assert np.sum(acts) == min(round(40 * control), len(steps))
    late = np.array(first) / physics - np.array([ticks.last(int(k)) for k in first]) / control
    assert np.all((late > -1e-9) & (late < 1 / physics))
    assert ticks.steps(round(4 * control)) == 4 * physics


def test_a_controller_runs_at_a_rate_that_does_not_divide_the_physics() -> None:
    robot = make(PENDULUM, rates={"physics": 1000, "control": 300})
    model = FlexibleJointModel(robot, [])
    told = {name: np.zeros((300, 1)) for name in REFERENCES}
    told["tau_ff"][:, 0] = np.arange(300)
    free = MotorPD(*(np.array([x]) for x in (0.0, 0.0, math.inf)))
    tape = closed_loop(model, model.rest(), free, told, RunOptions(rate=1000.0))
    assert len(tape.time) == 1001
    tick = np.floor(np.arange(1000) * 0.3 + 1e-9)
    np.testing.assert_array_equal(tape.tau_m[:-1, 0], tick)


def test_references_of_a_wrong_form_are_refused() -> None:
    robot = make(PENDULUM)
    model = FlexibleJointModel(robot, [])
    told = {name: np.zeros((5, 1)) for name in REFERENCES}
    with pytest.raises(SimulationError, match="tau_ff is missing"):
        closed_loop(
            model,
            model.rest(),
            law_of(robot),
            {k: v for k, v in told.items() if k != "tau_ff"},
            RunOptions(rate=1e3),
        )
    with pytest.raises(SimulationError, match=r"expected \(T, 1\)"):
        closed_loop(
            model, model.rest(), law_of(robot), {**told, "q_ref": np.zeros(5)}, RunOptions(rate=1000.0)
        )
    with pytest.raises(SimulationError, match="rates: expected"):
        closed_loop(model, model.rest(), law_of(robot), told, RunOptions(rate=-5.0))


# ------------------------------------------------------------------ references
def test_a_profile_is_read_from_the_left_of_its_jumps() -> None:
    step = Profile(((0.0, constant(0.3)), (1.0, lambda t: t - 1.0), (2.0, constant(-1.0))))
    assert step.breaks == (1.0, 2.0)
    times = np.array([0.0, 0.5, 1.0, 1.0 + 1e-6, 1.5, 2.0, 2.001])
    np.testing.assert_allclose(step(times), [0.3, 0.3, 0.3, 1e-6, 0.5, 1.0, -1.0], atol=1e-12)
    ticks = np.arange(3000) / 1000
    assert np.flatnonzero(step(ticks) == -1.0)[0] == 2001
    with pytest.raises(SimulationError, match="one after the other"):
        Profile(((1.0, constant(0.0)), (1.0, constant(1.0))))


def test_what_eq_4_is_told_is_the_static_law() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    told = tomei(model, np.array([[0.5], [-0.2]]))
    gravity = 2.4 * 9.81 * 0.26 * np.sin([[0.5], [-0.2]])
    np.testing.assert_allclose(told["tau_ff"], gravity, atol=1e-12)
    np.testing.assert_allclose(told["theta_ref"] - told["q_ref"], gravity / 340, atol=1e-14)


def test_link_pd_stays_a_pd_of_the_link() -> None:
    assert LinkPD.reads == ("q", "dq")
    assert replace(law("link_pd"), kp=np.array([1.0])).kp[0] == 1.0
