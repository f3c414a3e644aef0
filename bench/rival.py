"""The same robot in MuJoCo: each flexible joint doubled, a rotor hinge with armature tied to the link by a
tendon that is the spring."""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
from mujoco import rollout

from flexjoint.robot.robot import Robot

INTEGRATORS = ("Euler", "implicitfast", "implicit", "RK4", "discrete")  # the last from MuJoCo 3.13 on
SPECK = 1e-9  # mass [kg] and inertia [kg m^2] of a rotor's body beside its armature: MuJoCo wants some


def mjcf(robot: Robot, integrator: str, rate: float) -> str:
    """MJCF of a robot on a fixed base whose joints are all revolute and flexible. Joints keep their names,
    rotors are called rotor.NAME; actuators drive rotors."""
    model = robot.model
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false", boundmass="0")
    gravity = " ".join(map(repr, robot.gravity.tolist()))
    option = ElementTree.SubElement(
        root, "option", timestep=repr(1.0 / rate), integrator=integrator, gravity=gravity
    )
    ElementTree.SubElement(option, "flag", contact="disable", constraint="disable")
    world = ElementTree.SubElement(root, "worldbody")
    bodies = {0: world}
    for k in range(1, model.njoints):
        placement, inertia, name = model.jointPlacements[k], model.inertias[k], str(model.names[k])
        body = ElementTree.SubElement(bodies[model.parents[k]], "body", name=f"link.{name}")
        body.set("pos", _text(placement.translation))
        body.set("quat", _text(np.roll(pin.Quaternion(placement.rotation).coeffs(), 1)))
        ElementTree.SubElement(body, "joint", name=name, type="hinge", axis=_text(_axis(model, k)))
        principal, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] *= np.linalg.det(axes)
        turn = np.roll(pin.Quaternion(axes).coeffs(), 1)
        inertial = ElementTree.SubElement(body, "inertial", pos=_text(inertia.lever), quat=_text(turn))
        inertial.set("mass", repr(max(inertia.mass, SPECK)))
        inertial.set("diaginertia", _text(np.maximum(principal, SPECK)))
        bodies[k] = body
    tendons, actuators = ElementTree.SubElement(root, "tendon"), ElementTree.SubElement(root, "actuator")
    for joint in robot.joints:
        rotor = ElementTree.SubElement(world, "body", name=f"rotor.{joint.name}")
        speck = _text(np.full(3, SPECK))
        ElementTree.SubElement(rotor, "inertial", pos="0 0 0", mass=repr(SPECK), diaginertia=speck)
        ElementTree.SubElement(
            rotor,
            "joint",
            name=f"rotor.{joint.name}",
            type="hinge",
            axis="0 0 1",
            armature=repr(joint.drive.B),
            damping=repr(joint.drive.D_m),
        )
        spring = ElementTree.SubElement(
            tendons,
            "fixed",
            name=joint.name,
            stiffness=repr(joint.drive.K),
            damping=repr(joint.drive.D),
            springlength="0",
        )
        ElementTree.SubElement(spring, "joint", joint=f"rotor.{joint.name}", coef="1")
        ElementTree.SubElement(spring, "joint", joint=joint.name, coef="-1")
        ElementTree.SubElement(actuators, "general", name=joint.name, joint=f"rotor.{joint.name}")
    return ElementTree.tostring(root, encoding="unicode")


class Rival:
    """A robot in MuJoCo, driven by held motor torques or by its own PD actuators."""

    def __init__(self, robot: Robot, integrator: str, rate: float) -> None:
        self.robot = robot
        self.model = mujoco.MjModel.from_xml_string(mjcf(robot, integrator, rate))
        self.data = mujoco.MjData(self.model)
        places = self.model.jnt_qposadr
        names = robot.joint_names
        self.link = np.array([places[self.model.joint(name).id] for name in names])
        self.rotor = np.array([places[self.model.joint(f"rotor.{name}").id] for name in names])

    def start(self, q: np.ndarray, v: np.ndarray) -> None:
        """At rest in the springs: theta = q, dtheta = dq; both (n,) in the robot's order of joints."""
        mujoco.mj_resetData(self.model, self.data)
        for place in (self.link, self.rotor):
            self.data.qpos[place], self.data.qvel[place] = q, v
        mujoco.mj_forward(self.model, self.data)

    def use_own_controller(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """PD on the rotors inside MuJoCo's step: ctrl is theta_ref; no Python in the loop."""
        self.model.actuator_gainprm[:, 0] = kp
        self.model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
        self.model.actuator_biasprm[:, 1], self.model.actuator_biasprm[:, 2] = -kp, -kd

    def run(self, steps: int) -> None:
        mujoco.mj_step(self.model, self.data, steps)

    def batch(self, count: int, ctrl: np.ndarray, threads: int) -> Callable[[], object]:
        """So many rollouts from the present state by MuJoCo's own `rollout`, all under ctrl (steps, n)."""
        what = mujoco.mjtState.mjSTATE_FULLPHYSICS
        size = mujoco.mj_stateSize(self.model, what)
        start = np.empty(size)
        mujoco.mj_getState(self.model, self.data, start, what)
        starts, controls = np.tile(start, (count, 1)), ctrl[np.newaxis]
        data = [mujoco.MjData(self.model) for _ in range(threads)]
        states = np.empty((count, len(ctrl), size))

        def run() -> None:
            rollout.rollout(self.model, data, starts, controls, state=states, persistent_pool=True)

        return run


def _axis(model: pin.Model, k: int) -> np.ndarray:
    data = model.joints[k].createData()
    model.joints[k].calc(data, pin.neutral(model))
    return np.asarray(data.S).reshape(6)[3:]


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)
