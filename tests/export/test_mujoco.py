"""The exported MJCF against our own simulation: the same machine, whatever its effects."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support.robots.arms import PLANAR, SPATIAL, make, waves

from flexjoint.core.errors import MissingExtraError, ModelError, RobotError
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.export.base import Level
from flexjoint.export.mjcf import Mjcf, stepping
from flexjoint.export.mujoco_run import MujocoRun
from flexjoint.export.targets import exported
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.start import at_rest, initial_positions
from flexjoint.robot.robot import Robot, load, shipped_robots
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

mujoco = pytest.importorskip("mujoco")

TICK = 500.0  # Hz, at which torques change
TICKS = 250
FINE = 12  # our own steps in a tick
COARSE, SHORT = 2, 8  # MuJoCo's steps in a tick
SHRINKS = 0.35  # a quarter where MuJoCo is of order 1 (bristles, creep), and room for kinks between steps
FLOOR = 3e-6  # rad: dry friction creeps by 1e-4 of what pushes it in MuJoCo, and our own steps are finite
NEAR_SHARE = 0.2  # of what an effect does that may be missing of one that is carried nearly
SIZES: dict[str, dict[str, Any]] = {  # that matter in this motion
    "asymmetric_friction": {"level_positive": 1.2, "level_negative": 0.4},
    "backlash": {"gap": 4e-3},
    "base_tilt": {"roll": 0.1, "pitch": -0.2},
    "cable_spring": {"stiffness": 15.0, "rest": 0.3},
    "cogging": {"amplitude": 2.0, "cycles": 9.0},
    "coupled_friction": {"level": 0.6, "coefficient": 0.5},
    "current_lag": {"time_constant": 8e-3},
    "dahl_friction": {"level": 1.0, "scale": 5e-3},
    "differential_friction": {
        "level_sum": 0.6,
        "coefficient_sum": 0.5,
        "level_difference": 0.3,
        "coefficient_difference": 0.8,
    },
    "end_stop": {"position": 0.02, "stiffness": 500.0},
    "hardening_spring": {"cubic": 1e8},
    "joint_coupling": {"share": 0.3, "side": "before"},
    "link_coulomb_friction": {"level": 1.0},
    "link_viscous_friction": {"coefficient": 3.0},
    "motor_coulomb_friction": {"level": 1.0},
    "motor_inertia": {"scale": 0.5},
    "motor_viscous_friction": {"coefficient": 3.0},
    "joint_compliance": {"compliance": 2e-3, "relaxation": 2e-3},
    "magnetic_saturation": {"saturation": 0.05},
    "payload": {"mass": 0.5, "position": (0.1, 0.05, -0.1)},
    "quadratic_drag": {"coefficient": 2.0},
    "rotor_inertia": {"inertia": 0.3},
    "spring_creep": {"stiffness": 300.0, "time_constant": 0.1},
    "spring_damping": {"scale": -1.0},
    "spring_hysteresis": {"level": 1.0, "scale": 2e-3},
    "spring_preload": {"torque": 3.0},
    "spring_stiffness": {"scale": -0.3},
    "stribeck_friction": {"level": 0.5, "static_extra": 0.3, "velocity": 0.05},
    "torque_delay": {"delay": 7e-3},
    "torque_gain": {"gain": 0.2},
    "torque_offset": {"offset": 2.0},
    "torque_saturation": {"limit": 2.0},
    "torque_speed_limit": {"stall": 4.0, "drop": 8.0},
}
RIGID = {name: {"stiffness": math.inf, "damping": 0.0} for name in ("hip", "knee")}
CARRIED = [name for name in catalogue() if Mjcf().of_effect(name).level is not Level.NONE]
IN_READINGS = ("sensor_delay",)  # no matter to the motion; it has a test of its own


def robot(flexible: bool, *effects: Planned, **top: Any) -> Robot:
    arm = make(PLANAR, None if flexible else RIGID, rates={"physics": TICK, "control": TICK}, **top)
    return arm.extended(effects)


def torques(n: int) -> np.ndarray:
    """(TICKS, n) waves, and blows that make the springs ring."""
    blows = np.sign(np.sin(2.0 * np.pi * 5.0 * np.arange(TICKS)[:, None] / TICK + 0.5))
    return waves(n, TICKS, TICK, 8.0) + 2.0 * blows


def positions(tape: Any) -> np.ndarray:
    """(rows, nq + nf)"""
    return np.concatenate([tape.q[tape.first :], tape.theta[tape.first :]], axis=1)


def ours(arm: Robot) -> np.ndarray:
    model = FlexibleJointModel(arm)
    torque = np.repeat(torques(len(arm.joints)), FINE, axis=0)
    start = at_rest(model, initial_positions(model))
    return positions(rollout(model, start, torque, RunOptions(rate=TICK * FINE, engine="pin")))[::FINE]


def theirs(arm: Robot, steps: int) -> np.ndarray:
    """In MuJoCo with so many steps to a tick."""
    fast = replace(arm, rates=arm.rates.model_copy(update={"physics": TICK * steps}))
    model = FlexibleJointModel(arm)
    run = MujocoRun(exported(fast, "mjcf").text, model)
    assert run.engine.opt.timestep == pytest.approx(1.0 / (TICK * steps))  # the springs need no shorter one
    start = at_rest(model, initial_positions(model))
    return positions(run.rollout(model, start, torques(len(arm.joints))))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@cache
def without_effects(flexible: bool) -> np.ndarray:
    return ours(robot(flexible))


# --- each effect --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "flexible"),
    [
        pytest.param(name, flexible, id=f"{name or 'none'}-{'flexible' if flexible else 'rigid'}")
        for name in ["", *(name for name in CARRIED if name not in IN_READINGS)]
        for flexible in (True, False)
        if not name or not (catalogue()[name].for_rigid if flexible else catalogue()[name].needs_spring)
    ],
)
def test_the_difference_shrinks_with_the_step(name: str, flexible: bool) -> None:
    planned = [effect(name, None if catalogue()[name].whole_robot else "knee", **SIZES[name])] if name else []
    arm = robot(flexible, *planned)
    truth = ours(arm)
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    if not name:
        # RK4 at 1 kHz against our midpoint rule at 6 kHz, on motions of 0.1 rad
        assert coarse < 1e-7 and short < 1e-7
        return
    plain = without_effects(flexible)
    matters = rms(truth[:, : plain.shape[1]] - plain)  # a joint that bends has its motor's angle behind them
    if Mjcf().judge(arm, planned[0]).level is Level.EXACT:
        assert coarse < 1e-4 and short < max(SHRINKS * coarse, FLOOR)
        assert short < 0.1 * matters  # leaving the effect out would be seen
    else:
        assert short < NEAR_SHARE * matters


def test_effects_go_together() -> None:
    """The order of gain, offset and limit, a constant torque beside a spring, several at one hinge."""
    arm = robot(
        True,
        effect("torque_gain", "knee", gain=0.3),
        effect("torque_offset", "knee", offset=0.5),
        effect("torque_saturation", "knee", limit=4.0),
        effect("torque_delay", "knee", delay=5e-3),
        effect("current_lag", "knee", time_constant=4e-3),
        effect("cable_spring", "knee", stiffness=5.0, rest=0.2),
        effect("spring_preload", "knee", torque=-2.0),
        effect("asymmetric_friction", "knee", level_positive=0.2, level_negative=0.6),
        effect("motor_coulomb_friction", "knee", level=0.3),
        effect("payload", "knee", mass=0.3, position=(0.0, 0.1, -0.2)),
        effect("payload", "hip", mass=-0.2, position=(0.0, 0.0, -0.1)),
        effect("torque_gain", "hip", gain=-0.2),
        effect("joint_coupling", "hip", share=0.2, side="after"),
    )
    levels = {row.what: row.way.level for row in exported(arm, "mjcf").account}
    assert levels.pop("controller") is Level.NONE and levels.pop("joint_coupling") is Level.NEAR
    assert set(levels.values()) == {Level.EXACT}
    arm = arm.extended([effect("joint_coupling", "hip", share=0.0, side="after")])
    truth = ours(arm)
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert short < max(SHRINKS * coarse, FLOOR) and coarse < 1e-4


def test_gains_and_a_coupled_neighbour() -> None:
    arm = robot(
        True,
        effect("torque_gain", "hip", gain=-0.2),
        effect("torque_gain", "knee", gain=0.4),
        effect("joint_coupling", "knee", share=0.3, side="before"),
        effect("joint_coupling", "hip", share=-0.1, side="after"),
    )
    truth = ours(arm)
    coarse, short = (rms(theirs(arm, steps) - truth) for steps in (COARSE, SHORT))
    assert short < max(SHRINKS * coarse, FLOOR) and coarse < 1e-4


def test_readings_are_late_in_the_sensors() -> None:
    late = 6e-3
    arm = robot(True, effect("sensor_delay", "knee", delay=late, channel="theta"))
    model = FlexibleJointModel(arm)
    run = MujocoRun(exported(arm, "mjcf").text, model)
    seen: dict[str, list[float]] = {"q": [], "theta": []}
    true: dict[str, list[float]] = {"q": [], "theta": []}
    for row in waves(2, 60, TICK, 8.0):
        run.data.ctrl[:] = row
        mujoco.mj_step(run.engine, run.data)
        mujoco.mj_forward(run.engine, run.data)
        q, _, theta, _ = run.state()
        true["q"].append(q[1])
        true["theta"].append(theta[1])
        for channel, values in seen.items():
            values.append(float(run.data.sensor(f"{channel}.knee").data[0]))
    assert seen["q"] == pytest.approx(true["q"], abs=1e-12)
    steps = round(late * TICK)
    # the buffer holds what sensors read before the last step: one step more
    apart = [
        rms(np.subtract(seen["theta"][10:], true["theta"][10 - k : -k]))
        for k in (steps - 1, steps, steps + 1)
    ]
    assert min(apart) < 1e-9 and rms(np.subtract(seen["theta"], true["theta"])) > 1e-4


# --- bodies -------------------------------------------------------------------------------------------------
ROBOTS = [name for name in shipped_robots() if name != "centauro"]


@pytest.mark.parametrize("name", [*ROBOTS, "centauro", "centauro grounded", "sliding", "tilted"])
def test_mass_matrix_and_gravity_are_pinocchios(name: str) -> None:
    if name == "sliding":
        arm = Robot.from_model(sliding(), stiffness=500.0, motor_inertia=0.2)
    elif name == "tilted":
        carried = effect("payload", "pitch", mass=0.7, position=(0.1, -0.05, 0.2))
        arm = make(SPATIAL, {"roll": None}).extended([effect("base_tilt", roll=0.3, pitch=-0.4), carried])
    else:
        arm = load(name.split(maxsplit=1)[0], grounded="grounded" in name)
    model = FlexibleJointModel(arm)
    engine = mujoco.MjModel.from_xml_string(exported(arm, "mjcf").text)
    data = mujoco.MjData(engine)
    nv, body = arm.model.nv, arm.model
    q = pin.randomConfiguration(body, -np.ones(body.nq), np.ones(body.nq))
    data.qpos[: body.nq] = q
    frame = np.eye(nv)
    if arm.floating:  # MuJoCo's linear velocity is that of the world's axes, and its quaternions begin with w
        data.qpos[3:7] = np.roll(q[3:7], 1)
        frame[:3, :3] = pin.Quaternion(q[3:7]).toRotationMatrix().T
    mujoco.mj_forward(engine, data)
    mass = np.zeros((engine.nv, engine.nv))
    mujoco.mj_fullM(engine, data, mass)
    expected = model.body.mass_matrix(q).copy()
    for i in set(model.rigid) - model.grouped:
        expected[model.joints[i].idx_v, model.joints[i].idx_v] += model.flows[i].drive.B
    for group in (group for group in model.groups if group.rigid):
        places = [model.joints[i].idx_v for i in group.joints]
        expected[np.ix_(places, places)] += np.array(group.inertia)
    expected = frame.T @ expected @ frame
    assert mass[:nv, :nv] == pytest.approx(expected, abs=1e-9 * float(np.max(np.abs(expected))))
    gravity = frame.T @ model.body.gravity_torque(q)
    assert data.qfrc_bias[:nv] == pytest.approx(gravity, abs=1e-9 * float(np.max(np.abs(gravity))))
    rotors = [engine.joint(f"rotor.{model.joints[i].name}").id for i in model.flexible]
    places = engine.jnt_dofadr[rotors]
    # a speck of inertia is that of the body that MuJoCo wants around a hinge
    assert mass[places, places] == pytest.approx([model.flows[i].drive.B for i in model.flexible], rel=1e-9)


def test_a_play_is_a_limit_with_the_springs_own_stiffness() -> None:
    """The solver scales a limit's stiffness by the inverse inertia that it finds at the file's pose."""
    arm = make(PLANAR, {"hip": RIGID["hip"]}).extended([effect("backlash", "knee", gap=1e-3)])
    engine = mujoco.MjModel.from_xml_string(exported(arm, "mjcf").text)
    k = engine.tendon("spring.knee").id
    drive = arm.joint("knee").drive
    scale = (1.0 - 1e-4) * engine.tendon_invweight0[k]
    assert engine.tendon_solref_lim[k] == pytest.approx([-drive.K * scale, -drive.D * scale], rel=1e-9)
    assert engine.tendon_stiffness[k] == 0.0 and engine.tendon_range[k] == pytest.approx([-5e-4, 5e-4])


def sliding() -> pin.Model:
    """A slide along a slanted axis that carries a turning arm and a passive one."""
    model = pin.Model()
    axis = np.array([1.0, 0.0, 2.0]) / math.sqrt(5.0)
    inertia = pin.Inertia(2.0, np.array([0.1, 0.0, -0.2]), np.diag([0.02, 0.03, 0.025]))
    slide = model.addJoint(0, pin.JointModelPrismaticUnaligned(axis), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(slide, inertia, pin.SE3.Identity())
    place = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.1), np.array([0.0, 0.1, -0.4]))
    turn = model.addJoint(slide, pin.JointModelRY(), place, "turn")
    model.appendBodyToJoint(turn, inertia, pin.SE3.Identity())
    return model


def test_joints_that_slide_and_passive_ones_move_as_ours_do() -> None:
    rates = {"physics": TICK * SHORT, "control": TICK}
    numbers = {"stiffness": 5000.0, "damping": 5.0, "motor_inertia": 2.0, "motor_damping": 10.0}
    arm = Robot.from_model(sliding(), ["slide"], **numbers, rates=rates)
    arm = arm.extended([effect("motor_coulomb_friction", "slide", level=5.0)])
    model = FlexibleJointModel(arm)
    torque = 20.0 + 10.0 * torques(1)
    run = MujocoRun(exported(arm, "mjcf").text, model)
    got = run.rollout(model, model.rest(), torque, RunOptions(rate=TICK))
    expected = rollout(
        model, model.rest(), np.repeat(torque, FINE, axis=0), RunOptions(rate=TICK * FINE, engine="pin")
    )
    apart = positions(got) - positions(expected)[::FINE]
    # it slides by half a metre while the arm swings; friction that sticks is of order 1 in MuJoCo
    assert np.ptp(expected.q[:, 0]) > 0.4 and np.ptp(expected.q[:, 1]) > 0.3
    assert rms(apart) < 1e-4


def test_a_floating_base_falls_as_ours_does() -> None:
    arm = make(SPATIAL, base="floating", rates={"physics": TICK, "control": TICK})
    model = FlexibleJointModel(arm)
    start = model.rest()
    start.v[:6] = [0.3, -0.2, 0.1, 0.5, -0.4, 0.3]  # in the base's own axes
    torque = waves(3, 100, TICK, 2.0)
    fast = replace(arm, rates=arm.rates.model_copy(update={"physics": TICK * SHORT}))
    run = MujocoRun(exported(fast, "mjcf").text, model)
    got = run.rollout(model, start, torque)
    expected = rollout(
        model, start, np.repeat(torque, FINE, axis=0), RunOptions(rate=TICK * FINE, engine="pin")
    )
    # ours is of order 2 at 6 kHz, but of order 1 in the attitude of a base that tumbles
    assert got.q[-1] == pytest.approx(expected.q[-1], abs=2e-5)
    assert got.v[-1] == pytest.approx(expected.v[-1], abs=2e-4)


def test_an_inertia_that_no_body_has_is_raised_and_said() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    flat = pin.Inertia(1.0, np.zeros(3), np.diag([0.01, 0.01, 0.05]))
    model.appendBodyToJoint(joint, flat, pin.SE3.Identity())
    done = exported(Robot.from_model(model, motor_inertia=0.1), "mjcf")
    assert "inertia of link.turn: near: no body has it" in done.text
    engine = mujoco.MjModel.from_xml_string(done.text)
    assert np.sort(engine.body("link.turn").inertia) == pytest.approx([0.025, 0.025, 0.05])


# --- steps and refusals -------------------------------------------------------------------------------------
def test_a_stiff_spring_gets_a_shorter_step() -> None:
    soft, stiff = make(PLANAR), make(PLANAR, {"knee": {"stiffness": 1e6}})
    assert stepping(FlexibleJointModel(soft)) == ("RK4", 1e-3)
    integrator, step = stepping(FlexibleJointModel(stiff))
    assert integrator == "RK4"
    assert step < 2e-4 and (1e-3 / step) == pytest.approx(round(1e-3 / step))
    assert "The step is shorter" in exported(stiff, "mjcf").text
    model = FlexibleJointModel(stiff)
    tape = MujocoRun(exported(stiff, "mjcf").text, model).rollout(model, model.rest(), waves(2, 100, 1e3))
    assert np.max(np.abs(tape.q)) < 1.0


def test_heavy_dampers_on_light_joints_are_taken_implicitly() -> None:
    """RK4 would need 200 steps in one of the robot's."""
    arm = make(PLANAR, {name: {**RIGID[name], "motor_damping": 3e3, "motor_inertia": 0.0} for name in RIGID})
    arm = arm.extended([effect("torque_delay", "knee", delay=4e-3)])
    model = FlexibleJointModel(arm)
    assert stepping(model) == ("implicitfast", 1e-3)
    text = exported(arm, "mjcf").text
    assert 'delay="0.004"' in text
    torque = 100.0 * waves(2, 200, 1e3)
    got = MujocoRun(text, model).rollout(model, model.rest(), torque)
    expected = rollout(model, model.rest(), torque, RunOptions(engine="pin"))
    # it creeps by 0.03 rad; a step of 1 ms is some percent of its 0.2 s
    ours = expected.q[expected.first :]
    assert got.q[got.first :] == pytest.approx(ours, abs=1e-3) and np.ptp(ours) > 1e-2


