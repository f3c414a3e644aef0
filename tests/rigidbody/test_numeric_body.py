"""PinBody against closed forms and Pinocchio, and what both bodies refuse."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pinocchio as pin
import pytest
from support.robots.body_models import EXACT, random_inertia, relative, robot, rrbot, state, symbolic

from flexjoint.core.errors import FlexJointError, ModelError, UnknownNameError
from flexjoint.rigidbody.functions import make_function
from flexjoint.rigidbody.numeric import PinBody, inertial_of
from flexjoint.rigidbody.symbolic import SymbolicBody

# ---------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("angle", [-2.0, 0.0, 0.7])
def test_a_pendulum_by_hand(angle: float) -> None:
    """m 2 kg hangs l = 0.5 m below its hinge: (I + m l^2 + k) a = tau - m g l sin q."""
    body, twin = PinBody(robot("one_link")), symbolic("one_link")
    q, v, tau, k = np.array([angle]), np.array([3.0]), np.array([1.5]), np.array([0.3])
    inertia, weight = 0.1 + 2 * 0.5**2, 2 * 9.81 * 0.5 * np.sin(angle)
    assert body.aba(q, v, tau, k)[0] == pytest.approx((1.5 - weight) / (inertia + 0.3), rel=EXACT)
    assert float(make_function(twin, "aba")(q, v, tau, k)) == pytest.approx(
        (1.5 - weight) / (inertia + 0.3), rel=EXACT
    )
    assert body.mass_matrix(q)[0, 0] == pytest.approx(inertia, rel=EXACT)


def test_two_links_by_hand() -> None:
    """The textbook two-link arm (Siciliano et al., Robotics, 2009, sec. 7.3.2), upright at 0."""
    body, twin = PinBody(robot("rrbot")), symbolic("rrbot")
    (q1, q2), (v1, v2), a = np.array([0.4, -1.1]), np.array([1.2, -0.8]), np.array([0.5, 2.0])
    mass, length, center, own, g = 1.0, 0.9, 0.45, 1.01 / 12, 9.81
    m22 = own + mass * center**2
    m12 = m22 + mass * length * center * np.cos(q2)
    m11 = 2 * own + mass * center**2 + mass * (length**2 + center**2 + 2 * length * center * np.cos(q2))
    h = -mass * length * center * np.sin(q2)
    g2 = -mass * g * center * np.sin(q1 + q2)
    g1 = -mass * g * center * np.sin(q1) - mass * g * length * np.sin(q1) + g2
    tau = np.array(
        [m11 * a[0] + m12 * a[1] + h * (2 * v1 * v2 + v2**2) + g1, m12 * a[0] + m22 * a[1] - h * v1**2 + g2]
    )
    q, v = np.array([q1, q2]), np.array([v1, v2])
    assert relative(body.rnea(q, v, a), tau) < EXACT
    assert relative(make_function(twin, "rnea")(q, v, a), tau) < EXACT
    assert relative(body.aba(q, v, tau, np.zeros(2)), a) < EXACT


# ---------------------------------------------------------------------- PinBody


@pytest.mark.parametrize("name", ["ur5", "centauro/floating", "every_joint"])
def test_one_convention_on_armature(name: str) -> None:
    """rnea, mass_matrix and aba hold the model's armature; aba adds its argument; regressor holds none."""
    body = PinBody(robot(name))
    q, v, a, armature = state(body, 1)
    mass, tau = body.mass_matrix(q), body.rnea(q, v, a)
    assert np.max(body.armature) > 0
    assert np.array_equal(mass, mass.T)
    assert relative(mass @ a + body.nle(q, v), tau) < EXACT
    # aba and a dense solve part by the condition number of M (up to 8e3 here) times eps = 2e-12
    assert relative(body.aba(q, v, tau, np.zeros(body.nv)), a) < 1e-11
    solved = np.linalg.solve(mass + np.diag(armature), tau - body.nle(q, v))
    assert relative(body.aba(q, v, tau, armature), solved) < 1e-11
    assert relative(body.regressor(q, v, a) @ body.inertial.ravel() + body.armature * a, tau) < EXACT
    # nothing of aba's armature stays behind
    assert np.array_equal(body.mass_matrix(q), mass)
    assert np.array_equal(body.rnea(q, v, a), tau)


