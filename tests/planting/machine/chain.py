"""Rigid-body dynamics of a fixed-base tree of revolute joints, written for this generator alone.

The URDF is read here (fixed joints are merged), and the equations are the classical Newton-Euler recursion in
body frames (Luh, Walker, Paul 1980) and the composite-body inertia matrix (Walker, Orin 1982), symbolically
in CasADi. Every body is described about its own joint frame by mass m, first moment h = m c and inertia I, in
which the equations are linear.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """One moving body: its revolute joint, and everything that is rigidly fixed to it."""

    joint: str
    parent: int  # index of the parent body, -1 for the base
    rotation: Array  # (3, 3) joint frame in the parent body's joint frame at q = 0
    position: Array  # (3,) [m]
    axis: Array  # (3,) unit vector in the joint frame
    mass: float  # [kg]
    com: Array  # (3,) [m] in the joint frame
    inertia: Array  # (3, 3) [kg m^2] about the centre of mass, axes of the joint frame


def read_bodies(urdf: Path, lock: tuple[str, ...] = ()) -> list[Body]:
    """The bodies of a URDF, parents first; joints in `lock` are held at zero.

    Raises ValueError on joints that are neither revolute nor fixed.
    """
    root = ET.parse(urdf).getroot()
    links = {link.get("name"): link for link in root.findall("link")}
    joints = root.findall("joint")
    children = {_attribute(joint.find("child"), "link") for joint in joints}
    bodies: list[Body] = []
    loads: list[list[tuple[float, Array, Array]]] = []

    def visit(link: str, body: int, rotation: Array, position: Array) -> None:
        if body >= 0 and (inertial := links[link].find("inertial")) is not None:
            loads[body].append(_placed(inertial, rotation, position))
        for joint in joints:
            if _attribute(joint.find("parent"), "link") != link:
                continue
            own_rotation, own_position = _origin(joint.find("origin"))
            placed = rotation @ own_rotation, position + rotation @ own_position
            child, name = _attribute(joint.find("child"), "link"), joint.get("name", "")
            if joint.get("type") == "fixed" or name in lock:
                visit(child, body, *placed)
            elif joint.get("type") in ("revolute", "continuous"):
                axis = joint.find("axis")
                direction = np.array([1.0, 0, 0]) if axis is None else _vector(axis.get("xyz", "1 0 0"))
                bodies.append(
                    Body(
                        name, body, *placed, direction / np.linalg.norm(direction), 0, np.zeros(3), np.eye(3)
                    )
                )
                loads.append([])
                visit(child, len(bodies) - 1, np.eye(3), np.zeros(3))
            else:
                raise ValueError(
                    f"joint {name}: type {joint.get('type')} cannot be planted; use revolute or fixed"
                )

    base = next(name for name in links if name is not None and name not in children)
    visit(base, -1, np.eye(3), np.zeros(3))
    return [_merged(body, parts) for body, parts in zip(bodies, loads, strict=True)]


def _attribute(element: ET.Element | None, name: str) -> str:
    value = None if element is None else element.get(name)
    if value is None:
        raise ValueError(f"the URDF lacks an attribute {name}")
    return value


def _vector(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _origin(element: ET.Element | None) -> tuple[Array, Array]:
    if element is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = _vector(element.get("rpy", "0 0 0"))
    cr, sr, cp, sp, cy, sy = (
        np.cos(roll),
        np.sin(roll),
        np.cos(pitch),
        np.sin(pitch),
        np.cos(yaw),
        np.sin(yaw),
    )
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx, _vector(element.get("xyz", "0 0 0"))


def _placed(inertial: ET.Element, rotation: Array, position: Array) -> tuple[float, Array, Array]:
    own_rotation, own_position = _origin(inertial.find("origin"))
    mass = float(_attribute(inertial.find("mass"), "value"))
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        float(_attribute(tensor, k)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    turn = rotation @ own_rotation
    about_com = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return mass, position + rotation @ own_position, about_com


def _merged(body: Body, parts: list[tuple[float, Array, Array]]) -> Body:
    mass = sum(part[0] for part in parts)
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass if mass > 0 else np.zeros(3)
    inertia = np.zeros((3, 3))
    for m, c, tensor in parts:
        r = c - com
        inertia += tensor + m * (r @ r * np.eye(3) - np.outer(r, r))
    return Body(body.joint, body.parent, body.rotation, body.position, body.axis, mass, com, inertia)


@dataclass(frozen=True)
class Load:
    """Mass [kg], first moment [kg m] and inertia [kg m^2] of a body about its joint frame."""

    mass: ca.SX
    moment: ca.SX
    inertia: ca.SX

    def __add__(self, other: Load) -> Load:
        return Load(self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia)


def body_load(body: Body) -> Load:
    """The body's own load about its joint frame (parallel-axis theorem)."""
    c = body.com
    return Load(
        ca.SX(body.mass),
        ca.SX(body.mass * c),
        ca.sparsify(ca.SX(body.inertia + body.mass * (c @ c * np.eye(3) - np.outer(c, c)))),
    )


