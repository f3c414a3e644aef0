"""The public set of casadi.Functions of a pin.Model against Pinocchio itself, and their sizes."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from support.pages import DOCS, blocks
from support.robots.body_models import (
    EXACT,
    ROBOTS,
    STATES,
    random_inertia,
    random_placement,
    relative,
    robot,
)

from flexjoint import rigid_body_functions
from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.rigidbody.functions import RigidBodyFunctions
from flexjoint.rigidbody.joints import KINDS
from flexjoint.rigidbody.numeric import inertial_of

MIMICS = ["mimicking", "panda/mimic"]


def state(model: pin.Model, seed: int) -> tuple[np.ndarray, ...]:
    """q, v, a or tau at random; q by a step from neutral, which Pinocchio knows for mimic joints too."""
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
    return q, *rng.normal(size=(2, model.nv))


def expected_of(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, np.ndarray]:
    """What Pinocchio says. It has no forward dynamics with mimic joints: there, its mass matrix is solved."""
    data = model.createData()
    nle = pin.nonLinearEffects(model, data, q, v)
    gravity = pin.computeGeneralizedGravity(model, data, q)
    mass = np.array(pin.crba(model, data, q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    mimics = len(list(model.mimicking_joints)) > 0
    return {
        "rnea": pin.rnea(model, data, q, v, a),
        "crba": mass,
        "aba": np.linalg.solve(mass, a - nle) if mimics else pin.aba(model, data, q, v, a),
        "gravity": gravity,
        "nle": nle,
        "coriolis": nle - gravity,
        "center_of_mass": pin.centerOfMass(model, data, q),
        **({} if mimics else {"coriolis_matrix": pin.computeCoriolisMatrix(model, data, q, v)}),
        **({} if mimics else {"regressor": pin.computeJointTorqueRegressor(model, data, q, v, a)}),
    }


def got_from(functions: RigidBodyFunctions, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, ca.DM]:
    return {
        "rnea": functions.rnea(q, v, a),
        "crba": functions.crba(q),
        "aba": functions.aba(q, v, a),
        "gravity": functions.gravity(q),
        "nle": functions.nle(q, v),
        "coriolis": functions.coriolis(q, v),
        "coriolis_matrix": functions.coriolis_matrix(q, v),
        "regressor": functions.regressor(q, v, a),
        "center_of_mass": functions.center_of_mass(q),
    }


@pytest.mark.parametrize("name", [*ROBOTS, *MIMICS])
def test_every_function_is_pinocchios(name: str) -> None:
    model = robot(name)
    functions = rigid_body_functions(model)
    frames = [model.frames[k].name for k in (1, model.nframes // 2, model.nframes - 1)]
    for seed in range(STATES):
        q, v, a = state(model, seed)
        expected, got = expected_of(model, q, v, a), got_from(functions, q, v, a)
        for entry, value in expected.items():
            # solving a mass matrix multiplies round-off by its condition, below 1e3 for these models
            bound = 1e3 * EXACT if entry == "aba" and name in MIMICS else EXACT
            assert relative(got[entry], value) < bound, (entry, seed)
        assert relative(functions.integrate(q, v), pin.integrate(model, q, v)) < EXACT
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        for frame in frames:
            index = model.getFrameId(frame)
            placement = functions.frame_placement(frame)(q)
            assert relative(placement, data.oMf[index].homogeneous) < EXACT, frame
            jacobian = pin.computeFrameJacobian(model, data, q, index, pin.LOCAL_WORLD_ALIGNED)
            difference = np.array(functions.frame_jacobian(frame)(q)) - jacobian.reshape(6, -1)
            assert np.max(np.abs(difference)) < 10 * EXACT, frame  # absolute: it may be 0


def random_tree(seed: int) -> pin.Model:
    """Nine joints of random types in a random tree, with armature; branch by branch, as Pinocchio wants."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    # Python cannot make an unbounded joint about a given axis; every_joint has one from a URDF
    makers = [getattr(pin, kind) for kind in sorted(KINDS) if kind != "JointModelRevoluteUnboundedUnaligned"]
    model, branch = pin.Model(), [0]
    for _ in range(9):
        maker = makers[rng.integers(len(makers))]
        kind = maker(axis) if "Unaligned" in maker.__name__ else maker()
        place = int(rng.integers(len(branch)))
        index = model.addJoint(branch[place], kind, random_placement(rng), f"joint{model.njoints}")
        model.appendBodyToJoint(index, random_inertia(rng), random_placement(rng))
        branch = [*branch[: place + 1], index]
    model.armature = rng.uniform(0.0, 0.5, model.nv)
    return model


