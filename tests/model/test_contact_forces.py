"""Robots that stand: contact forces balance what no motor holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize
from support.robots import standing
from support.robots.arms import PLANAR, make
from support.robots.standing import FEET

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.model.statics.forces import Contact
from flexjoint.robot import robot
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.description import example_robot_data

MASS = 117.11808198  # kg, of CENTAURO's URDF
WEIGHT = 9.81 * MASS


def poses(model: FlexibleJointModel, count: int, spread: float) -> np.ndarray:
    """Around the spider pose, base included."""
    rng = np.random.default_rng(11)
    start = standing.spider(model)
    return np.array([model.body.integrate(start, spread * rng.normal(size=model.nv)) for _ in range(count)])


def test_the_feet_carry_the_robot() -> None:
    """Force and moment balance, written with Newton's laws at the centre of mass."""
    model = standing.model()
    q = poses(model, 20, 0.1)
    rest = equilibrium(model, q, FEET)
    forces = rest.forces[:, :, :3]
    np.testing.assert_allclose(forces.sum(axis=1), np.tile([0, 0, WEIGHT], (20, 1)), atol=1e-9 * WEIGHT)
    for pose, pushes in zip(q, forces, strict=True):
        feet = np.array([model.body.frame_placement(pose, foot.frame)[:3, 3] for foot in FEET])
        moment = np.cross(feet - model.body.center_of_mass(pose), pushes).sum(axis=0)
        np.testing.assert_allclose(moment, 0.0, atol=1e-9 * WEIGHT)
    np.testing.assert_allclose(rest.unbalanced, 0.0, atol=1e-9 * WEIGHT)
    assert np.all(forces[:, :, 2] > 0.0) and not np.any(rest.forces[:, :, 3:])


def test_the_motors_give_the_rest() -> None:
    """tau = g - J_c' lambda on the joints' rows; legs that stand bend the other way than legs that hang."""
    model = standing.model()
    q = poses(model, 3, 0.05)
    rest, hanging = equilibrium(model, q, FEET), equilibrium(model, q)
    places = [joint.idx_v for joint in model.joints]
    for k, pose in enumerate(q):
        made = sum(
            model.body.frame_jacobian(pose, foot.frame).T @ rest.forces[k, c] for c, foot in enumerate(FEET)
        )
        expected = (model.body.gravity_torque(pose) - made)[places]
        np.testing.assert_allclose(rest.tau[k], expected, atol=1e-9 * WEIGHT)
    knee = model.robot.joint_names.index("hip_pitch_1")
    assert np.all(rest.tau[:, knee] * hanging.tau[:, knee] < 0.0)
    # without contacts the base hangs from outside, by its weight
    np.testing.assert_allclose(np.linalg.norm(hanging.unbalanced[:, :3], axis=1), WEIGHT, rtol=1e-9)


def test_forces_are_the_smallest_that_balance() -> None:
    """No other distribution over the feet has a smaller sum of squares: lambda lies in the range of the
    base's columns of J_c, so it is normal to whatever changes nothing."""
    model = standing.model()
    pose = standing.spider(model)
    rest = equilibrium(model, pose, [Contact(foot.frame) for foot in FEET])
    jacobian = np.vstack([model.body.frame_jacobian(pose, foot.frame)[:3] for foot in FEET])[:, :6]
    pushed = rest.forces[0, :, :3].ravel()
    image, *_ = np.linalg.lstsq(jacobian, pushed, rcond=None)
    np.testing.assert_allclose(jacobian @ image, pushed, atol=1e-9 * WEIGHT)


def corner_loaded() -> tuple[FlexibleJointModel, np.ndarray]:
    """A load near one foot: the smallest forces would pull at the foot across."""
    model = standing.model("floating", (effect("payload", "ankle_yaw_1", mass=300.0),))
    return model, standing.spider(model)


