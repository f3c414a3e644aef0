"""The compiled clockwork against the pin loop: the same lines, so they agree to rounding."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.loops import FRICTIONS, GAINS, agree, loops_agree, moving, references
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, one_of_each, waves
from support.robots.example_robots import centauro, ur5

from flexjoint.core import ops
from flexjoint.core.errors import SimulationError, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.springs import VariableSpring
from flexjoint.robot.robot import load, shipped_robots
from flexjoint.simulation.compiled import (
    CompiledModel,
    CompilerError,
    compiled_for,
    compiler,
    engine,
    program,
    shared,
)
from flexjoint.simulation.controllers import LAWS, MotorPD, gain_names, law_of
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.schemes import DEFAULT
from flexjoint.simulation.trajectory import Past

pytestmark = pytest.mark.usefixtures("own_cache")


# ------------------------------------------------------------------ agreement
ALONE = [
    e for e in one_of_each("joint") if not e.effect.reaches_before
]  # the others: test_coupled_schemes.py


@pytest.mark.parametrize("planned", ALONE, ids=lambda planned: planned.effect.name)
def test_every_effect_agrees_over_a_second(planned: Planned) -> None:
    loops_agree(make(PENDULUM), [planned])


@pytest.mark.parametrize("name", [*shipped_robots(), "ur5", "centauro"])
def test_every_robot_agrees_over_a_second(name: str) -> None:
    robot = {"ur5": ur5, "centauro": centauro}[name]() if name in ("ur5", "centauro") else load(name)
    loops_agree(robot, None, physics_rate(robot))


@pytest.mark.parametrize("name", LAWS)
def test_every_law_agrees(name: str) -> None:
    """Beside a motor PD on the other joint, with readings of tau_t that come late, through a gap."""
    own = {gain: value for gain, value in GAINS.items() if gain in gain_names(LAWS[name])}
    robot = make(PLANAR, {"knee": {"controller": {"name": name, **own}}}, sensing_delay=0.0023)
    loops_agree(robot, [effect("backlash", "knee", gap=0.01)])


@pytest.mark.parametrize(("physics", "control"), [(1000.0, 300.0), (500.0, 1200.0)])
def test_any_two_rates_agree(physics: float, control: float) -> None:
    loops_agree(make(PLANAR, rates={"physics": physics, "control": control}), [], physics)


def test_variable_springs_agree() -> None:
    def stiffness(t: Any) -> Any:
        return 400.0 + 200.0 * ops.sin(7.0 * t)

    springs = {"knee": VariableSpring(stiffness)}
    model = FlexibleJointModel(make(PLANAR, {"hip": {"controller": "full_state"}}), springs=springs)
    law, table = law_of(model.robot), references(model.robot)
    pin_loop, compiled = (
        closed_loop(model, moving(model), law, table, RunOptions(rate=1000.0, engine=kind))
        for kind in ("pin", "compiled")
    )
    agree(pin_loop, compiled)


def test_onsets_delays_and_several_steps_per_tick_agree() -> None:
    late = [
        replace(effect("spring_hysteresis", "roll"), since=0.2),
        replace(effect("motor_coulomb_friction", "roll", level=2.0), since=0.3),
        replace(effect("sensor_delay", "yaw", delay=0.0033), since=0.4),
        replace(effect("torque_delay", "pitch", delay=0.0043), since=0.5),
        effect("payload", "yaw", since=0.25, switches=(0.45, 0.55), mass=1.0, position=(0.1, 0.0, 0.0)),
    ]
    rates = {"physics": 2000, "control": 500}
    loops_agree(make(SPATIAL, sensing_delay=0.0021, rates=rates), late, 2000.0)


def test_given_torques_and_what_went_before_agree() -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("torque_delay", "hip", delay=0.0125)])
    torque = waves(2, 1030, 1000.0, 20.0)
    whole = rollout(model, moving(model), torque, RunOptions(rate=1000.0, engine="pin"))
    rows = slice(whole.first, whole.first + 30)
    past = Past(whole.tau_m[rows], *(getattr(whole, name)[rows] for name in ("q", "v", "theta", "dtheta")))
    start = whole.state(rows.stop)
    pin_loop, compiled = (
        rollout(model, start, torque[30:], RunOptions(rate=1000.0, engine=kind), past=past)
        for kind in ("pin", "compiled")
    )
    agree(pin_loop, compiled)
    np.testing.assert_array_equal(compiled.q[:31], whole.q[rows.start : rows.stop + 1])


# ------------------------------------------------------------------ numbers are inputs
def test_a_run_repeats_bit_by_bit_and_other_numbers_need_no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    item = effect("payload", "knee", mass=0.3)
    model = FlexibleJointModel(make(PLANAR), [item])
    law, table = law_of(model.robot), references(model.robot)
    first, again = (
        closed_loop(model, moving(model), law, table, RunOptions(rate=1000.0, engine="compiled"))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.q, again.q)

    def refuse(*_: object) -> None:
        raise CompilerError("a compiler ran")

    monkeypatch.setattr(compiler.Compiler, "compile", refuse)
    shared._made.clear()
    joints = tuple(replace(j, drive=j.drive.scaled(K=0.8, B=1.3), kp=500.0) for j in model.robot.joints)
    robot = replace(model.robot, joints=joints)
    other = FlexibleJointModel(robot, [effect("payload", "knee", mass=1.5, position=(0.1, 0, 0.05))])
    pin_loop, compiled = (
        closed_loop(other, moving(other), law_of(robot), table, RunOptions(rate=1000.0, engine=kind))
        for kind in ("pin", "compiled")
    )
    agree(pin_loop, compiled)
    assert np.max(np.abs(pin_loop.q - first.q)) > 1e-3
    with pytest.raises(CompilerError, match="a compiler ran"):
        CompiledModel(other, RunOptions(rate=500.0))


@pytest.mark.parametrize("scheme", ["rk4", DEFAULT])
def test_a_tree_of_bodies_that_is_called_gives_the_same_motion(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Large trees are one C function, called as often as the scheme wants."""
    effects = [*FRICTIONS, effect("payload", "pitch"), effect("base_tilt", roll=0.1)]
    model, torque = FlexibleJointModel(make(SPATIAL), effects), waves(3, 300, 1000.0, 12.0)
    runs, programs = [], []
    for large in (program.LARGE, 0):
        monkeypatch.setattr(program, "LARGE", large)
        compiled = CompiledModel(model, RunOptions(rate=1000.0, scheme=scheme, width=0.05))
        runs.append(compiled.run(engine.job_of(compiled, model, moving(model), None, torque)).states)
        programs.append(compiled.program.source)
    # products may be grouped otherwise: the last digit, times accelerations of some 100 rad/s^2
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-11)
    assert len(programs[1]) < len(programs[0])


