"""Drake reads what was exported for it as the same machine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.robots.arms import PLANAR, SPATIAL, make, waves

from flexjoint.effects import effect
from flexjoint.export.targets import export_robot
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Robot, load, shipped_robots
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout

pytest.importorskip("pydrake")
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

RIGID = {"stiffness": math.inf, "damping": 0.0}


def spatial() -> Robot:
    """A passive joint, a payload, a tilt, a spring, friction, and gears."""
    arm = make(SPATIAL, {"roll": None, "yaw": {"gear_ratio": 100.0}})
    return arm.extended(
        [
            effect("payload", "pitch", mass=0.7, position=(0.1, -0.05, 0.2)),
            effect("base_tilt", roll=0.3, pitch=-0.4),
            effect("link_viscous_friction", "pitch", coefficient=2.0),
            effect("motor_viscous_friction", "yaw", coefficient=-1.0),
            effect("motor_inertia", "yaw", scale=0.3),
            effect("cable_spring", "pitch", stiffness=3.0, rest=0.4),
        ]
    )


def read(path: Path) -> Any:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant


@pytest.mark.parametrize("target", ["drake", "sdf"])
@pytest.mark.parametrize("name", ["spatial", *(n for n in shipped_robots() if n != "centauro")])
def test_drake_reads_the_same_machine(name: str, target: str, tmp_path: Path) -> None:
    arm = spatial() if name == "spatial" else load(name)
    out = tmp_path / ("arm.urdf" if target == "drake" else "arm.sdf")
    export_robot(arm, target, out)
    plant, model = read(out), FlexibleJointModel(arm)
    joints = [plant.GetJointByName(str(joint)) for joint in arm.model.names[1:]]
    rows = [joint.velocity_start() for joint in joints]
    context, q = plant.CreateDefaultContext(), np.random.default_rng(3).uniform(-1.0, 1.0, arm.model.nq)
    places = np.zeros(plant.num_positions())
    places[[joint.position_start() for joint in joints]] = q
    plant.SetPositions(context, places)
    expected, damping = np.array(model.body.mass_matrix(q)), np.zeros(arm.model.nv)
    viscous = {e.joint: e.p.coefficient for e in arm.effects if e.effect.name == "link_viscous_friction"}
    for flow in model.flows:
        place = flow.joint.idx_v
        damping[place] = flow.drive.D_m + viscous.get(flow.joint.name, 0.0)
        if target == "drake":  # SDF has no armature
            expected[place, place] += flow.drive.B
    mass = plant.CalcMassMatrix(context)[np.ix_(rows, rows)]
    assert mass == pytest.approx(expected, abs=1e-9 * float(np.max(np.abs(expected))))
    gravity = model.body.gravity_torque(q)
    got = -plant.CalcGravityGeneralizedForces(context)[rows]
    assert got == pytest.approx(gravity, abs=1e-9 * float(np.max(np.abs(gravity))))
    assert [joint.default_damping() for joint in joints] == pytest.approx(damping)
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        limit = arm.joint(actuator.joint().name()).torque_limit if target == "drake" else math.inf
        assert limit == math.inf or actuator.effort_limit() == pytest.approx(limit)


def test_drake_moves_as_we_do(tmp_path: Path) -> None:
    """A rigid arm with its rotors' inertia and viscous friction under held torques."""
    from pydrake.systems.analysis import Simulator

    arm = make(PLANAR, {"hip": RIGID, "knee": RIGID}, rates={"physics": 100.0, "control": 100.0})
    arm = arm.extended(
        [
            effect("payload", "knee", mass=0.5, position=(0.1, 0.0, -0.1)),
            effect("link_viscous_friction", "knee", coefficient=1.0),
        ]
    )
    export_robot(arm, "drake", tmp_path / "arm.urdf")
    plant = read(tmp_path / "arm.urdf")
    context = plant.CreateDefaultContext()
    port = plant.get_actuation_input_port()
    torque = waves(2, 50, 100.0, 8.0)
    port.FixValue(context, torque[0])
    simulator = Simulator(plant, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    for k, row in enumerate(torque):
        port.FixValue(context, row)
        simulator.AdvanceTo((k + 1) / 100.0)
    model = FlexibleJointModel(arm)
    fine = np.repeat(torque, 80, axis=0)
    ours = rollout(model, model.rest(), fine, RunOptions(rate=8000.0, engine="pin"))
    # ours is of order 2: some 1e-8 of 0.1 rad at 8 kHz
    assert plant.GetPositions(context) == pytest.approx(ours.q[-1], abs=1e-6)
