"""The steppable simulation: the same numbers as a whole run, commands, gains, states, variable springs."""

from __future__ import annotations

import logging
import math
from dataclasses import asdict, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make

from flexjoint.core import ops
from flexjoint.core.errors import (
    ModelError,
    RobotError,
    SimulationError,
    StabilityWarning,
    UnknownNameError,
)
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.springs import VariableSpring
from flexjoint.rigidbody.symbolic import SymbolicBody
from flexjoint.simulation.compiled import engine, shared
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.loop import REFERENCES
from flexjoint.simulation.options import ENGINES, Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs.live import KEPT, JointState, LiveSimulation
from flexjoint.simulation.schemes import DEFAULT, SCHEMES, make_step


def planar(**top: Any) -> FlexibleJointModel:
    return FlexibleJointModel(make(PLANAR, **top), [])


both_engines = pytest.mark.parametrize("kind", ["pin", "compiled"])


# ------------------------------------------------------------------ stepping
@both_engines
def test_steps_give_what_a_whole_run_gives_bit_for_bit(kind: Engine) -> None:
    late = [
        effect("torque_delay", "yaw", delay=3.3e-3),
        effect("sensor_delay", "roll", delay=2e-3, channel="theta"),
        effect("stribeck_friction", "roll"),
    ]
    robot = make(SPATIAL, rates={"physics": 2000, "control": 1000}, sensing_delay=1e-3)
    model = FlexibleJointModel(robot, late)
    seconds = (KEPT + 900) / 2000  # beyond the rows that a live simulation keeps
    sim = LiveSimulation(model, RunOptions(engine=kind))
    told = {name: np.zeros((math.ceil(seconds * 1000), 3)) for name in REFERENCES}
    for name in REFERENCES:  # what it is told at first
        told[name][:] = [getattr(sim.commanded(joint), name) for joint in sim.joints]
    told["theta_ref"][300:, 1] = 0.4
    start = sim.full_state
    sim.step(600)
    sim.command("roll", position=0.4)
    told["q_ref"][300:, 1] = 0.4
    sim.step(7)
    sim.step(round(seconds * 2000) - 607)
    tape = closed_loop(model, start, law_of(robot), told, RunOptions(rate=2000.0, engine=kind))
    assert sim.time == tape.time[-1]
    x = sim.full_state
    for name in ("q", "v", "theta", "dtheta", "z"):
        np.testing.assert_array_equal(getattr(x, name), getattr(tape, name)[-1])


def test_it_stays_where_it_starts() -> None:
    sim = LiveSimulation(planar(initial={"hip": 0.7, "knee": -0.3}))
    before = sim.states()
    sim.run(1.0)
    for joint, start in before.items():
        now, was = asdict(sim.state(joint)), asdict(start)
        assert was.pop("tau_m") == 0.0 and now["tau_m"] == pytest.approx(was["tau_t"], rel=1e-9)
        assert {k: now[k] for k in was} == pytest.approx(was, abs=1e-9)  # rounding of a balance of 10 N m


def test_aim_reaches_the_static_law() -> None:
    sim = LiveSimulation(planar())
    sim.aim({"hip": 0.6, "knee": -0.4})
    sim.run(8.0)
    g = sim.model.body.gravity_torque(np.array([0.6, -0.4]))
    for k, (joint, q, K) in enumerate((("hip", 0.6, 800.0), ("knee", -0.4, 420.0))):
        state = sim.state(joint)
        assert state.q == pytest.approx(q, abs=1e-6)
        assert state.theta == pytest.approx(q + g[k] / K, abs=1e-6)
        assert state.tau_t == pytest.approx(g[k], abs=1e-3)


@both_engines
def test_commands_act_from_the_next_tick_on_and_keep_what_is_not_named(kind: Engine) -> None:
    model = FlexibleJointModel(make(PENDULUM, rates={"physics": 1000, "control": 250}), [])
    sim = LiveSimulation(model, RunOptions(engine=kind))
    sim.step(2)
    held = sim.state("joint").tau_m
    sim.command("joint", torque=5.0, velocity=0.1)
    sim.step(2)
    assert sim.state("joint").tau_m == held  # the tick at step 4 has not come
    sim.step(1)
    assert sim.state("joint").tau_m != held
    sim.command("joint", velocity=0.2)
    told = sim.commanded("joint")
    assert (told.tau_ff, told.dtheta_ref, told.q_ref) == (5.0, 0.2, 0.0)