@pytest.mark.parametrize("seed", range(12))
def test_random_trees_are_pinocchios(seed: int) -> None:
    model = random_tree(seed)
    functions = rigid_body_functions(model)
    q, v, a = state(model, seed)
    got = got_from(functions, q, v, a)
    for entry, value in expected_of(model, q, v, a).items():
        assert relative(got[entry], value) < EXACT, entry


@pytest.mark.parametrize("name", ["panda", "talos/floating", "every_joint", *MIMICS])
def test_the_coriolis_matrix_is_the_christoffel_symbols(name: str) -> None:
    """C v is the Coriolis torque and dM/dt - 2 C is skew, the latter along integrate(q, h v)."""
    model = robot(name)
    functions = rigid_body_functions(model)
    q, v, _ = state(model, 5)
    matrix = np.array(functions.coriolis_matrix(q, v))
    assert relative(matrix @ v, np.array(functions.coriolis(q, v)).ravel()) < EXACT
    width = 1e-5
    ahead, back = (np.array(functions.crba(pin.integrate(model, q, h * v))) for h in (width, -width))
    rate = (ahead - back) / (2 * width)
    # central differences: eps / width = 2e-11 of round-off and width^2 of curvature
    assert relative(matrix + matrix.T, rate) < 1e-8


@pytest.mark.parametrize("name", ["panda", "centauro/floating", "mimicking"])
def test_the_regressor_is_the_derivative_by_the_inertial_parameters(name: str) -> None:
    model = robot(name)
    functions = rigid_body_functions(model, free=("inertial",))
    q, v, a = state(model, 8)
    inertial = functions.values["inertial"]
    by_inertial = functions.rnea.jacobian()(q, v, a, inertial, np.zeros(model.nv))[3]
    # CasADi stacks a matrix column by column, the regressor row by row
    order = np.arange(inertial.size).reshape(inertial.shape, order="F").ravel()
    assert relative(np.array(by_inertial)[:, order], np.array(functions.regressor(q, v, a, inertial))) < EXACT


def test_free_inputs_take_other_numbers() -> None:
    model = robot("ur5")
    functions = rigid_body_functions(model, free=("armature", "inertial", "gravity"))
    assert functions.aba.name_in() == ["q", "v", "tau", "inertial", "gravity", "armature"]
    rng = np.random.default_rng(3)
    inertial = functions.values["inertial"] * rng.uniform(0.9, 1.1, (model.njoints - 1, 1))
    gravity, armature = np.array([0.5, -0.2, -9.0]), rng.uniform(0.1, 1.0, model.nv)
    other = model.copy()
    other.armature, other.gravity.linear = armature, gravity
    for k, row in enumerate(inertial):
        other.inertias[k + 1] = pin.Inertia.FromDynamicParameters(row)
    assert np.allclose(inertial_of(other), inertial)
    q, v, a = state(model, 9)
    free = (inertial, gravity, armature)
    expected = expected_of(other, q, v, a)
    assert relative(functions.aba(q, v, a, *free), expected["aba"]) < EXACT
    assert relative(functions.rnea(q, v, a, *free), expected["rnea"]) < EXACT
    assert relative(functions.crba(q, *free), expected["crba"]) < EXACT
    assert relative(functions.gravity(q, *free), expected["gravity"]) < EXACT
    assert functions.integrate.name_in() == ["q", "dv", "inertial", "gravity", "armature"]  # as every other


def test_functions_differentiate() -> None:
    """aba's Jacobians against Pinocchio's analytical ones."""
    model = robot("ur5")
    q, v, tau = state(model, 2)
    blocks = rigid_body_functions(model).aba.jacobian()(q, v, tau, np.zeros(model.nv))
    data = model.createData()
    expected = pin.computeABADerivatives(model, data, q, v, tau)
    for got, value in zip(blocks, expected, strict=True):
        assert relative(got, value) < 1e-10  # a derivative loses two digits more to cancellation


