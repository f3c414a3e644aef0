"""Discrete steps of every scheme, further parameters, files for use elsewhere, and use in an optimisation."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from support.robots.arms import PLANAR, SPATIAL, make, waves

from flexjoint.core.errors import ModelError, SimulationError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import renumbered
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.rigidbody.numeric import inertial_of
from flexjoint.robot.robot import load
from flexjoint.simulation.compiled.compiler import compilers
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes import SCHEMES
from flexjoint.simulation.schemes.discrete import DiscreteModel

EFFECTS = [
    effect("motor_coulomb_friction", "hip", level=0.5),
    effect("torque_delay", "knee", delay=3e-3),
]
STEPS = 60


def stepped(discrete: DiscreteModel, x: np.ndarray, torque: np.ndarray, p: np.ndarray) -> np.ndarray:
    step = discrete.step()
    for k, tau in enumerate(torque):
        x = step(x, tau, p, k / discrete.rate).full().ravel()
    return x


@pytest.mark.usefixtures("one_pass")
@pytest.mark.parametrize("scheme", [name for name, scheme in SCHEMES.items() if scheme.expressions])
def test_a_step_of_every_scheme_is_the_numeric_one(scheme: str) -> None:
    robot = make(PLANAR)
    model = FlexibleJointModel(robot, EFFECTS)
    start, torque = model.rest(np.array([0.3, -0.5])), waves(2, STEPS, 100.0, 12.0)
    discrete = DiscreteModel(SymbolicModel(robot, EFFECTS), 1000.0, scheme, 0.05)
    x = stepped(discrete, discrete.start(start, torque[0]), torque, discrete.symbolic.values)
    tape = rollout(model, start, torque, RunOptions(rate=1000.0, scheme=scheme, width=0.05))
    expected = np.concatenate([tape.q[-1], tape.v[-1], tape.theta[-1], tape.dtheta[-1]])
    np.testing.assert_allclose(x[:8], expected, rtol=0, atol=1e-11)  # rounding over 60 steps
    assert len(discrete.state_names) == discrete.size == len(x)


def test_schemes_and_free_parameters_are_checked() -> None:
    robot = make(PLANAR)
    with pytest.raises(UnknownNameError, match="rk4"):
        DiscreteModel(SymbolicModel(robot), 1000.0, "rk5")
    with pytest.raises(ModelError, match="linearly_implicit_midpoint"):
        DiscreteModel(SymbolicModel(robot), 1000.0, "implicit_midpoint")
    with pytest.raises(SimulationError, match="width"):
        DiscreteModel(SymbolicModel(robot, EFFECTS), 1000.0, "rk4")
    with pytest.raises(UnknownNameError, match="drives, inertial"):
        SymbolicModel(robot, free=("masses",))


@pytest.mark.usefixtures("one_pass")
def test_drives_and_inertial_parameters_can_be_free() -> None:
    robot = make(SPATIAL, {"yaw": {"stiffness": float("inf")}})
    effects = [effect("payload", "pitch", mass=0.4)]
    symbolic = SymbolicModel(robot, effects, free=("drives", "inertial"))
    assert (
        "drive.yaw.stiffness" not in symbolic.parameters and "drive.yaw.motor_inertia" in symbolic.parameters
    )
    numbers = dict(zip(symbolic.parameters, symbolic.values, strict=True))
    assert numbers["body.pitch.m"] == inertial_of(robot.model)[2, 0]
    discrete = DiscreteModel(symbolic, 1000.0)
    torque = waves(3, STEPS, 100.0, 12.0)
    changes = {"drive.roll.stiffness": 300.0, "drive.yaw.motor_damping": 2.0, "payload.pitch.mass": 0.9}
    other = FlexibleJointModel(*renumbered(robot, effects, changes))
    x = discrete.start(other.rest(), torque[0])
    x = stepped(discrete, x, torque, symbolic.set_values(changes))
    tape = rollout(other, other.rest(), torque, RunOptions(rate=1000.0))
    np.testing.assert_allclose(x[:3], tape.q[-1], rtol=0, atol=1e-11)  # rounding over 60 steps
    # a point mass of 0.5 kg at the joint's origin, as inertial parameter and as payload
    heavier = symbolic.set_values({"body.pitch.m": numbers["body.pitch.m"] + 0.5})
    payload = symbolic.set_values({"payload.pitch.mass": 0.9})
    one, two = (
        stepped(discrete, discrete.start(other.rest(), torque[0]), torque, p) for p in (heavier, payload)
    )
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)
    assert np.max(np.abs(one[:3] - x[:3])) > 1e-4


# ------------------------------------------------------------------ files
def discrete_model() -> DiscreteModel:
    return DiscreteModel(SymbolicModel(make(PLANAR), EFFECTS, free=("drives",)), 1000.0)


def test_a_saved_model_loads_without_flexjoint(tmp_path: Path) -> None:
    discrete = discrete_model()
    discrete.save(tmp_path / "arm.json")
    script = (
        "import casadi, json, sys\n"
        "table = json.load(open(sys.argv[1]))\n"
        "step = casadi.Function.deserialize(table['step'])\n"
        "measure = casadi.Function.deserialize(table['measure'])\n"
        "p = list(table['p'].values())\n"
        "x = [0.1] * len(table['x'])\n"
        "y = measure(x, [0.5] * len(table['u']), p, 0.2)\n"
        "print(json.dumps([step(x, [0.5] * len(table['u']), p, 0.2).full().ravel().tolist(),"
        " y.full().ravel().tolist(), 'flexjoint' in sys.modules]))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", script, str(tmp_path / "arm.json")],
        capture_output=True,
        text=True,
        check=True,
    )
    x_next, y, imported = json.loads(done.stdout)
    x, u, p = np.full(discrete.size, 0.1), np.full(2, 0.5), discrete.symbolic.values
    np.testing.assert_array_equal(x_next, discrete.step()(x, u, p, 0.2).full().ravel())
    np.testing.assert_array_equal(y, discrete.measure()(x, u, p, 0.2).full().ravel())
    assert not imported
    table = json.loads((tmp_path / "arm.json").read_text())
    assert table["x"][:2] == ["q.hip", "q.knee"] and table["p"]["drive.hip.stiffness"] == 800.0
    assert (table["rate"], table["scheme"], table["u"]) == (1000.0, discrete.scheme, ["hip", "knee"])


def test_the_exported_c_computes_the_step(tmp_path: Path) -> None:
    discrete = discrete_model()
    discrete.export_c(tmp_path / "arm.c")
    text = (tmp_path / "arm.c").read_text()
    assert "p: motor_coulomb_friction.hip.level = 0.5" in text and "x: q.hip, q.knee" in text
    # visibility is hidden by default in the compiled clockwork's flags, so the functions are wrapped
    names = ("flexjoint_step", "flexjoint_measure")
    wrapped = "".join(
        f'__attribute__((visibility("default"))) int call_{n}(const double** a, double** r)'
        f" {{ return {n}(a, r, 0, 0, 0); }}\n"
        for n in names
    )
    (tmp_path / "arm.c").write_text(text + wrapped)
    compilers()[0].compile(tmp_path / "arm.c", tmp_path / "arm.so")
    library = ctypes.CDLL(str(tmp_path / "arm.so"))
    x, u, p, t = np.full(discrete.size, 0.1), np.full(2, 0.5), discrete.symbolic.values, np.array([0.2])
    for name, function in zip(names, (discrete.step(), discrete.measure()), strict=True):
        out = np.empty(function.numel_out(0))
        pointer = ctypes.POINTER(ctypes.c_double)
        arg = (pointer * 4)(*(values.ctypes.data_as(pointer) for values in (x, u, p, t)))
        res = (pointer * 1)(out.ctypes.data_as(pointer))
        assert getattr(library, f"call_{name}")(arg, res) == 0
        # the C library's functions may differ from CasADi's in the last digit
        np.testing.assert_allclose(out, function(x, u, p, 0.2).full().ravel(), rtol=1e-13, atol=1e-13)


# ------------------------------------------------------------------ in a user's optimisation
def test_the_energy_optimal_swing_is_found_and_holds_in_the_simulation() -> None:
    path = Path(__file__).parents[3] / "examples" / "energy_optimal_swing.py"
    spec = importlib.util.spec_from_file_location("energy_optimal_swing", path)
    assert spec is not None and spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    times, states, torque = example.swing()
    assert len(times) == len(torque) == len(states) - 1
    assert np.max(np.abs(torque)) <= example.LIMIT + 1e-6 < 4.4  # less than holds the pendulum horizontal
    assert np.ptp(states[:, 0]) > np.pi + 0.3  # so it swings to the other side first
    robot = load("rrbot_last_joint")
    model = FlexibleJointModel(*renumbered(robot, robot.effects, example.SOFT))
    held = np.repeat(torque, example.HOLD)[:, None]
    tape = rollout(model, model.rest(np.array([np.pi])), held, RunOptions(rate=example.RATE))
    np.testing.assert_allclose(tape.q[:: example.HOLD, 0], states[:, 0], atol=1e-6)  # IPOPT's tolerance 1e-8
    # upright and still, as asked
    assert np.abs(tape.q[-1, 0]) < 1e-6 and np.abs(tape.v[-1, 0]) < 1e-5


def test_a_rigid_joint_keeps_its_kind_when_its_drive_is_free() -> None:
    robot = make(SPATIAL, {"roll": {"stiffness": float("inf")}})
    symbolic = SymbolicModel(robot, [], free=("drives",))
    assert symbolic.model.rigid == (1,) and symbolic.model.nf == 2
    jacobian = ca.jacobian(symbolic.model.joints[0].drive.K, symbolic.p)
    assert jacobian.nnz() == 1
    changed = replace(robot, joints=robot.joints[:1])
    assert SymbolicModel(changed, [], free=("drives",)).parameters[0] == "drive.yaw.stiffness"