def test_models_of_one_structure_share_a_program() -> None:
    robot = make(PENDULUM)
    one, other = (
        compiled_for(
            FlexibleJointModel(robot, [effect("backlash", "joint", gap=gap)]), RunOptions(rate=1000.0)
        )
        for gap in (0.01, 0.02)
    )
    assert one is other
    assert one is not compiled_for(FlexibleJointModel(robot, []), RunOptions(rate=1000.0))
    assert one.parameters[0] == "backlash.joint.gap" and "drive.joint.stiffness" in one.parameters


def test_a_run_that_diverges_says_where() -> None:
    robot = make(PENDULUM, {"joint": {"kp": 1e7, "kd": 0.0, "torque_limit": math.inf}})
    model = FlexibleJointModel(robot, [])
    for kind in ("pin", "compiled"):
        with pytest.raises(SimulationError, match=r"left the finite numbers at joint joint, t = "):
            closed_loop(
                model,
                model.rest(),
                law_of(robot),
                references(robot, 60.0),
                RunOptions(rate=1000.0, engine=kind),
            )


# ------------------------------------------------------------------ compilers and the choice
def test_both_compilers_agree() -> None:
    """Only +, -, *, / and the C library's functions, without contraction: little is left to the compiler, as
    whether sine and cosine come from one call."""
    found = compiler.compilers()
    assert [c.name for c in found][-1] == "ziglang"  # of the test extra
    model = FlexibleJointModel(make(PLANAR), [])
    runs = []
    for one in found:
        compiled = CompiledModel(model, RunOptions(rate=1000.0), compiler=one)
        job = engine.job_of(compiled, model, moving(model), None, waves(2, 400, 1000.0))
        runs.append(compiled.run(job).states)
    for other in runs[1:]:
        np.testing.assert_allclose(other, runs[0], rtol=0, atol=1e-11)  # gcc and ziglang: equal bits


