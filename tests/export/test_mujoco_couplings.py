"""Motors that several joints share, and frictions of such, in the exported MJCF: as in our own simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.robots.arms import waves
from support.robots.coupled_robots import DIFFERENTIAL, THROUGH, Matrix, coupled
from support.thorough import thorough

from flexjoint.core.errors import RobotError
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.export.base import Level
from flexjoint.export.mjcf import Mjcf
from flexjoint.export.mujoco_run import MujocoRun
from flexjoint.export.targets import TARGETS, exported
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.start import at_rest, initial_positions
from flexjoint.robot.couplings import Coupling
from flexjoint.robot.draft import draft
from flexjoint.robot.robot import Robot, load
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

mujoco = pytest.importorskip("mujoco")

TICK, TICKS = 500.0, 200  # Hz, at which torques change, and how often they do
FINE = 12  # our own steps in a tick
COARSE, SHORT = 2, 8  # MuJoCo's
SHRINKS, FLOOR = 0.35, 3e-6  # as in test_mujoco.py
SHARE = 1e-3  # of the motion that dry friction may err by at 1 kHz; without friction it errs by 3e-8 rad
SKEW: Matrix = ((1.0, 0.2), (-0.3, 1.4))
EFFECTS: tuple[tuple[Planned, ...], ...] = (
    (),
    (effect("motor_coulomb_friction", "pitch", level=0.6),),
    (effect("motor_viscous_friction", "pitch", coefficient=0.7),),
    (effect("asymmetric_friction", "pitch", level_positive=0.8, level_negative=0.2),),
    (effect("motor_inertia", "roll", scale=0.5),),
    (effect("dahl_friction", "pitch", level=0.6, scale=5e-3),),
    (effect("cogging", "pitch", amplitude=1.0, cycles=7.0),),
    (effect("torque_gain", "pitch", gain=0.3), effect("torque_offset", "pitch", offset=0.8)),
    (effect("coupled_friction", "pitch", level=0.5, coefficient=0.3, speed="difference"),),
)
KINDS = pytest.mark.parametrize("rigid", [False, True], ids=["flexible", "rigid"])


def arm_of(matrix: Matrix | None, rigid: bool, *effects: Planned) -> Robot:
    arm = coupled(matrix, rigid=rigid).extended(effects)
    rates = arm.rates.model_copy(update={"physics": TICK, "control": TICK})
    return replace(arm, rates=rates)


def torques() -> np.ndarray:
    return 3.0 * waves(3, TICKS, TICK, 2.0)


def positions(tape: Any) -> np.ndarray:
    return np.concatenate([tape.q[tape.first :], tape.theta[tape.first :]], axis=1)


def ours(arm: Robot) -> np.ndarray:
    model = FlexibleJointModel(arm)
    start = at_rest(model, initial_positions(model))
    torque = np.repeat(torques(), FINE, axis=0)
    return positions(rollout(model, start, torque, RunOptions(rate=TICK * FINE, engine="pin")))[::FINE]


def theirs(arm: Robot, steps: int) -> np.ndarray:
    fast = replace(arm, rates=arm.rates.model_copy(update={"physics": TICK * steps}))
    model = FlexibleJointModel(arm)
    run = MujocoRun(exported(fast, "mjcf").text, model)
    return positions(run.rollout(model, at_rest(model, initial_positions(model)), torques()))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@KINDS
@pytest.mark.parametrize("matrix", [THROUGH, DIFFERENTIAL, SKEW], ids=["through", "differential", "skew"])
def test_shared_motors_move_as_ours_do(matrix: Matrix, rigid: bool) -> None:
    arm = arm_of(matrix, rigid)
    levels = {row.what: row.way.level for row in exported(arm, "mjcf").account}
    assert levels["couplings"] is Level.EXACT
    truth, alone = ours(arm), ours(arm_of(None, rigid))
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert rms(truth - alone) > 1e-3  # leaving the coupling out would be seen
    assert coarse < SHARE * rms(truth - truth[:1]) and short < max(SHRINKS * coarse, FLOOR)


@thorough
@KINDS
@pytest.mark.parametrize("effects", EFFECTS[1:], ids=lambda effects: effects[0].effect.name)
def test_effects_on_a_shared_motor(effects: tuple[Planned, ...], rigid: bool) -> None:
    arm = arm_of(THROUGH, rigid, *effects)
    assert {Mjcf().judge(arm, planned).level for planned in effects} == {Level.EXACT}
    truth, without = ours(arm), ours(arm_of(THROUGH, rigid))
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert coarse < SHARE * rms(truth - truth[:1]) and short < max(SHRINKS * coarse, FLOOR)
    assert short < 0.1 * rms(truth - without)


@KINDS
@pytest.mark.parametrize("speed", ["sum", "difference"])
def test_a_friction_that_two_joints_share(speed: str, rigid: bool) -> None:
    arm = arm_of(None, rigid, effect("coupled_friction", "pitch", level=0.6, coefficient=0.4, speed=speed))
    truth, without = ours(arm), ours(arm_of(None, rigid))
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert coarse < SHARE * rms(truth - truth[:1]) and short < max(SHRINKS * coarse, FLOOR)
    assert short < 0.1 * rms(truth - without)


@KINDS
def test_friction_of_both_motors_of_a_differential(rigid: bool) -> None:
    motors = {
        "level_sum": 0.4,
        "coefficient_sum": 0.4,
        "level_difference": 0.2,
        "coefficient_difference": 0.3,
    }
    arm = arm_of(None, rigid, effect("differential_friction", "pitch", **motors))
    truth, without = ours(arm), ours(arm_of(None, rigid))
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert coarse < SHARE * rms(truth - truth[:1]) and short < max(SHRINKS * coarse, FLOOR)
    assert short < 0.1 * rms(truth - without)


def test_the_mass_matrix_has_the_shared_inertia() -> None:
    """TX40: motor 6 turns with joints 5 and 6."""
    arm = load("tx40")
    model = FlexibleJointModel(arm)
    engine = mujoco.MjModel.from_xml_string(exported(arm, "mjcf").text)
    data = mujoco.MjData(engine)
    q = np.array([0.3, -0.4, 0.5, 0.2, -0.6, 0.1])
    data.qpos[:] = q
    mujoco.mj_forward(engine, data)
    mass = np.zeros((6, 6))
    mujoco.mj_fullM(engine, data, mass)
    N = np.eye(6)
    (coupling,) = arm.couplings
    N[np.ix_(coupling.joints, coupling.joints)] = coupling.matrix
    rotors = N.T @ np.diag([flow.drive.B for flow in model.flows]) @ N
    expected = model.body.mass_matrix(q) + rotors
    assert abs(rotors[4, 5]) > 1e-3
    assert mass == pytest.approx(expected, abs=1e-9 * float(np.max(expected)))


def test_a_play_of_a_coupled_joint_has_the_springs_own_stiffness() -> None:
    arm = arm_of(THROUGH, False, effect("backlash", "pitch", gap=1e-3))
    engine = mujoco.MjModel.from_xml_string(exported(arm, "mjcf").text)
    k = engine.tendon("spring.pitch").id
    drive = arm.joint("pitch").drive
    scale = (1.0 - 1e-4) * engine.tendon_invweight0[k]
    assert engine.tendon_solref_lim[k] == pytest.approx([-drive.K * scale, -drive.D * scale], rel=1e-9)


@KINDS
@pytest.mark.parametrize("matrix", [THROUGH, SKEW], ids=["through", "skew"])
def test_what_init_reads_is_what_was_exported(matrix: Matrix, rigid: bool, tmp_path: Path) -> None:
    planned = [x for some in EFFECTS for x in some if x.effect.name not in ("motor_inertia",)]
    planned = [x for x in planned if x.key != ("asymmetric_friction", "pitch")]
    arm = arm_of(matrix, rigid, *planned, effect("asymmetric_friction", "roll", level_positive=0.3,
                                                 level_negative=0.7))  # fmt: skip
    exported(arm, "mjcf").write(tmp_path / "arm.xml")
    read = draft(str(tmp_path / "arm.xml"), tmp_path / "arm.yaml").robot
    (own,), (back,) = arm.couplings, read.couplings
    assert back.joints == own.joints and np.allclose(back.matrix, own.matrix)
    given = {e.key: e.p for e in arm.effects}
    found = {e.key: e.p for e in read.effects}
    viscous = {"pitch": given.pop(("motor_viscous_friction", "pitch")).coefficient}  # in the drive's damping
    for name in arm.joint_names:
        one, other = arm.joint(name).drive, read.joint(name).drive
        damping = one.D_m + viscous.get(name, 0.0)
        assert (other.K, other.B, other.D_m) == pytest.approx((one.K, one.B, damping), rel=1e-9)
    assert found.keys() == given.keys()
    for key, p in given.items():
        for param in catalogue()[key[0]].params:
            assert getattr(found[key], param.name) == pytest.approx(getattr(p, param.name), rel=1e-6), key


@KINDS
def test_init_reads_a_differential_back(rigid: bool, tmp_path: Path) -> None:
    numbers = {
        "level_sum": 0.4,
        "coefficient_sum": 0.3,
        "level_difference": 0.2,
        "coefficient_difference": 0.1,
    }
    exported(arm_of(None, rigid, effect("differential_friction", "pitch", **numbers)), "mjcf").write(
        tmp_path / "arm.xml"
    )
    (found,) = draft(str(tmp_path / "arm.xml"), tmp_path / "arm.yaml").robot.effects
    assert found.key == ("differential_friction", "pitch")
    assert dict(found.values) == pytest.approx(numbers, rel=1e-9)


@pytest.mark.parametrize(
    ("found", "put"),
    [
        ('<joint joint="rotor.roll" coef="1.0"', '<joint joint="rotor.yaw" coef="1.0"'),
        ('<fixed name="motor.roll"', '<fixed name="other.roll"'),
        ('joint="rotor.roll"', 'joint="payload"'),
    ],
)
def test_an_edited_coupling_is_refused_in_one_line(found: str, put: str, tmp_path: Path) -> None:
    text = exported(arm_of(THROUGH, False), "mjcf").text
    tendons = text.index("<tendon>")
    edited = text[:tendons] + text[tendons:].replace(found, put)
    assert edited != text
    (tmp_path / "arm.xml").write_text(edited)
    with pytest.raises(RobotError, match="export it anew") as error:
        draft(str(tmp_path / "arm.xml"), tmp_path / "arm.yaml")
    assert "\n" not in str(error.value)


# --- what is not carried ------------------------------------------------------------------------------------
def test_rigid_joints_of_two_branches_are_said_to_be_alone() -> None:
    model = pin.Model()
    inertia = pin.Inertia(1.0, np.array([0.0, 0.0, -0.2]), np.eye(3) * 0.01)
    for name in ("left", "right"):
        joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    arm = Robot.from_model(model, motor_inertia=0.1)
    arm = replace(arm, couplings=(Coupling((0, 1), DIFFERENTIAL),))
    arm = arm.extended([effect("motor_coulomb_friction", "left", level=0.5)])
    ways = {row.what: row.way for row in exported(arm, "mjcf").account}
    assert ways["couplings"].level is Level.NONE and "one branch" in ways["couplings"].how
    assert ways["motor_coulomb_friction"].level is Level.NEAR
    flexible = replace(arm, joints=tuple(replace(j, drive=replace(j.drive, K=500.0)) for j in arm.joints))
    assert "couplings" not in {row.what for row in exported(flexible, "mjcf").lost}


def test_what_no_actuator_of_joints_has() -> None:
    arm = arm_of(
        THROUGH,
        False,
        effect("torque_saturation", "pitch", limit=2.0),
        effect("joint_coupling", "roll", share=0.2, side="after"),
    )
    done = exported(arm, "mjcf")
    assert {"torque_saturation", "joint_coupling"} <= {row.what for row in done.lost}
    assert math.isinf(float(arm.joint("pitch").torque_limit)) is False
    assert "forcerange" not in done.text


@pytest.mark.parametrize("target", [name for name in TARGETS if name not in ("mjcf", "ros2_control")])
def test_elsewhere_a_shared_motor_acts_on_one_joint(target: str) -> None:
    arm = coupled(THROUGH, rigid=True).extended([effect("motor_viscous_friction", "pitch", coefficient=1.0)])
    rows = {row.what: row.way for row in exported(arm, target).account}
    assert rows["couplings"].level is Level.NONE
    assert rows["motor_viscous_friction"].level is not Level.EXACT