def test_functions_are_built_once() -> None:
    functions = rigid_body_functions(robot("rrbot"))
    assert functions.aba is functions.aba
    assert functions.frame_jacobian("joint2") is functions.frame_jacobian("joint2")


def test_unknown_names_and_joints_are_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"free input 'mass'.*valid: armature, gravity, inertial"):
        rigid_body_functions(robot("rrbot"), free=("mass",))
    with pytest.raises(UnknownNameError, match="frame 'joint3'"):
        rigid_body_functions(robot("rrbot")).frame_placement("joint3")
    model = robot("rrbot").copy()
    model.addJoint(2, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    with pytest.raises(ModelError, match=r"joint 'screw' has type JointModelHX.*JointModelMimic"):
        rigid_body_functions(model)
    with pytest.raises(ModelError, match="joint 'joint2' mimics another with the factor 0"):
        rigid_body_functions(pin.transformJointIntoMimic(robot("rrbot"), 1, 2, 0.0, 0.1))


def test_the_example_of_the_docs_runs() -> None:
    (example,) = blocks(DOCS / "reference" / "symbolic_body.md", "python")
    names: dict[str, Any] = {}
    exec(example, names)
    f, easiest = names["f"], names["easiest"]
    hand = np.array(f.frame_placement("tool0")(easiest))[:3, 3]
    np.testing.assert_allclose(hand, [0.4, 0.2, 0.5], atol=1e-6)  # ipopt's tolerance is 1e-8
    start = np.array([0.0, -1.0, 1.5, 0.0, 0.5, 0.0])
    assert float(ca.norm_2(f.gravity(easiest))) < float(ca.norm_2(f.gravity(start)))


# Instructions without armature: what a call costs. First ours, then those of Pinocchio 4.1's own templates on
# casadi::SX, compiled in C++ (the smaller of its conventions, after elimination of common subexpressions;
# beside coriolis stands its nle).
SIZES = {
    "ur5": {
        "aba": (1146, 1348), "rnea": (517, 623), "nle": (475, 541), "gravity": (65, 159), "crba": (322, 394),
        "coriolis": (462, 541), "coriolis_matrix": (1096, 3184), "regressor": (1792, 1986),
        "center_of_mass": (61, 60),
    },
    "panda": {
        "aba": (2036, 3188), "rnea": (1172, 1600), "nle": (1135, 1534), "gravity": (165, 435),
        "crba": (835, 1639), "coriolis": (1117, 1534), "coriolis_matrix": (2838, 5934),
        "regressor": (3518, 5824), "center_of_mass": (131, 195),
    },
    "talos/floating": {
        "aba": (14862, 19477), "rnea": (7866, 9155), "nle": (7639, 9045), "gravity": (1210, 2307),
        "crba": (9828, 11237), "coriolis": (7614, 9045), "coriolis_matrix": (29165, 48874),
        "regressor": (37579, 55372), "center_of_mass": (780, 815),
    },
    "centauro": {
        "aba": (12197, 15215), "rnea": (6196, 7249), "nle": (5918, 6992), "gravity": (753, 1937),
        "crba": (5520, 6557), "coriolis": (5878, 6992), "coriolis_matrix": (15311, 27702),
        "regressor": (17343, 32561), "center_of_mass": (713, 785),
    },
    "centauro/floating": {
        "aba": (16063, 20819), "rnea": (7841, 9059), "nle": (7545, 8826), "gravity": (1181, 2550),
        "crba": (8250, 9484), "coriolis": (7520, 8826), "coriolis_matrix": (24354, 40479),
        "regressor": (29295, 45509), "center_of_mass": (772, 844),
    },
}  # fmt: skip


@pytest.mark.parametrize("name", SIZES)
def test_functions_are_no_larger_than_pinocchios(name: str) -> None:
    model = robot(name).copy()
    model.armature = np.zeros(model.nv)
    functions = rigid_body_functions(model)
    for entry, (ours, pinocchios) in SIZES[name].items():
        size = getattr(functions, entry).n_instructions()
        assert size <= 1.02 * ours + 2, entry  # for other versions of CasADi; a lost 0 or 1 costs far more
        assert size <= max(pinocchios, 70), entry  # among the smallest, one instruction is no difference