def test_a_joint_called_as_a_rotor_is_refused() -> None:
    model = sliding()
    model.names[2] = "rotor.slide"
    with pytest.raises(RobotError, match=r"joint rotor\.slide has the name of a hinge that the file needs"):
        exported(Robot.from_model(model, stiffness=500.0, motor_inertia=0.2), "mjcf")


def test_without_mujoco_nothing_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = make(PLANAR)
    monkeypatch.setattr("flexjoint.export.mujoco_run.available", lambda: False)
    with pytest.raises(MissingExtraError, match=r"pip install 'flexjoint\[mujoco\]'"):
        MujocoRun(exported(arm, "mjcf").text, FlexibleJointModel(arm))


def test_stiff_effects_are_resolved() -> None:
    arm = make(PLANAR).extended([effect("end_stop", "knee", position=0.1, stiffness=1e6)])
    assert stepping(FlexibleJointModel(arm))[1] < 2e-4
    arm = make(PLANAR).extended([effect("dahl_friction", "knee", level=5.0, scale=1e-5)])
    assert stepping(FlexibleJointModel(arm))[1] < 5e-4


def test_joints_of_more_than_one_axis() -> None:
    model = pin.Model()
    inertia = pin.Inertia(1.0, np.array([0.0, 0.0, -0.2]), np.eye(3) * 0.01)
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, inertia, pin.SE3.Identity())
    turn = model.addJoint(ball, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(turn, inertia, pin.SE3.Identity())
    arm = Robot.from_model(model, joints=["turn"], motor_inertia=0.1)
    engine = mujoco.MjModel.from_xml_string(exported(arm, "mjcf").text)
    assert (engine.nq, engine.nv) == (5, 4)
    with pytest.raises(ModelError, match="single-axis joints only"):
        MujocoRun(exported(arm, "mjcf").text, FlexibleJointModel(arm))
    for target in ("urdf", "sdf", "drake"):
        with pytest.raises(RobotError, match=r"joint ball is a ball, .* in the robot\s+file"):
            exported(arm, target)
    planar = pin.Model()
    place = planar.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "table")
    planar.appendBodyToJoint(place, inertia, pin.SE3.Identity())
    turn = planar.addJoint(place, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    planar.appendBodyToJoint(turn, inertia, pin.SE3.Identity())
    arm = Robot.from_model(planar, joints=["turn"], motor_inertia=0.1)
    with pytest.raises(RobotError, match="joint table is a Planar, which is not exported"):
        exported(arm, "mjcf")
