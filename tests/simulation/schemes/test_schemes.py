"""Every scheme: its order, its warning of a spring on which it is unstable, and the effects it runs with."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make, waves

from flexjoint.core.errors import ModelError, SimulationError, StabilityWarning, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.rigidbody.symbolic import SymbolicBody
from flexjoint.robot.robot import Robot, build
from flexjoint.robot.schema import parse
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.schemes import DEFAULT, SCHEMES, implicit, make_step
from flexjoint.simulation.schemes.modes import linearised
from flexjoint.simulation.schemes.reference import Method, Reference
from flexjoint.simulation.schemes.stability import stability

ORDERS = {name: scheme.order for name, scheme in SCHEMES.items() if scheme.order is not None}
EXPLICIT = [name for name, scheme in SCHEMES.items() if not scheme.any_stiffness]
every_scheme = pytest.mark.parametrize("scheme", SCHEMES)
WIDTH = 0.05  # [rad/s] of smoothed dry friction


def moving(model: FlexibleJointModel) -> State:
    x = model.rest()
    x.v[-model.nf :] = np.linspace(1.0, -2.0, model.nf)
    return x


def ur5() -> Robot:
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    joints = {}
    for k, name in enumerate(names):
        K, B = ((1e4, 2.0), (2e3, 0.3))[k >= 3]
        joints[f"{name}_joint"] = {
            "stiffness": K,
            "damping": 1e-3 * K,
            "motor_inertia": B,
            "motor_damping": 10.0,
        }
    urdf = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    return build(parse({"name": "ur5", "urdf": urdf, "joints": joints}, "ur5"), Path("ur5.yaml"))


def final(
    model: FlexibleJointModel, scheme: str, h: float, seconds: float, base: np.ndarray | None = None
) -> np.ndarray:
    x, step = moving(model), make_step(model, h, scheme)
    if base is not None:
        x.v[:6] = base
    torque = 6.0 * np.cos(np.arange(len(model.joints)))
    for _ in range(round(seconds / h)):
        x = step(x, torque)
    return model.pack(x)


# ------------------------------------------------------------------ order
@pytest.mark.parametrize("scheme", ORDERS)
def test_a_scheme_has_its_order(scheme: str) -> None:
    order = ORDERS[scheme]
    model = FlexibleJointModel(make(PLANAR), [])
    exact = final(model, "reference", 0.02, 0.2)
    steps = {1: (2e-4, 1e-4), 2: (1e-3, 5e-4), 4: (2e-3, 1e-3)}[order]
    coarse, fine = (np.max(np.abs(final(model, scheme, h, 0.2) - exact)) for h in steps)
    assert abs(np.log2(coarse / fine) - order) < 0.15 * order  # the next term of the error at these steps


@pytest.mark.parametrize("scheme", [DEFAULT, "implicit_midpoint", "rk4"])
def test_orders_hold_for_a_floating_base_and_a_rigid_joint(scheme: str) -> None:
    model = FlexibleJointModel(make(SPATIAL, {"roll": {"stiffness": math.inf}}, base="floating"), [])
    spin = np.array([0.3, -0.2, 0.5, 1.0, -2.0, 1.5])  # where a scheme that adds up angles loses its order
    exact = final(model, "reference", 0.02, 0.2, spin)
    steps = (2e-3, 1e-3) if scheme == "rk4" else (1e-3, 5e-4)
    coarse, fine = (np.max(np.abs(final(model, scheme, h, 0.2, spin) - exact)) for h in steps)
    assert abs(np.log2(coarse / fine) - ORDERS[scheme]) < 0.15


def test_order_and_size_of_the_error_on_a_known_arm() -> None:
    """UR5 of example-robot-data on springs of 10 and 2 kN m/rad."""
    model = FlexibleJointModel(ur5(), [])
    exact = final(model, "reference", 0.02, 0.1)
    coarse, fine = (np.max(np.abs(final(model, DEFAULT, h, 0.1) - exact)[: model.nq]) for h in (1e-3, 5e-4))
    assert 1.85 < np.log2(coarse / fine) < 2.15
    assert coarse < 1.2e-4  # rad


def test_the_reference_is_exact_where_the_exact_solution_is_known() -> None:
    # a motor alone (its spring is nearly nothing), and a link without gravity: two damped masses
    drive = {"stiffness": 1e-9, "damping": 0.0}
    model = FlexibleJointModel(make(PENDULUM, {"joint": drive}, gravity=[0, 0, 0]), [])
    x = model.rest()
    x.v[:], x.dtheta[:] = 0.5, 2.0
    end = make_step(model, 0.5, "reference")(x, np.array([3.0]))
    decay = math.exp(-4.0 / 0.12 * 0.5)  # D_m / B
    assert end.dtheta[0] == pytest.approx(0.75 + (2.0 - 0.75) * decay, abs=1e-10)
    assert end.theta[0] == pytest.approx(0.375 + (2.0 - 0.75) * (1 - decay) * 0.12 / 4.0, abs=1e-10)
    assert end.q[0] == pytest.approx(0.25, abs=1e-9)  # the spring's 1e-9 N m/rad


def test_the_reference_turns_to_an_implicit_solver_where_it_is_stiff() -> None:
    model = FlexibleJointModel(
        make(PENDULUM, {"joint": {"stiffness": 1e7, "damping": 2e4}}, gravity=[0, 0, 0]), []
    )
    x = model.rest()
    x.dtheta[:] = 1.0
    end = make_step(model, 0.01, "reference")(x, np.array([2.0]))
    # rigid to 1e-6: one inertia B + J with the motor's damper; momentum of the motor alone at the start
    inertia, damping = 0.12 + 0.05 + 2.4 * 0.26**2, 4.0
    speed = 0.5 + (0.12 / inertia - 0.5) * math.exp(-damping / inertia * 0.01)
    assert end.v[0] == pytest.approx(speed, abs=2e-5)  # the fast mode takes damping/stiffness = 2 ms times..


@pytest.mark.parametrize("method", ["DOP853", "Radau", "LSODA"])
def test_the_solvers_of_the_reference_agree(method: Method) -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    ends = [
        model.pack(Reference(m).step(model, 0.1)(moving(model), np.array([6.0, -3.0])))
        for m in ("DOP853", method)
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-7)  # the looser tolerances of 1e-9, over 0.1 s


# ------------------------------------------------------------------ what a scheme says of itself
@every_scheme
def test_the_step_matrix_is_what_a_step_does(scheme: str) -> None:
    """On a link without gravity, which is linear: its motor, spring and dampers alone."""
    model = FlexibleJointModel(make(PENDULUM, gravity=[0, 0, 0]), [])
    h, still = 1e-3, np.zeros(1)
    columns = []
    for unit in np.eye(4):
        x = model.rest()
        x.q, x.theta, x.v, x.dtheta = (unit[k : k + 1].copy() for k in range(4))
        x.acc, x.ddtheta = model.rates(x, still, None).acc, model.rates(x, still, None).ddtheta
        after = make_step(model, h, scheme)(x, still)
        columns.append(np.concatenate([after.q, after.theta, after.v, after.dtheta]))
    matrix = SCHEMES[scheme].step_matrix(linearised(model, model.rest()), h, model.nv)
    # rounding; of the reference, its tolerance of 1e-11, and Newton's of the implicit midpoint, 1e-12
    np.testing.assert_allclose(np.array(columns).T, matrix, atol=1e-9)


@every_scheme
def test_a_scheme_tells_its_calls_of_the_articulated_body_algorithm(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    counted: list[int] = []
    aba = model.body.aba
    monkeypatch.setattr(model.body, "aba", lambda *arguments: counted.append(1) or aba(*arguments))
    x = moving(model)
    x.acc = model.rates(x, np.ones(2), None).acc  # a start that remembers nothing predicts badly
    counted.clear()
    make_step(model, 1e-4, scheme)(x, np.ones(2))
    told = SCHEMES[scheme].aba_calls
    assert len(counted) == told if told is not None else len(counted) > 4


# ------------------------------------------------------------------ conserved quantities
def test_the_implicit_midpoint_keeps_the_energy_of_a_lossless_robot() -> None:
    lossless = {name: {"damping": 0.0, "motor_damping": 0.0} for name in ("hip", "knee")}
    model = FlexibleJointModel(make(PLANAR, lossless, gravity=[0, 0, 0]), [])

    def energy(x: State) -> float:
        total = 0.5 * x.v @ model.body.mass_matrix(x.q) @ x.v
        for k, flow in enumerate(model.flows):
            total += 0.5 * flow.drive.B * x.dtheta[k] ** 2
            total += 0.5 * flow.drive.K * (x.theta[k] - x.q[k]) ** 2
        return float(total)

    drift = {}
    for scheme in ("implicit_midpoint", "semi_implicit_euler"):
        x, step = moving(model), make_step(model, 2e-3, scheme)
        start = energy(x)
        values = []
        for _ in range(1000):
            x = step(x, np.zeros(2))
            values.append(energy(x) - start)
        drift[scheme] = np.max(np.abs(values)) / start
    # quadratic invariants are kept exactly; M(q) makes this one not quadratic: order h^2 without growth
    assert drift["implicit_midpoint"] < 2e-3 < drift["semi_implicit_euler"]


# ------------------------------------------------------------------ springs that are too stiff
@pytest.mark.parametrize("scheme", EXPLICIT)
def test_a_scheme_that_cannot_hold_a_spring_warns_and_names_the_joint(scheme: str) -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": {"stiffness": 8e5, "damping": 0.5}}), [])
    message = rf"{scheme} is unstable on the spring of joint knee at a physics rate of 500 Hz.*{DEFAULT}"
    with pytest.warns(StabilityWarning, match=message):
        tape = rollout(model, model.rest(), np.zeros((3, 2)), RunOptions(rate=500.0, scheme=scheme))
    assert np.all(np.isfinite(tape.q))  # three steps do not overflow
    stiff = make(PLANAR, {"knee": {"stiffness": 8e5, "damping": 0.5}})
    with (
        pytest.warns(StabilityWarning),
        pytest.raises(SimulationError, match=r"left the finite numbers at joint \w+, t = "),
    ):
        rollout(
            FlexibleJointModel(stiff, []),
            moving(model),
            np.zeros((20000, 2)),
            RunOptions(rate=500.0, scheme=scheme, engine="pin"),
        )


def test_only_known_schemes_are_estimated() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    with pytest.raises(UnknownNameError, match="rk4"):
        stability(model, model.rest(), 1e-3, "rk5")


@every_scheme
def test_a_scheme_that_holds_the_springs_says_nothing(scheme: str) -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tape = rollout(model, model.rest(), np.ones((10, 1)), RunOptions(rate=1000.0, scheme=scheme))
    assert np.all(np.isfinite(tape.q))


@pytest.mark.parametrize("scheme", EXPLICIT)
def test_the_rate_that_a_warning_names_holds(scheme: str) -> None:
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"stiffness": 3e4, "damping": 9.0}}), [])
    found = stability(model, model.rest(), 1.0 / 200.0, scheme)
    assert not found.stable and found.rate is not None and found.joint == "joint"
    # max |lambda| h by hand: two masses on a damped spring, one on the ground by a damper
    B, J = 0.12, 0.05 + 2.4 * 0.26**2
    mode = np.roots([B * J, J * (9.0 + 4.0) + B * 9.0, (B + J) * 3e4 + 9.0 * 4.0, 3e4 * 4.0])
    assert found.lambda_h == pytest.approx(np.max(np.abs(mode)) / 200.0, rel=1e-6)
    x = model.rest()
    x.theta = x.theta + 1e-3
    tape = rollout(model, x, np.zeros((2000, 1)), RunOptions(rate=found.rate, scheme=scheme))
    assert np.max(np.abs(tape.theta - tape.q)[1000:]) < 1.01e-3


# ------------------------------------------------------------------ contract: effects x robots x schemes
def cases() -> Iterator[tuple[str, FlexibleJointModel]]:
    some = {
        "friction": [effect("motor_coulomb_friction", "roll", level=1.0)],
        "link friction": [effect("link_coulomb_friction", n, level=0.3) for n in ("yaw", "roll")],
        "backlash": [effect("backlash", "roll", gap=4e-3)],
        "states": [effect("dahl_friction", "roll"), effect("spring_hysteresis", "pitch")],
        "late": [effect("torque_delay", "yaw", delay=2.5e-3), effect("hardening_spring", "roll")],
    }
    for name, effects in some.items():
        yield name, FlexibleJointModel(make(SPATIAL), effects)
    rigid = make(SPATIAL, {"roll": {"stiffness": math.inf}})
    yield "rigid", FlexibleJointModel(rigid, some["friction"] + some["link friction"])
    yield "floating", FlexibleJointModel(make(SPATIAL, base="floating"), some["states"])
    yield "passive", FlexibleJointModel(make(SPATIAL, {"pitch": None}), some["friction"])


CASES = dict(cases())


@every_scheme
@pytest.mark.parametrize("case", CASES)
def test_every_scheme_runs_with_every_sort_of_effect(case: str, scheme: str) -> None:
    model = CASES[case]
    steps = 150
    torque = waves(len(model.joints), steps, 1000, 6.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # an undamped free base drifts: explicit Euler
        tape = rollout(model, model.rest(), torque, RunOptions(rate=1000.0, scheme=scheme, width=WIDTH))
        fine = rollout(
            model, model.rest(), np.repeat(torque, 8, axis=0), RunOptions(rate=8000.0, width=WIDTH)
        )
    # against the default at an eighth of the step: an Euler scheme's error at 1 ms, and that of friction
    # smoothed over WIDTH, of motions of 0.1 to 1 rad
    assert np.max(np.abs(tape.q[-1] - fine.q[-1])) < 6e-3
    assert np.max(np.abs(tape.theta[-1] - fine.theta[-1])) < 6e-3
    assert np.max(np.abs(fine.theta[-1] - fine.theta[fine.first])) > 1e-2


@pytest.mark.usefixtures("one_pass")
@pytest.mark.parametrize("scheme", [name for name, scheme in SCHEMES.items() if scheme.expressions])
@pytest.mark.parametrize("case", CASES)
def test_expressions_step_as_numbers_do(case: str, scheme: str) -> None:
    numeric = CASES[case]
    symbolic = FlexibleJointModel(numeric.robot, numeric.effects, SymbolicBody)
    x, u = ca.SX.sym("x", numeric.nx), ca.SX.sym("u", len(numeric.joints))
    after = make_step(symbolic, 1e-3, scheme, WIDTH)(symbolic.unpack(x, 0.0), u)
    step = ca.Function("step", [x, u], [symbolic.pack(after), after.tau_rigid])
    start, torque = moving(numeric), 4.0 * np.cos(np.arange(len(numeric.joints)))
    start.theta = start.theta + 0.01
    expected = make_step(numeric, 1e-3, scheme, WIDTH)(start, torque)
    got, tau_rigid = (np.array(out).ravel() for out in step(numeric.pack(start), torque))
    # two orders of the same sums
    np.testing.assert_allclose(got, numeric.pack(expected), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(tau_rigid, expected.tau_rigid, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("scheme", [name for name, scheme in SCHEMES.items() if scheme.sticks])
def test_dry_friction_sticks_in_schemes_that_take_it_as_a_set(scheme: str) -> None:
    for law, rigid in (
        (effect("motor_coulomb_friction", "joint", level=2.0), False),
        (effect("link_coulomb_friction", "joint", level=2.0), False),
        (effect("motor_coulomb_friction", "joint", level=2.0), True),
    ):
        robot = make(PENDULUM, {"joint": {"stiffness": math.inf}} if rigid else None)
        model = FlexibleJointModel(robot, [law])
        x = model.rest(np.array([0.3]))  # gravity pulls with 1.81 N m
        if not rigid and law.effect.name.startswith("motor"):
            x.theta = x.theta + model.body.gravity_torque(x.q) / 340
        tape = rollout(model, x, np.zeros((500, 1)), RunOptions(rate=1000.0, scheme=scheme))
        assert np.ptp(tape.q) < 1e-12 and (rigid or np.ptp(tape.theta) < 1e-12)  # rounding of the balance
        if law.effect.name.startswith("motor"):
            moved = rollout(model, x, np.full((500, 1), -0.3), RunOptions(rate=1000.0, scheme=scheme))
            assert np.ptp(moved.q) > 1e-3


def test_a_rigid_joints_torque_is_alike_in_all_schemes() -> None:
    model = FlexibleJointModel(make(PENDULUM, {"joint": {"stiffness": math.inf}}), [])
    torque = waves(1, 300, 1000)
    runs = {
        name: rollout(model, model.rest(), torque, RunOptions(rate=1000.0, scheme=name)).tau_rigid[200:, 0]
        for name in ORDERS
    }
    for name, tau_t in runs.items():
        # the first-order ones take it at the step's start, the others in its midst: half a step of 6 Hz
        np.testing.assert_allclose(tau_t, runs["implicit_midpoint"], atol=0.05, err_msg=name)


# ------------------------------------------------------------------ implicit midpoint
def test_newton_that_does_not_converge_names_step_and_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    model = FlexibleJointModel(make(PLANAR), [effect("hardening_spring", "knee", cubic=1e5)])
    x = moving(model)
    x.theta[1] += 0.3
    converged = make_step(model, 5e-3, "implicit_midpoint")(x, np.zeros(2))
    assert np.all(np.isfinite(model.pack(converged)))
    monkeypatch.setattr(implicit, "ITERATIONS", 2)
    with pytest.raises(SimulationError, match=r"implicit_midpoint: .* t = 0 s .* worst at joint knee"):
        make_step(model, 5e-3, "implicit_midpoint")(x, np.zeros(2))
    broken = Planned(effect("quadratic_drag", "knee").effect, "knee", {"coefficient": math.nan})
    with pytest.raises(SimulationError, match="did not converge"):
        make_step(FlexibleJointModel(make(PLANAR), [broken]), 1e-3, "implicit_midpoint")(x, np.zeros(2))


def test_newton_converges_on_friction_smoothed_as_sharply_as_wanted() -> None:
    model = FlexibleJointModel(make(PENDULUM), [effect("motor_coulomb_friction", "joint", level=1.0)])
    torque = waves(1, 300, 1000)
    runs = [
        rollout(
            model, model.rest(), torque, RunOptions(rate=1000.0, scheme="implicit_midpoint", width=w)
        ).theta
        for w in (1e-2, 1e-4, 1e-6)
    ]
    sets = rollout(model, model.rest(), torque, RunOptions(rate=1000.0)).theta  # the default: a width of 0
    errors = [np.max(np.abs(run - sets)) for run in runs]
    assert errors[1] < 0.1 * errors[0] and errors[2] < 2e-4  # order 1 where motions begin and end


def test_schemes_that_iterate_refuse_expressions() -> None:
    model = FlexibleJointModel(make(PENDULUM), [], SymbolicBody)
    refusing = [name for name, scheme in SCHEMES.items() if not scheme.expressions]
    assert refusing == ["implicit_midpoint", "reference"]
    for scheme in refusing:
        with pytest.raises(ModelError, match=f"{scheme} .* which expressions cannot"):
            make_step(model, 1e-3, scheme)


def test_the_papers_scheme_differs_only_in_the_motors_position() -> None:
    model = FlexibleJointModel(make(PLANAR), [])
    x, torque = moving(model), np.array([3.0, -2.0])
    old, new = (make_step(model, 1e-3, name)(x, torque) for name in ("kamedula2016", "kamedula2016_new"))
    np.testing.assert_array_equal(old.theta, x.theta + 1e-3 * x.dtheta)
    np.testing.assert_array_equal(new.theta, x.theta + 1e-3 * new.dtheta)
    for name in ("q", "v", "dtheta"):
        np.testing.assert_array_equal(getattr(old, name), getattr(new, name))
    assert isinstance(model.body, PinBody)
