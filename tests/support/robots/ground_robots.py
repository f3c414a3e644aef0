"""Small robots that stand on the ground, built from text."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.standing import Standing
from flexjoint.robot import schema as robot_schema
from flexjoint.robot.robot import Robot, build
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.trajectory import Trajectory
from support.robots.arms import waves

HALF = 0.2  # of the box's width and length [m]
BOX, FLYWHEEL = 7.5, 0.5  # masses [kg]
DRIVE = {
    "stiffness": 300.0,
    "damping": 0.5,
    "motor_inertia": 0.05,
    "motor_damping": 1.0,
    "kp": 40.0,
    "kd": 2.0,
}
FEET = {"stiffness": 4e4, "dissipation": 1.0, "tangential_stiffness": 4e4, "tangential_damping": 300.0}


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="ground")  # gone when the tests end


def _body(name: str, mass: float, inertia: float, com: str = "0 0 0") -> str:
    i = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>'
    )


def _joint(name: str, parent: str, child: str, xyz: str, axis: str | None = None) -> str:
    kind, line = ("fixed", "") if axis is None else ("continuous", f'<axis xyz="{axis}"/>')
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{line}</joint>'
    )


def _robot(name: str, text: str, contacts: list[dict[str, Any]], **top: Any) -> Robot:
    urdf = Path(_folder().name) / f"{name}.urdf"
    urdf.write_text(f'<robot name="{name}">{text}</robot>', encoding="utf-8")
    file = {"name": name, "urdf": str(urdf), "base": "floating", "contacts": contacts, **top}
    return build(robot_schema.parse(file, name), Path(_folder().name) / f"{name}.yaml")


def box(contacts: dict[str, Any] | None = None, **top: Any) -> Robot:
    """A box of 8 kg with a flywheel at its centre on a vertical elastic joint, on feet 0.1 m below."""
    parts = [_body("trunk", BOX, 0.1), _body("flywheel", FLYWHEEL, 0.004)]
    parts.append(_joint("spin", "trunk", "flywheel", "0 0 0", "0 0 1"))
    corners = [(HALF, HALF), (HALF, -HALF), (-HALF, HALF), (-HALF, -HALF)]
    entries = []
    for k, (x, y) in enumerate(corners):
        parts.append(f'<link name="foot_{k}"/>' + _joint(f"ankle_{k}", "trunk", f"foot_{k}", f"{x} {y} -0.1"))
        entries.append({"frame": f"foot_{k}", **FEET, **(contacts or {})})
    return _robot("box", "".join(parts), entries, **{"joints": {"spin": DRIVE}, **top})


def cart(contacts: dict[str, Any] | None = None, axis: str = "0 1 0", **top: Any) -> Robot:
    """A trunk of 6 kg on four wheels of radius 0.1 m, each on an elastic joint."""
    parts, entries, joints = [_body("trunk", 6.0, 0.1)], [], {}
    for k, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]):
        parts += [_body(f"tyre_{k}", 0.5, 0.003), f'<link name="hub_{k}"/>']
        parts.append(_joint(f"wheel_{k}", "trunk", f"tyre_{k}", f"{x} {y} -0.1", axis))
        parts.append(_joint(f"mount_{k}", "trunk", f"hub_{k}", f"{x} {y} -0.2"))
        own = {"frame": f"hub_{k}", "radius": 0.1, "rolls": f"wheel_{k}"}
        # light wheels bear no more damping at 1 kHz
        entries.append({**own, **FEET, "tangential_damping": 100.0, **(contacts or {})})
        joints[f"wheel_{k}"] = DRIVE
    return _robot("cart", "".join(parts), entries, joints=joints, **top)


def lifted(model: FlexibleJointModel, height: float) -> State:
    """The state at rest with the base's origin at this height [m]."""
    q = np.array(model.body.neutral)
    q[2] = height
    return model.rest(q)


def energy(model: FlexibleJointModel, tape: Trajectory, row: int) -> float:
    """Kinetic, of weight and of springs, those of compliant contacts included [J]."""
    assert model.ground is not None
    q, v, theta, dtheta = tape.q[row], tape.v[row], tape.theta[row], tape.dtheta[row]
    links = q[[model.joints[i].idx_q for i in model.flexible]]
    drives = [model.flows[i].drive for i in model.flexible]
    mass = model.robot.mass
    out = 0.5 * v @ model.body.mass_matrix(q) @ v + mass * 9.81 * model.body.center_of_mass(q)[2]
    out += sum(0.5 * d.K * x**2 for d, x in zip(drives, theta - links, strict=True))
    out += sum(0.5 * d.B * w**2 for d, w in zip(drives, dtheta, strict=True))
    out += sum(0.5 * model.joints[i].drive.B * v[model.joints[i].idx_v] ** 2 for i in model.rigid)
    if not model.ground.springy:
        return float(out)
    touch = model.ground.touch(model.body, q, v, tape.z[row])
    for k, item in enumerate(model.ground.contacts):
        stretch = np.array(touch.points[k][:2]) - np.array(touch.anchors[2 * k : 2 * k + 2])
        out += 0.5 * item.stiffness * min(touch.points[k][2], 0.0) ** 2
        out += 0.5 * item.tangential_stiffness * stretch @ stretch
    return float(out)


def energy_left(model: FlexibleJointModel, tape: Trajectory, every: int = 5) -> np.ndarray:
    """Energy less the work of the motors so far, in every n-th row [J]."""
    speed = tape.v[:, [joint.idx_v for joint in model.joints]].copy()
    speed[:, list(model.flexible)] = tape.dtheta
    power = np.sum(tape.tau_m[:-1] * 0.5 * (speed[1:] + speed[:-1]), axis=1)
    work = np.concatenate([[0.0], np.cumsum(power) * (tape.time[1] - tape.time[0])])
    rows = range(0, len(tape.time), every)
    return np.array([energy(model, tape, row) - work[row] for row in rows])


def growth(left: np.ndarray) -> float:
    """How far a quantity ever rises above what it was before."""
    return float(np.max(left - np.minimum.accumulate(left)))


def hold(model: FlexibleJointModel, rest: Standing, ticks: int) -> dict[str, np.ndarray]:
    """References that hold a robot at rest by g - J_c' lambda, theta_d = q_d + tau/K."""
    q = rest.state.q[[joint.idx_q for joint in model.joints]]
    theta = q + rest.tau / np.array([joint.drive.K for joint in model.joints])
    rows = {"q_ref": q, "theta_ref": theta, "dtheta_ref": 0.0 * q, "tau_ff": rest.tau}
    return {name: np.tile(row, (ticks, 1)) for name, row in rows.items()}


def driven_landing(model: FlexibleJointModel) -> Trajectory:
    """1.5 s of a cart that falls 1 cm, slides off to the side and is driven, at 1 kHz."""
    start = lifted(model, 0.21)
    start.v[:3] = [0.3, 0.4, 0.0]
    return rollout(model, start, waves(4, 1500, 1000.0, size=3.0), RunOptions(rate=1000.0))