def test_new_inertial_parameters_and_gravity_are_those_of_an_edited_model() -> None:
    model = robot("panda")
    inertial = inertial_of(model) * np.random.default_rng(3).uniform(0.8, 1.2, (model.njoints - 1, 10))
    gravity = np.array([0.5, -1.0, -9.7])
    edited = model.copy()
    edited.gravity.linear = gravity
    for index, row in enumerate(inertial):
        mass, moment = row[0], row[1:4]
        center = moment / mass
        about = np.array([[row[4], row[5], row[7]], [row[5], row[6], row[8]], [row[7], row[8], row[9]]])
        steiner = mass * (center @ center * np.eye(3) - np.outer(center, center))
        edited.inertias[index + 1] = pin.Inertia(mass, center, about - steiner)
    body, reference = PinBody(model, inertial, gravity), PinBody(edited)
    assert relative(body.inertial, inertial) < EXACT
    assert np.array_equal(body.gravity, gravity)
    q, v, a, armature = state(body, 2)
    assert relative(body.aba(q, v, a, armature), reference.aba(q, v, a, armature)) < EXACT
    assert relative(body.rnea(q, v, a), reference.rnea(q, v, a)) < EXACT
    assert relative(body.rnea(q, v, a), PinBody(model).rnea(q, v, a)) > 1e-3


def test_bodies_without_mass() -> None:
    """A row of zeros is a body that weighs nothing; Pinocchio's own conversion gives NaN there."""
    model = robot("ur5")
    inertial = inertial_of(model)
    inertial[2] = 0.0
    inertial[5] = [0, 0, 0, 0, 1e-3, 0, 1e-3, 0, 0, 1e-3]
    body, twin = PinBody(model, inertial), SymbolicBody(model, inertial)
    assert np.array_equal(body.inertial[[2, 5]], inertial[[2, 5]])
    q, v, a, armature = state(body, 6)
    for method, arguments in (("rnea", (q, v, a)), ("aba", (q, v, a, armature)), ("mass_matrix", (q,))):
        expected = getattr(body, method)(*arguments)
        assert np.all(np.isfinite(expected))
        assert relative(make_function(twin, method)(*arguments), expected) < EXACT
    assert (
        relative(body.regressor(q, v, a) @ inertial.ravel() + body.armature * a, body.rnea(q, v, a)) < EXACT
    )