def test_feet_that_push_are_those_of_an_optimiser() -> None:
    model, pose = corner_loaded()
    free = equilibrium(model, pose, [Contact(foot.frame) for foot in FEET]).forces[0, :, :3]
    assert np.min(free[:, 2]) < -10.0
    pushing = equilibrium(model, pose, FEET).forces[0, :, :3]
    assert np.min(pushing[:, 2]) == pytest.approx(0.0, abs=1e-9 * WEIGHT)
    jacobian = np.vstack([model.body.frame_jacobian(pose, foot.frame)[:3] for foot in FEET])[:, :6]
    load = model.body.gravity_torque(pose)[:6]
    best = minimize(
        lambda x: x @ x,
        free.ravel() / WEIGHT,
        jac=lambda x: 2 * x,
        bounds=[(0.0 if k % 3 == 2 else None, None) for k in range(12)],
        constraints={
            "type": "eq",
            "fun": lambda x: jacobian.T @ x - load / WEIGHT,
            "jac": lambda x: jacobian.T,
        },
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 300},
    )
    assert best.success
    np.testing.assert_allclose(
        pushing.ravel() / WEIGHT, best.x, atol=1e-6
    )  # SLSQP's tolerance, square-rooted


def test_what_feet_cannot_balance_is_named() -> None:
    """Two feet leave the moment about the line between them: the front ones carry the weight at an arm."""
    model = standing.model()
    pose = standing.spider(model)
    arm = 0.44998708 - model.body.center_of_mass(pose)[0]
    with pytest.raises(
        ModelError, match=r"pose 0: the contacts \(contact_1, contact_2\) cannot carry"
    ) as said:
        equilibrium(model, pose, FEET[:2])
    assert f"moment (0, {arm * WEIGHT:.4g}, 0) N m" in str(said.value)
    ceiling = [Contact(foot.frame, normal=(0.0, 0.0, -2.0), pushes=True) for foot in FEET]
    with pytest.raises(ModelError, match=r"by pushing; left unbalanced: force \(0, 0, 1149\) N"):
        equilibrium(model, pose, ceiling)


def test_the_pose_that_tips_over_is_named() -> None:
    """On three feet, with a load in the hand that turns towards the missing one."""
    model = standing.model("floating", (effect("payload", "j_arm1_6", mass=60.0),))
    q = np.tile(standing.spider(model), (2, 1))
    q[1, model.robot.joint("torso_yaw").idx_q] = np.pi
    three = FEET[:3]
    assert np.all(equilibrium(model, q[:1], three).forces[0, :, 2] > 0.0)
    with pytest.raises(ModelError, match=r"pose 1: .*cannot carry the robot by pushing"):
        equilibrium(model, q, three)
    glued = [Contact(foot.frame) for foot in three]
    assert np.min(equilibrium(model, q, glued).forces[1, :, 2]) < 0.0


def test_a_flat_foot_carries_moments() -> None:
    """One foot with an area stands where a point would tip."""
    model = standing.model()
    pose = standing.spider(model)
    foot = Contact("contact_1", surface=True)
    (wrench,) = equilibrium(model, pose, [foot]).forces[0]
    lever = model.body.center_of_mass(pose) - model.body.frame_placement(pose, "contact_1")[:3, 3]
    np.testing.assert_allclose(wrench[:3], [0.0, 0.0, WEIGHT], atol=1e-9 * WEIGHT)
    np.testing.assert_allclose(wrench[3:], np.cross(lever, [0.0, 0.0, WEIGHT]), atol=1e-9 * WEIGHT)


