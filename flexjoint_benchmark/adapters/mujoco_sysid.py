"""`mujoco.sysid`: every joint as two hinges on one axis, motor and spring, fitted over windows.

Open are K, D, B, D_m and a dry friction of every joint. It names what moves by more than twice its tolerance,
or friction above a twentieth of the torque, and by more than three standard errors. A machine of which a
position or a torque is not recorded gets no names.
"""

from __future__ import annotations

import contextlib
import io
import logging
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from mujoco import sysid

from flexjoint_benchmark.adapters.joints import USUAL_TOLERANCE, Machine, answered, finding

# mujoco hides that its own dependencies are missing, and leaves the module empty
if not hasattr(sysid, "TimeSeries"):
    raise ImportError("mujoco.sysid is not installed; run: pip install 'flexjoint[benchmark]'")

CUTOFF = 80.0  # Hz: above the springs' resonances, so that what is fitted is what was measured
STEP_RATE = 1000.0  # Hz, at which RK4 follows the springs
WINDOW = 0.3  # s, before an open loop has drifted far from where it started
WINDOWS = 24
ITERATIONS = 15
MOVED, SURE, SHARE = 2.0, 3.0, 0.05  # as in least_squares.py
FACTOR = 5.0  # bounds: a fifth to five times the nominal number
FACTOR_OF_MASS = 1.3
MASS = "mass"


def find(machine: Machine, folder: Path) -> list[dict[str, Any]]:
    joints = machine.joints
    if len(joints) < len(machine.robot.joints) or any(
        j.phi is None and np.isfinite(j.stiffness) for j in joints
    ):
        return []
    spec = _model(folder, machine)
    model = spec.compile()
    sequences = _sequences(machine, spec, model)
    parameters = _parameters(machine, spec)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with contextlib.redirect_stdout(io.StringIO()):  # its progress
        fitted, result = sysid.optimize(parameters, residual, max_iters=ITERATIONS, verbose=False)
    residuals = residual(result.x, fitted)[0]
    covariance, _ = sysid.calculate_intervals(residuals, result.jac)
    # an open loop's error is one over its whole window, and no noise that its samples would average away
    errors = np.sqrt(np.abs(np.diag(covariance)) * WINDOW * machine.rate * _finer(machine))
    return _named(machine, fitted, errors)