@both_engines
def test_gains_are_read_and_set_while_it_runs(kind: Engine) -> None:
    sim = LiveSimulation(planar(), RunOptions(engine=kind))
    none = {"kp_link": 0.0, "kd_link": 0.0, "k_torque": 0.0}
    assert sim.gains("hip") == {"kp": 2600.0, "kd": 30.0, "limit": 110.0, **none}
    sim.run(0.1)
    sim.set_gain("hip", "limit", 1.5)
    sim.command("hip", position=1.0)
    sim.step()
    assert sim.state("hip").tau_m == 1.5
    assert sim.gains("knee")["limit"] == 60.0
    sim.set_gain("knee", "kd_link", 1.0)
    sim.run(0.01)
    assert sim.gains("knee")["kd_link"] == 1.0
    with pytest.raises(UnknownNameError, match="k_torque, kd, kd_link, kp, kp_link, limit"):
        sim.set_gain("hip", "ki", 1.0)
    with pytest.raises(RobotError, match="gain limit"):
        sim.set_gain("hip", "limit", -1.0)


def test_what_cannot_be_commanded_is_refused() -> None:
    sim = LiveSimulation(FlexibleJointModel(make(PLANAR, {"knee": {"stiffness": math.inf}}), []))
    with pytest.raises(UnknownNameError, match="hip, knee"):
        sim.command("elbow", position=1.0)
    with pytest.raises(UnknownNameError, match="hip, knee"):
        sim.state("elbow")
    with pytest.raises(UnknownNameError, match="hip, knee"):
        sim.aim({"elbow": 1.0})
    for given in ({"position": math.nan}, {"stiffness": 0.0}, {"damping": -1.0}):
        with pytest.raises(SimulationError, match="command of joint hip"):
            sim.command("hip", **given)
    with pytest.raises(SimulationError, match="knee is rigid"):
        sim.command("knee", stiffness=100.0)
    with pytest.raises(SimulationError, match="run: expected"):
        sim.run(-1.0)
    with pytest.raises(ModelError, match="joint knee is rigid"):
        FlexibleJointModel(sim.model.robot, [], springs={"knee": VariableSpring(lambda t: 5.0)})
    with pytest.raises(UnknownNameError, match="hip, knee"):
        FlexibleJointModel(sim.model.robot, [], springs={"elbow": VariableSpring(lambda t: 5.0)})


@both_engines
def test_it_warns_and_never_returns_what_is_not_finite(kind: Engine) -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": {"stiffness": 8e5}}), [])
    with pytest.warns(StabilityWarning, match="joint knee"):
        sim = LiveSimulation(model, RunOptions(scheme="kamedula2016", engine=kind))
    sim.command("knee", position=0.5)
    with pytest.raises(SimulationError, match="left the finite numbers"):
        sim.run(20.0)


@both_engines
def test_a_commanded_stiffness_that_a_scheme_cannot_hold_warns(kind: Engine) -> None:
    sim = LiveSimulation(planar(), RunOptions(scheme="kamedula2016", engine=kind))
    sim.run(0.01)
    sim.command("knee", stiffness=8e5)
    with pytest.warns(StabilityWarning, match="spring of joint knee"):
        sim.step()


def told_much(sim: LiveSimulation) -> list[dict[str, JointState]]:
    """States of a simulation that is told of everything, between ticks too."""
    seen = []
    for steps in (3, 50, 1, 120, 6, 220):
        sim.step(steps)
        seen.append(sim.states())
        match len(seen):
            case 1:
                sim.aim({"yaw": 0.4, "pitch": -0.3})
            case 2:
                sim.set_gain("roll", "k_torque", 0.4)  # another kind of law: it reads tau_t, late
                sim.set_gain("yaw", "kp", 900.0)
            case 3:
                sim.command("roll", stiffness=300.0, velocity=0.1)
            case 4:
                sim.command("roll", stiffness=700.0, damping=2.0)
                sim.command("pitch", stiffness=400.0, torque=0.7)
            case 5:
                sim.set_gain("pitch", "limit", 4.0)
    return seen


LATE = [
    effect("torque_delay", "yaw", delay=3.3e-3),
    effect("spring_stiffness", "roll", scale=0.3),  # a commanded stiffness stands for itself
    replace(effect("payload", "pitch", mass=0.4), since=0.03),
    effect("stribeck_friction", "roll"),
]