@pytest.mark.parametrize("name", ["ur5", "every_joint"])
def test_derivatives_are_central_differences(name: str) -> None:
    body = PinBody(robot(name))
    q, v, a, armature = state(body, 8)
    width = 1e-6

    def differences(function, at_q: np.ndarray, at_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nudges = width * np.eye(body.nv)
        by_q = [
            function(body.integrate(at_q, n), at_v) - function(body.integrate(at_q, -n), at_v) for n in nudges
        ]
        by_v = [function(at_q, at_v + n) - function(at_q, at_v - n) for n in nudges]
        return np.array(by_q).T / (2 * width), np.array(by_v).T / (2 * width)

    dq, dv, mass = body.rnea_derivatives(q, v, a)
    by_q, by_v = differences(lambda x, y: body.rnea(x, y, a), q, v)
    # eps / width = 2e-10 of round-off, times the cancellation in the sums
    assert relative(dq, by_q) < 1e-7
    assert relative(dv, by_v) < 1e-7
    assert relative(mass, body.mass_matrix(q)) < EXACT
    dq, dv, inverse = body.aba_derivatives(q, v, a, armature)
    by_q, by_v = differences(lambda x, y: body.aba(x, y, a, armature), q, v)
    assert relative(dq, by_q) < 1e-7
    assert relative(dv, by_v) < 1e-7
    assert relative(inverse @ (body.mass_matrix(q) + np.diag(armature)), np.eye(body.nv)) < 1e-10


def test_frame_jacobian_and_difference_are_those_of_the_placement_and_the_step() -> None:
    body = PinBody(robot("every_joint"))
    frame = robot("every_joint").frames[len(robot("every_joint").frames) - 1].name
    q, v, *_ = state(body, 9)
    jacobian, here, width = body.frame_jacobian(q, frame), body.frame_placement(q, frame), 1e-6
    ahead, behind = (body.frame_placement(body.integrate(q, s * width * v), frame) for s in (1, -1))
    rate = (ahead - behind) / (2 * width)
    spin = rate[:3, :3] @ here[:3, :3].T
    expected = np.concatenate([rate[:3, 3], [spin[2, 1], spin[0, 2], spin[1, 0]]])
    assert relative(jacobian @ v, expected) < 1e-8  # central differences at 1e-6
    assert relative(body.difference(q, body.integrate(q, 0.5 * v)), 0.5 * v) < 1e-10


def test_batches_are_loops() -> None:
    body = PinBody(robot("every_joint"))
    q, v, a = (np.array(rows) for rows in zip(*(state(body, seed)[:3] for seed in range(5)), strict=True))
    assert np.array_equal(body.rnea_batch(q, v, a), [body.rnea(*row) for row in zip(q, v, a, strict=True)])
    assert np.array_equal(
        body.regressor_batch(q, v, a), [body.regressor(*row) for row in zip(q, v, a, strict=True)]
    )
    single = [body.rnea_derivatives(*row) for row in zip(q, v, a, strict=True)]
    for got, expected in zip(body.rnea_derivatives_batch(q, v, a), zip(*single, strict=True), strict=True):
        assert np.array_equal(got, expected)
    with pytest.raises(ModelError, match="5, 4 and 5"):
        body.rnea_batch(q, v[:-1], a)


def test_every_result_is_fresh() -> None:
    """Pinocchio hands out views of its work space for some results: the next call would change them."""
    body = PinBody(robot("every_joint"))
    frame = robot("every_joint").frames[len(robot("every_joint").frames) - 1].name
    first, second = state(body, 1), state(body, 2)
    calls = {
        "aba": body.aba,
        "rnea": lambda q, v, a, k: body.rnea(q, v, a),
        "mass_matrix": lambda q, v, a, k: body.mass_matrix(q),
        "gravity_torque": lambda q, v, a, k: body.gravity_torque(q),
        "nle": lambda q, v, a, k: body.nle(q, v),
        "integrate": lambda q, v, a, k: body.integrate(q, v),
        "regressor": lambda q, v, a, k: body.regressor(q, v, a),
        "frame_placement": lambda q, v, a, k: body.frame_placement(q, frame),
        "frame_jacobian": lambda q, v, a, k: body.frame_jacobian(q, frame),
        "center_of_mass": lambda q, v, a, k: body.center_of_mass(q),
        "rnea_derivatives": lambda q, v, a, k: body.rnea_derivatives(q, v, a),
        "aba_derivatives": body.aba_derivatives,
    }
    for name, call in calls.items():
        results = call(*first)
        kept = copy.deepcopy(results)
        other = call(*second)
        for before, after, new in zip(
            *(x if isinstance(x, tuple) else (x,) for x in (kept, results, other)), strict=True
        ):
            assert np.array_equal(before, after), name
            assert not np.array_equal(after, new), name


def test_the_model_handed_in_is_untouched() -> None:
    model = rrbot()
    model.armature = np.array([0.1, 0.2])
    before = model.copy()
    body = PinBody(model, 2 * inertial_of(model), np.zeros(3))
    body.aba(np.ones(2), np.ones(2), np.ones(2), np.ones(2))
    make_function(SymbolicBody(model, 2 * inertial_of(model), np.zeros(3)), "aba")
    assert model == before
    assert np.array_equal(model.gravity.linear, before.gravity.linear)
    model.armature = np.zeros(2)  # nor does a later change of it reach the body
    assert np.array_equal(body.armature, [0.1, 0.2])
    assert body.mass_matrix(np.zeros(2))[1, 1] == pytest.approx(2 * (1.01 / 12 + 0.45**2) + 0.2, rel=EXACT)


@pytest.mark.parametrize("clone", [copy.copy, copy.deepcopy, lambda body: pickle.loads(pickle.dumps(body))])
def test_a_copy_computes_the_same_and_is_apart(clone) -> None:
    model = robot("every_joint")
    body = PinBody(model, 1.1 * inertial_of(model), np.array([0.0, 1.0, -9.0]))
    q, v, a, armature = state(body, 3)
    expected = body.aba(q, v, a, armature)
    twin = clone(body)
    body.aba(q, v, a, 5 * armature)
    assert np.array_equal(twin.aba(q, v, a, armature), expected)


def test_one_degree_of_freedom_keeps_its_shapes() -> None:
    """Pinocchio's Python layer turns matrices of one row or column into vectors."""
    body, one = PinBody(robot("one_link")), np.ones(1)
    assert body.mass_matrix(one).shape == (1, 1)
    assert body.regressor(one, one, one).shape == (1, 10)
    assert body.frame_jacobian(one, "arm").shape == (6, 1)
    ones = np.ones((4, 1))
    assert body.regressor_batch(ones, ones, ones).shape == (4, 1, 10)
    assert [x.shape for x in body.rnea_derivatives_batch(ones, ones, ones)] == [(4, 1, 1)] * 3
    assert [x.shape for x in body.aba_derivatives(one, one, one, one)] == [(1, 1)] * 3


# ---------------------------------------------------------------------- what is refused


def test_branches_in_mixed_order_are_refused_by_pinocchios_side_only() -> None:
    """A joint added to a finished branch: Pinocchio's crba is off by percents there, without a word."""
    model = pin.Model()
    for parent, name in ((0, "root"), (1, "left"), (1, "right"), (2, "left_again")):
        index = model.addJoint(parent, pin.JointModelRX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(index, random_inertia(np.random.default_rng(index)), pin.SE3.Identity())
    with pytest.raises(ModelError, match="'left' are not consecutive"):
        PinBody(model)
    SymbolicBody(model)


def test_a_mimic_joint_is_named() -> None:
    model = pin.transformJointIntoMimic(rrbot(), 1, 2, 2.0, 0.1)
    with pytest.raises(ModelError, match="'joint2' has type JointModelMimic"):
        PinBody(model)


@pytest.mark.parametrize("body", [PinBody, SymbolicBody])
@pytest.mark.parametrize(
    ("inertial", "gravity", "message"),
    [
        (np.ones((3, 10)), None, r"inertial: .*\(2, 10\), got \(3, 10\)"),
        (np.full((2, 10), np.nan), None, "inertial: .*finite"),
        (None, np.ones(6), "gravity: expected 3 finite"),
        (None, np.array([0, 0, np.inf]), "gravity: expected 3 finite"),
    ],
)
def test_wrong_parameters_are_refused(body, inertial, gravity, message) -> None:
    with pytest.raises(ModelError, match=message):
        body(rrbot(), inertial, gravity)


def test_a_first_moment_without_mass_is_refused() -> None:
    inertial = inertial_of(rrbot())
    inertial[1, 0] = 0.0
    with pytest.raises(ModelError, match="joint2"):
        PinBody(rrbot(), inertial)


def test_unknown_names_are_refused_with_the_valid_ones() -> None:
    body, twin = PinBody(rrbot()), symbolic("rrbot")
    for call in (body.frame_jacobian, body.frame_placement, twin.frame_jacobian, twin.frame_placement):
        with pytest.raises(UnknownNameError, match="joint2"):
            call(np.zeros(2), "joint3")
    with pytest.raises(UnknownNameError, match="mass_matrix"):
        make_function(twin, "mass_matrx")
    with pytest.raises(FlexJointError, match="takes no frame"):
        make_function(twin, "rnea", "joint2")
    with pytest.raises(FlexJointError, match="needs a frame"):
        make_function(twin, "frame_jacobian")


def test_a_frame_name_that_two_frames_share_is_refused() -> None:
    model = rrbot()
    model.addBodyFrame("joint2", 2, pin.SE3.Identity(), 0)
    with pytest.raises(ModelError, match="expected one frame called 'joint2', got 2"):
        PinBody(model).frame_jacobian(np.zeros(2), "joint2")
