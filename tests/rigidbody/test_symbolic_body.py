"""SymbolicBody against PinBody, and what it refuses."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from support.robots.body_models import EXACT, ROBOTS, STATES, relative, robot, rrbot, state, symbolic

from flexjoint.core.errors import ModelError
from flexjoint.rigidbody.functions import FUNCTIONS, make_function
from flexjoint.rigidbody.joints import KINDS
from flexjoint.rigidbody.numeric import PinBody, inertial_of
from flexjoint.rigidbody.symbolic import SymbolicBody


@pytest.mark.parametrize("name", ROBOTS)
def test_symbolic_dynamics_are_pinocchios(name: str) -> None:
    body, twin = PinBody(robot(name)), symbolic(name)
    methods = ("aba", "rnea", "nle", "gravity_torque", "mass_matrix", "regressor")
    functions = {method: make_function(twin, method) for method in methods}
    for seed in range(STATES):
        q, v, a, armature = state(body, seed)
        tau = 10.0 * a
        cases = {
            "aba": (q, v, tau, armature),
            "rnea": (q, v, a),
            "nle": (q, v),
            "gravity_torque": (q,),
            "mass_matrix": (q,),
            "regressor": (q, v, a),
        }
        for method, arguments in cases.items():
            assert relative(functions[method](*arguments), getattr(body, method)(*arguments)) < EXACT, (
                method,
                seed,
            )


@pytest.mark.parametrize("name", ROBOTS)
def test_symbolic_kinematics_are_pinocchios(name: str) -> None:
    model = robot(name)
    body, twin = PinBody(model), symbolic(name)
    names = [frame.name for frame in model.frames]
    frames = sorted({names[k] for k in (0, 1, len(names) // 2, len(names) - 1)})
    for seed in range(STATES):
        q, dv, *_ = state(body, seed)
        assert relative(make_function(twin, "center_of_mass")(q), body.center_of_mass(q)) < EXACT
        assert relative(make_function(twin, "integrate")(q, dv), body.integrate(q, dv)) < EXACT
        for frame in frames:
            placement = make_function(twin, "frame_placement", frame)(q)
            assert relative(placement, body.frame_placement(q, frame)) < EXACT, frame
            jacobian = np.array(make_function(twin, "frame_jacobian", frame)(q))
            # absolute: the base's frame has a Jacobian of zeros
            assert np.max(np.abs(jacobian - body.frame_jacobian(q, frame))) < 10 * EXACT, frame


def test_the_generated_tree_holds_every_supported_joint() -> None:
    assert {joint.shortname() for joint in list(robot("every_joint").joints)[1:]} == set(KINDS)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.17, 0.18, 1.0])
def test_symbolic_step_is_exact_and_smooth_at_any_size(size: float) -> None:
    """Including none, and either side of the change from series to closed form (0.17 rad, sqrt(0.03))."""
    body, twin = PinBody(robot("every_joint")), symbolic("every_joint")
    q, v, *_ = state(body, 7)
    dv = size * v / np.max(np.abs(v))
    step = make_function(twin, "integrate")
    # Entries of q are of order 1 and the step is added to them: eps, whatever its size
    assert np.max(np.abs(np.array(step(q, dv)).ravel() - body.integrate(q, dv))) < 1e-14
    slope = np.array(step.jacobian()(q, dv, q)[1])
    width = 1e-6
    for k in range(body.nv):
        nudge = width * np.eye(body.nv)[k]
        difference = np.array(step(q, dv + nudge) - step(q, dv - nudge)).ravel() / (2 * width)
        # central differences: eps / width = 2e-10 of round-off and width^2 of curvature
        assert np.max(np.abs(slope[:, k] - difference)) < 2e-9


def test_a_symbolic_step_restores_unit_norms() -> None:
    """One Newton step: an error e of a quaternion's or an angle pair's norm becomes 1.5 e^2."""
    twin = symbolic("every_joint")
    q, dv, *_ = state(PinBody(robot("every_joint")), 7)
    after = np.array(make_function(twin, "integrate")((1 + 1e-6) * q, dv)).ravel()
    sizes = {"JointModelSpherical": 4, "JointModelFreeFlyer": 4, "JointModelPlanar": 2}
    for joint in list(robot("every_joint").joints)[1:]:
        size = 2 if joint.shortname().startswith(("JointModelRUB", "JointModelRevoluteUnb")) else 0
        size = sizes.get(joint.shortname(), size)
        if size:
            end = joint.idx_q + joint.nq
            assert abs(np.linalg.norm(after[end - size : end]) - 1) < 2e-12, joint.shortname()


def test_the_derivatives_of_symbolic_aba_are_pinocchios() -> None:
    body, twin = PinBody(robot("panda")), symbolic("panda")
    q, v, tau, armature = state(body, 3)
    aba = make_function(twin, "aba")
    blocks = aba.jacobian()(q, v, tau, armature, np.zeros(body.nv))
    for got, expected in zip(blocks, body.aba_derivatives(q, v, tau, armature), strict=False):
        assert relative(got, expected) < 1e-10  # a derivative loses two digits more to cancellation


def test_symbolic_parameters_are_inputs() -> None:
    model = robot("every_joint")
    rng = np.random.default_rng(2)
    inertial = inertial_of(model) * rng.uniform(0.9, 1.1, (model.njoints - 1, 10))
    gravity = np.array([1.0, -2.0, -9.0])
    body = PinBody(model, inertial, gravity)
    twin = SymbolicBody(model, ca.SX.sym("inertial", model.njoints - 1, 10), ca.SX.sym("gravity", 3))
    numbers = SymbolicBody(model, inertial, gravity)
    q, v, a, armature = state(body, 4)
    aba = make_function(twin, "aba")
    assert aba.name_in() == ["q", "v", "tau", "armature", "inertial", "gravity"]
    for method, arguments in (("aba", (q, v, a, armature)), ("rnea", (q, v, a)), ("center_of_mass", (q,))):
        expected = getattr(body, method)(*arguments)
        assert relative(make_function(twin, method)(*arguments, inertial, gravity), expected) < EXACT
        assert relative(make_function(numbers, method)(*arguments), expected) < EXACT


def test_symbolic_parameters_that_are_expressions_are_refused_as_inputs() -> None:
    model = robot("rrbot")
    scaled = SymbolicBody(model, ca.SX.sym("scale") * ca.SX(inertial_of(model)))
    scaled.rnea(ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("a", 2))  # the expression itself is fine
    with pytest.raises(ModelError, match="inertial must be plain symbols"):
        make_function(scaled, "rnea")


def test_functions_have_named_inputs_and_outputs() -> None:
    twin = symbolic("rrbot")
    for name, signature in FUNCTIONS.items():
        function = make_function(twin, name, "joint2" if signature.of_frame else None)
        assert function.name() == name
        assert tuple(function.name_in()) == signature.inputs
        assert function.name_out() == [signature.output]


@pytest.mark.parametrize(("name", "limit"), [("centauro", 14_000), ("centauro/floating", 18_500)])
def test_centauro_aba_stays_small(name: str, limit: int) -> None:
    """Instructions are what a compiled step costs. Measured: 13,759 fixed, 18,189 floating; Pinocchio's own
    templates on SX need about 14,000 fixed. The margin is for other versions of CasADi; a 0 or 1 that stops
    folding costs thousands."""
    model = robot(name).copy()
    model.armature = np.zeros(model.nv)
    assert make_function(SymbolicBody(model), "aba").n_instructions() <= limit


@pytest.mark.parametrize(
    "kind",
    [
        pin.JointModelUniversal(np.array([1.0, 0, 0]), np.array([0, 1.0, 0])),
        pin.JointModelSphericalZYX(),
        pin.JointModelHX(0.1),
        pin.JointModelComposite(pin.JointModelRX()),
    ],
    ids=lambda kind: kind.shortname(),
)
def test_an_unsupported_joint_is_named(kind) -> None:
    model = rrbot()
    model.addJoint(2, kind, pin.SE3.Identity(), "odd_one")
    with pytest.raises(ModelError, match=rf"'odd_one' has type {kind.shortname()}"):
        SymbolicBody(model)
    PinBody(model)  # Pinocchio itself knows them


def test_symbolic_parameters_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(ModelError, match=r"\(2, 10\)"):
        SymbolicBody(rrbot(), ca.SX.sym("inertial", 10, 2))
    with pytest.raises(ModelError, match=r"\(3, 1\)"):
        SymbolicBody(rrbot(), gravity=ca.SX.sym("gravity", 6))
    with pytest.raises(ModelError, match="tau: expected a column of 2 entries"):
        symbolic("rrbot").aba(np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(2))