@pytest.mark.parametrize("scheme", [DEFAULT, "implicit_midpoint", "reference"])
def test_engines_agree_on_all_that_a_simulation_is_told(scheme: str) -> None:
    robot = make(SPATIAL, rates={"physics": 1000, "control": 300}, sensing_delay=2.4e-3)
    runs = []
    for kind in ENGINES[1:]:
        sim = LiveSimulation(
            FlexibleJointModel(robot, LATE), RunOptions(scheme=scheme, width=0.05, engine=kind)
        )
        runs.append((told_much(sim), sim.time, sim.full_state))
    (one, time, x), (other, other_time, y) = runs
    assert time == pytest.approx(other_time, abs=1e-12)
    for before, after in zip(one, other, strict=True):
        for joint in before:
            # as in test_compiled.py, of 0.4 s; torques are some 10 N m
            assert asdict(after[joint]) == pytest.approx(asdict(before[joint]), abs=1e-8)
    np.testing.assert_allclose(y.q, x.q, rtol=0, atol=1e-9)
    assert np.ptp([seen["roll"].q for seen in one]) > 1e-2


def test_the_engine_is_chosen_and_said_as_for_whole_runs(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(engine, "_said", set())
    with caplog.at_level(logging.INFO, "flexjoint"):
        compiled = LiveSimulation(planar())
        monkeypatch.setattr("flexjoint.simulation.compiled.cache.compilers", lambda: ())
        shared._made.clear()
        plain = LiveSimulation(planar())
    assert [record.message.split(",")[0].split(":")[0] for record in caplog.records] == [
        "simulating long runs as C",
        "simulating by the pin loop",
    ]
    for sim in (compiled, plain):
        sim.aim({"hip": 0.3})
        sim.run(0.2)
    assert compiled.state("hip").q == pytest.approx(plain.state("hip").q, abs=1e-9)
    with pytest.raises(UnknownNameError, match="auto, compiled, pin"):
        LiveSimulation(planar(), RunOptions(engine="c++"))  # type: ignore[arg-type]


def test_a_floating_base_and_a_free_joint_run_live() -> None:
    sim = LiveSimulation(FlexibleJointModel(make(SPATIAL, {"pitch": None}, base="floating"), []))
    sim.run(0.2)
    drop = sim.full_state.q[2]
    assert drop == pytest.approx(-0.5 * 9.81 * 0.2**2, rel=2e-3)  # the arms move it a little


# ------------------------------------------------------------------ variable springs
STIFF, SOFT = 420.0, 150.0


def swinging_stiffness(t: float) -> float:
    return STIFF - SOFT * np.sin(12.0 * t)


def variable(**changes: Any) -> FlexibleJointModel:
    spring = VariableSpring(swinging_stiffness, lambda t: 1.0 + 0.5 * np.cos(9.0 * t))
    robot = make(PLANAR, changes.get("changes"), gravity=changes.get("gravity", [0, 0, -9.81]))
    return FlexibleJointModel(robot, [], springs={"knee": changes.get("spring", spring)})


def start(model: FlexibleJointModel) -> State:
    x = model.rest()
    x.v[:] = 1.0, -2.0
    x.theta[:] = 0.05, -0.1
    return x


@pytest.mark.parametrize(("scheme", "order"), [(DEFAULT, 2), ("implicit_midpoint", 2), ("rk4", 4)])
def test_orders_hold_while_the_stiffness_changes(scheme: str, order: int) -> None:
    model = variable()

    def final(name: str, h: float) -> np.ndarray:
        x, step = start(model), make_step(model, h, name)
        for _ in range(round(0.3 / h)):
            x = step(x, np.array([6.0, -3.0]))
        return model.pack(x)

    exact = final("reference", 0.02)
    coarse, fine = (
        np.max(np.abs(final(scheme, h) - exact)) for h in ((2e-3, 1e-3), (1e-3, 5e-4))[order == 2]
    )
    assert abs(np.log2(coarse / fine) - order) < 0.1 * order


def test_the_energy_balance_counts_the_work_of_changing_the_spring() -> None:
    """d(E)/dt = tau dtheta - D_m dtheta^2 - D dphi^2 + K' phi^2 / 2."""
    model = variable(gravity=[0, 0, 0])
    rate, torque = 8000.0, np.array([6.0, -3.0])
    tape = rollout(model, start(model), np.tile(torque, (8000, 1)), RunOptions(rate=rate))
    t, phi, dphi = tape.time, tape.theta - tape.q, tape.dtheta - tape.v
    K = np.stack([np.full_like(t, 800.0), swinging_stiffness(t)], axis=1)
    D = np.stack([np.full_like(t, 1.6), 1.0 + 0.5 * np.cos(9.0 * t)], axis=1)
    B, D_m = np.array([0.24, 0.13]), np.array([12.0, 8.0])

    def stored(k: int) -> float:
        kinetic = tape.v[k] @ model.body.mass_matrix(tape.q[k]) @ tape.v[k] + B @ tape.dtheta[k] ** 2
        return 0.5 * float(kinetic + K[k] @ phi[k] ** 2)

    by_spring = 0.5 * (-SOFT * 12.0 * np.cos(12.0 * t)) * phi[:, 1] ** 2
    power = tape.dtheta @ torque - tape.dtheta**2 @ D_m - np.sum(D * dphi**2, axis=1)
    change = stored(-1) - stored(0)
    assert abs(np.trapezoid(by_spring, t)) > 0.05  # J: it matters
    # order h^2 of the scheme and of the trapezoids at 8 kHz
    assert change == pytest.approx(np.trapezoid(power + by_spring, t), abs=2e-4)


def test_a_jump_of_stiffness_moves_no_torque_but_that_of_the_spring() -> None:
    sim = LiveSimulation(FlexibleJointModel(make(PENDULUM, initial={"joint": 0.5}), []))
    sim.run(0.5)
    before = sim.state("joint")
    phi = before.theta - before.q
    sim.command("joint", stiffness=680.0)
    sim.step()
    after = sim.state("joint")
    # twice the stiffness on a deflection that has hardly changed in a step: its torque, and so its energy,
    # has doubled; the work is the command's
    assert after.theta - after.q == pytest.approx(phi, rel=0.02)
    assert after.tau_t - 0.9 * (after.dtheta - after.dq) == pytest.approx(
        680 * (after.theta - after.q), rel=1e-9
    )
    sim.aim({"joint": 0.5})
    sim.run(6.0)
    rest = sim.state("joint")
    assert rest.q == pytest.approx(0.5, abs=1e-5)
    assert rest.theta - rest.q == pytest.approx(phi / 2, rel=1e-3)  # half the deflection carries the load


@pytest.mark.usefixtures("one_pass")
def test_a_commanded_stiffness_of_an_expression_steps_as_numbers_do() -> None:
    springs = {"knee": VariableSpring(lambda t: STIFF - SOFT * ops.sin(12.0 * t))}
    numeric = FlexibleJointModel(make(PLANAR), [], springs=springs)
    symbolic = FlexibleJointModel(make(PLANAR), [], SymbolicBody, springs=springs)
    x, t = ca.SX.sym("x", numeric.nx), ca.SX.sym("t")
    torque = np.array([6.0, -3.0])
    for scheme in (DEFAULT, "rk4"):
        after = make_step(symbolic, 1e-3, scheme)(symbolic.unpack(x, t), ca.SX(torque))
        got = ca.Function("step", [x, t], [symbolic.pack(after)])(numeric.pack(start(numeric)), 0.2)
        begin = numeric.unpack(numeric.pack(start(numeric)), 0.2)
        expected = numeric.pack(make_step(numeric, 1e-3, scheme)(begin, torque))
        np.testing.assert_allclose(np.array(got).ravel(), expected, rtol=1e-12, atol=1e-12)


def test_a_constant_command_is_the_plain_spring() -> None:
    plain = FlexibleJointModel(make(PLANAR), [])
    same = variable(spring=VariableSpring(lambda t: 420.0))
    for scheme in set(SCHEMES) - {"reference"}:
        a, b = (
            rollout(m, start(m), np.tile([6.0, -3.0], (200, 1)), RunOptions(rate=1000.0, scheme=scheme))
            for m in (plain, same)
        )
        np.testing.assert_allclose(a.q, b.q, atol=1e-12, err_msg=scheme)  # rounding


def test_the_default_scheme_holds_any_commanded_stiffness() -> None:
    model = variable(spring=VariableSpring(lambda t: 10.0 ** (2.0 + 5.0 * min(t, 1.0)), lambda t: 0.5))
    tape = rollout(model, model.rest(), np.tile([6.0, -3.0], (1500, 1)), RunOptions(rate=1000.0))
    assert np.max(np.abs(tape.v)) < 20.0  # torques of 6 N m: an arm of this size stays far below
    phi = tape.theta - tape.q
    assert np.max(np.abs(phi[1000:, 1])) < 1e-4