def _model(folder: Path, machine: Machine) -> mujoco.MjSpec:
    data = yaml.safe_load((folder / "robot.yaml").read_text())
    spec = mujoco.MjSpec.from_file(str(folder / data["urdf"]))
    spec.option.timestep = 1.0 / (machine.rate * _finer(machine))
    spec.option.gravity = machine.robot.gravity
    # of order 4: the implicit integrators damp a spring by K h/2, more than its own damper does
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for joint in machine.joints:
        link = spec.joint(joint.name)
        body, axis, place = link.parent, np.array(link.axis), np.array(link.pos)
        link.armature, link.frictionloss = joint.inertia, 0.0
        _set(link, "damping", joint.damping)
        spec.add_actuator(name=f"motor {joint.name}", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spec.add_sensor(
            name=f"theta {joint.name}", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name,
        )  # fmt: skip
        if joint.phi is not None:  # the second hinge turns by q - theta
            spring = body.add_joint(
                name=f"spring {joint.name}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, pos=place
            )
            _set(spring, "stiffness", joint.stiffness)
            _set(spring, "damping", joint.spring_damping)
            spec.add_sensor(
                name=f"bend {joint.name}", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=f"spring {joint.name}",
            )  # fmt: skip
    return spec


def _finer(machine: Machine) -> int:
    """Steps of the simulation in one of the recording."""
    return max(1, round(STEP_RATE / machine.rate))


def _set(joint: mujoco.MjsJoint, field: str, value: float) -> None:
    """Stiffness and damping are polynomials in some versions: their first coefficient is the linear one."""
    now = getattr(joint, field)
    setattr(joint, field, value if np.ndim(now) == 0 else [value, *np.zeros(len(now) - 1)])


def _sequences(machine: Machine, spec: mujoco.MjSpec, model: mujoco.MjModel) -> sysid.ModelSequences:
    joints, rate, steps = machine.joints, machine.rate, _finer(machine)
    size, length = joints[0].theta.size, round(WINDOW * rate)
    starts = np.linspace(0, size - length - 1, WINDOWS).astype(int)
    controls, seen, states = [], [], []
    names = [s.name for s in spec.sensors]
    bends = {j.name: -j.phi for j in joints if j.phi is not None}
    turns = {j.name: -j.dphi for j in joints if j.dphi is not None}
    for start in starts:
        part = slice(start, start + length)
        times, finer = np.arange(length) / rate, np.arange((length - 1) * steps + 1) / (rate * steps)
        step = 1.0 / (rate * steps)  # over which MuJoCo holds a command
        torque = np.stack([np.interp(finer + 0.5 * step, times, j.tau_m[part]) for j in joints], axis=1)
        columns = {f"theta {j.name}": j.theta[part] for j in joints}
        columns |= {f"bend {name}": bend[part] for name, bend in bends.items()}
        # its rollout reads sensors where a step begins, and sysid takes them for where it ends
        data = np.stack([np.interp(finer - step, times, columns[name]) for name in names], axis=1)
        controls.append(sysid.TimeSeries.from_control_names(finer, torque, model))
        seen.append(sysid.TimeSeries.from_names(finer, data, model))
        position, velocity = np.zeros(model.nq), np.zeros(model.nv)
        for joint in joints:
            at = model.joint(joint.name)
            position[at.qposadr[0]], velocity[at.dofadr[0]] = joint.theta[start], joint.dtheta[start]
            if joint.name in bends:
                at = model.joint(f"spring {joint.name}")
                position[at.qposadr[0]], velocity[at.dofadr[0]] = (
                    bends[joint.name][start],
                    turns[joint.name][start],
                )
        states.append(sysid.create_initial_state(model, position, velocity))
    return sysid.ModelSequences("robot", spec, [f"at {s}" for s in starts], states, controls, seen)


def _parameters(machine: Machine, spec: mujoco.MjSpec) -> sysid.ParameterDict:
    out = sysid.ParameterDict()

    def add(name: str, nominal: float, low: float, high: float, joint: str, field: str) -> None:
        def apply(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
            _set(spec.joint(joint), field, float(parameter.value[0]))

        out.add(sysid.Parameter(name, nominal, low, high, modifier=apply))

    for joint in machine.joints:
        numbers = {"motor_inertia": (joint.inertia, joint.name, "armature")}
        if joint.damping > 0:
            numbers["motor_viscous_friction"] = (joint.damping, joint.name, "damping")
        if joint.phi is not None:
            numbers["spring_stiffness"] = (joint.stiffness, f"spring {joint.name}", "stiffness")
            if joint.spring_damping > 0:
                numbers["spring_damping"] = (joint.spring_damping, f"spring {joint.name}", "damping")
        for effect, (nominal, where, field) in numbers.items():
            add(f"{effect} {joint.name}", nominal, nominal / FACTOR, nominal * FACTOR, where, field)
        out.add(_mass(spec, joint.name))
        level = float(np.sqrt(np.mean(joint.tau_m**2)))
        add(f"motor_coulomb_friction {joint.name}", 0.02 * level, 0.0, level, joint.name, "frictionloss")
    return out


def _mass(spec: mujoco.MjSpec, joint: str) -> sysid.Parameter:
    """A factor on the mass and inertia of a joint's link, which are as uncertain as the rest: closed, they
    would be made up for by what is open."""
    link = spec.joint(joint).parent
    mass, inertia = float(link.mass), np.array(link.fullinertia)

    def apply(changed: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        body, factor = changed.joint(joint).parent, float(parameter.value[0])
        body.mass, body.fullinertia = factor * mass, factor * inertia

    return sysid.Parameter(f"{MASS} {joint}", 1.0, 1.0 / FACTOR_OF_MASS, FACTOR_OF_MASS, modifier=apply)


def _named(machine: Machine, fitted: sysid.ParameterDict, errors: np.ndarray) -> list[dict[str, Any]]:
    told = {**USUAL_TOLERANCE, **machine.tolerance}
    tolerance = {
        "motor_inertia": told["inertial"], "motor_viscous_friction": told["damping"],
        "spring_stiffness": told["stiffness"], "spring_damping": told["damping"],
    }  # fmt: skip
    by_name = {joint.name: joint for joint in machine.joints}
    out = []
    for (key, parameter), error in zip(fitted.items(), errors, strict=True):
        effect, _, name = key.partition(" ")
        if effect == MASS:
            continue
        joint, value, nominal = by_name[name], float(parameter.value[0]), float(parameter.nominal[0])
        if effect == "motor_coulomb_friction":
            least = SHARE * float(np.sqrt(np.mean(joint.tau_m**2)))
            told_name, change, std = "level", value, float(error)
        elif effect == "motor_viscous_friction":
            least, told_name, change, std = (
                MOVED * tolerance[effect] * nominal,
                "coefficient",
                value - nominal,
                float(error),
            )
        else:
            least, told_name, change, std = (
                MOVED * tolerance[effect],
                "scale",
                value / nominal - 1,
                float(error) / nominal,
            )
        if abs(change) > max(least, SURE * std):
            out.append(finding(effect, name, change, std, told_name))
    return out


if __name__ == "__main__":
    logging.disable(logging.WARNING)
    answered("mujoco.sysid", find, CUTOFF)