def test_without_a_compiler_the_pin_loop_runs_and_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(engine, "LONG", 50)
    monkeypatch.setattr(engine, "_said", set())
    shared._made.clear()
    model = FlexibleJointModel(make(PENDULUM), [])
    torque = waves(1, 100, 1000.0)
    with caplog.at_level(logging.INFO, "flexjoint"):
        compiled = [rollout(model, moving(model), torque, RunOptions(rate=1000.0)) for _ in range(2)]
        assert [r.message.startswith("simulating long runs as C") for r in caplog.records] == [True]
        monkeypatch.setattr("flexjoint.simulation.compiled.cache.compilers", lambda: ())
        shared._made.clear()
        plain = [rollout(model, moving(model), torque, RunOptions(rate=1000.0)) for _ in range(2)]
    assert [r.levelname for r in caplog.records] == ["INFO", "INFO"]
    assert "pip install 'flexjoint[jit]'" in caplog.records[1].message
    agree(plain[0], compiled[0])
    with pytest.raises(CompilerError, match="no C compiler"):
        rollout(model, moving(model), torque, RunOptions(rate=1000.0, engine="compiled"))
    with pytest.raises(UnknownNameError, match="auto, compiled, pin"):
        rollout(model, moving(model), torque, RunOptions(rate=1000.0, engine="c++"))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Bang(MotorPD):
    """A law for numbers only: its `if` has no answer on expressions."""

    def demand(self, reference: Mapping[str, Any], reading: Mapping[str, Any]) -> Any:
        return self.limit if reading["theta"][0] < 0.3 else -self.limit


@dataclass(frozen=True)
class Rounded(MotorPD):
    """A law for numbers only, whose float() of an expression is NaN without a word."""

    def demand(self, reference: Mapping[str, Any], reading: Mapping[str, Any]) -> Any:
        return self.kp * (0.3 - float(reading["theta"][0]))


@pytest.mark.parametrize("kind", [Bang, Rounded])
def test_what_takes_numbers_only_runs_by_the_pin_loop(
    kind: type[MotorPD], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(engine, "LONG", 50)
    monkeypatch.setattr(engine, "_said", set())
    model = FlexibleJointModel(make(PENDULUM), [])
    law = kind(np.array([9.0]), np.array([0.0]), np.array([5.0]))
    table = references(model.robot, 0.1)
    with caplog.at_level(logging.INFO, "flexjoint"):
        chosen = closed_loop(model, moving(model), law, table, RunOptions(rate=1000.0))
        adaptive = closed_loop(model, moving(model), law, table, RunOptions(rate=1000.0, scheme="reference"))
    assert "numbers only" in caplog.records[0].message
    assert "simulating long runs as C" in caplog.records[1].message  # a law in Python, the rates in C
    plain = closed_loop(model, moving(model), law, table, RunOptions(rate=1000.0, engine="pin"))
    np.testing.assert_array_equal(chosen.q, plain.q)
    np.testing.assert_allclose(adaptive.q, plain.q, atol=1e-3)  # the default's error at 1 ms


def test_a_broken_compiler_is_passed_over(tmp_path: Path) -> None:
    source = tmp_path / "program.c"
    source.write_text("not C", encoding="utf-8")
    with pytest.raises(CompilerError, match="failed with"):
        compiler.compilers()[0].compile(source, tmp_path / "program.so")
    absent = compiler.Compiler("absent", ("no-such-compiler",), "")
    with pytest.raises(CompilerError, match="cannot be run"):
        absent.compile(source, tmp_path / "program.so")