def point_load(mass: ca.SX, position: Array) -> Load:
    """A point mass [kg] at `position` (3,) [m] in the joint frame."""
    r = np.asarray(position, dtype=float)
    return Load(mass, mass * ca.SX(r), mass * ca.SX(r @ r * np.eye(3) - np.outer(r, r)))


def _rotations(bodies: list[Body], q: ca.SX) -> list[ca.SX]:
    """Body frame in its parent's frame: R0 Rot(axis, q), Rodrigues' formula."""
    turned = []
    for i, body in enumerate(bodies):
        k = ca.sparsify(ca.skew(ca.SX(body.axis)))
        turn = ca.SX.eye(3) + ca.sin(q[i]) * k + (1 - ca.cos(q[i])) * (k @ k)
        turned.append(ca.sparsify(ca.SX(np.where(abs(body.rotation) < 1e-15, 0.0, body.rotation))) @ turn)
    return turned


def inverse_dynamics(
    bodies: list[Body], loads: list[Load], gravity: ca.SX, q: ca.SX, v: ca.SX, a: ca.SX
) -> ca.SX:
    """M(q) a + c(q, v) + g(q) (n,) [N m], Newton-Euler; gravity enters as an accelerated base."""
    turns = _rotations(bodies, q)
    omega, alpha, linear, force, moment = [], [], [], [], []
    for i, body in enumerate(bodies):
        if body.parent < 0:
            w0, dw0, a0 = ca.SX(3, 1), ca.SX(3, 1), -gravity
        else:
            w0, dw0, a0 = omega[body.parent], alpha[body.parent], linear[body.parent]
        back, p, axis = turns[i].T, ca.sparsify(ca.SX(body.position)), ca.sparsify(ca.SX(body.axis))
        w_parent = back @ w0
        w = w_parent + axis * v[i]
        dw = back @ dw0 + ca.cross(w_parent, axis * v[i]) + axis * a[i]
        acc = back @ (a0 + ca.cross(dw0, p) + ca.cross(w0, ca.cross(w0, p)))
        load = loads[i]
        omega.append(w)
        alpha.append(dw)
        linear.append(acc)
        force.append(load.mass * acc + ca.cross(dw, load.moment) + ca.cross(w, ca.cross(w, load.moment)))
        moment.append(load.inertia @ dw + ca.cross(w, load.inertia @ w) + ca.cross(load.moment, acc))
    torque = [ca.SX(0)] * len(bodies)
    for i in reversed(range(len(bodies))):
        body = bodies[i]
        torque[i] = ca.dot(ca.SX(body.axis), moment[i])
        if body.parent >= 0:
            turned = turns[i] @ force[i]
            force[body.parent] += turned
            moment[body.parent] += turns[i] @ moment[i] + ca.cross(ca.SX(body.position), turned)
    return ca.densify(ca.vertcat(*torque))


def mass_matrix(bodies: list[Body], loads: list[Load], q: ca.SX) -> ca.SX:
    """M(q) (n, n) [kg m^2] from the composite load carried by each joint."""
    turns = _rotations(bodies, q)
    carried = list(loads)
    for i in reversed(range(len(bodies))):
        if (parent := bodies[i].parent) >= 0:
            p, turn, own = ca.skew(ca.SX(bodies[i].position)), turns[i], carried[i]
            h = turn @ own.moment
            moved = turn @ own.inertia @ turn.T - p @ ca.skew(h) - ca.skew(h) @ p - own.mass * (p @ p)
            carried[parent] += Load(own.mass, h + own.mass * ca.SX(bodies[i].position), moved)
    n = len(bodies)
    matrix = ca.SX(n, n)
    for i in range(n):
        axis = ca.SX(bodies[i].axis)
        force, moment = (
            ca.cross(axis, carried[i].moment),
            carried[i].inertia @ axis,
        )  # of a unit joint acceleration
        matrix[i, i] = ca.dot(axis, moment)
        j = i
        while (parent := bodies[j].parent) >= 0:
            turned = turns[j] @ force
            moment = turns[j] @ moment + ca.cross(ca.SX(bodies[j].position), turned)
            force, j = turned, parent
            matrix[i, j] = matrix[j, i] = ca.dot(ca.SX(bodies[j].axis), moment)
    return matrix