def test_talos_stands_on_two_flat_feet() -> None:
    """All its joints actuated; each foot carries force and moment, together the weight."""
    urdf = "package://example-robot-data/robots/talos_data/robots/talos_full_v2.urdf"
    path = example_robot_data() / urdf.removeprefix("package://")
    rigid = pin.buildModelFromUrdf(str(path))
    drive = {"stiffness": 1e4, "motor_inertia": 0.5}
    file = {"name": "talos", "urdf": urdf, "base": "floating", "joints": {n: drive for n in rigid.names[1:]}}
    model = FlexibleJointModel(robot.build(robot_schema.parse(file, "talos"), Path("talos.yaml")))
    pose = model.body.neutral.copy()
    for side in ("left", "right"):  # knees a little bent
        for name, angle in (
            (f"leg_{side}_3_joint", -0.4),
            (f"leg_{side}_4_joint", 0.8),
            (f"leg_{side}_5_joint", -0.4),
        ):
            pose[model.robot.joint(name).idx_q] = angle
    feet = [Contact(f"{side}_sole_link", pushes=True, surface=True) for side in ("left", "right")]
    rest = equilibrium(model, pose, feet)
    weight = 9.81 * sum(inertia.mass for inertia in model.robot.model.inertias)
    np.testing.assert_allclose(rest.forces[0, :, :3].sum(axis=0), [0, 0, weight], atol=1e-9 * weight)
    np.testing.assert_allclose(rest.unbalanced, 0.0, atol=1e-9 * weight)
    assert np.all(rest.forces[0, :, 2] > 0.3 * weight)  # it stands upright between them


def test_a_passive_joint_is_held_by_contacts() -> None:
    model = FlexibleJointModel(make(PLANAR, {"knee": None}), [])
    pose = np.array([0.3, -0.9])
    swinging = equilibrium(model, pose)
    load = 1.5 * 9.81 * 0.17 * np.sin(pose.sum())
    np.testing.assert_allclose(swinging.unbalanced, [[load]], rtol=1e-12)
    held = equilibrium(model, pose, [Contact("knee_link", surface=True)])
    np.testing.assert_allclose(held.unbalanced, 0.0, atol=1e-12)
    with pytest.raises(ModelError, match=r"left unbalanced: -1\.41\d N m at knee"):
        equilibrium(model, pose, [Contact("knee_link")])  # a point on the joint's axis has no arm


def test_known_forces_are_taken_as_they_are() -> None:
    """A force at the knee's axis, 0.4 m down the thigh: its moment about the hip by hand."""
    model = FlexibleJointModel(make(PLANAR), [])
    q = np.array([[0.3, -0.9], [-1.2, 0.4]])
    force = np.array([[3.0, 5.0, -20.0, 0.0, 0.7, 0.0]])
    rest, free = equilibrium(model, q, [Contact("knee_link")], forces=force), equilibrium(model, q)
    x, z = -0.4 * np.sin(q[:, 0]), -0.4 * np.cos(q[:, 0])  # of the knee from the hip; +y turns z towards x
    np.testing.assert_allclose(free.tau[:, 0] - rest.tau[:, 0], z * 3.0 - x * -20.0 + 0.7, atol=1e-12)
    np.testing.assert_allclose(free.tau[:, 1] - rest.tau[:, 1], 0.7, atol=1e-12)
    with pytest.raises(ModelError, match=r"forces: .*\(2, 1, 6\)"):
        equilibrium(model, q, [Contact("knee_link")], forces=np.zeros(3))


def test_contacts_that_make_no_sense_are_refused() -> None:
    model = standing.model()
    pose = standing.spider(model)
    with pytest.raises(UnknownNameError, match=r"frame 'contact_5'.*contact_1"):
        equilibrium(model, pose, [Contact("contact_5")])
    with pytest.raises(ModelError, match="normal must be 3 numbers"):
        equilibrium(model, pose, [Contact("contact_1", normal=(0.0, 0.0, 0.0))])


def test_a_batch_that_stands_is_a_loop() -> None:
    model, pose = corner_loaded()
    q = np.array([model.body.integrate(pose, 0.02 * np.sin(np.arange(model.nv) + k)) for k in range(6)])
    together = equilibrium(model, q, FEET)
    for k, row in enumerate(q):
        alone = equilibrium(model, row, FEET)
        np.testing.assert_allclose(together.tau[k], alone.tau[0], atol=1e-9 * WEIGHT)
        np.testing.assert_allclose(together.forces[k], alone.forces[0], atol=1e-9 * WEIGHT)
