"""Motions -> a scene: robot, motor side, springs, contact forces, centre of mass and support polygon."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import FlexJointError
from flexjoint.report.view import meshes, motion
from flexjoint.report.view.geometry import Kind, Shape, along, shapes
from flexjoint.report.view.meshes import Mesh
from flexjoint.report.view.motion import Motion
from flexjoint.report.view.scene import Actor, Colour, Layer, Legend, Node, Part, Scene
from flexjoint.robot.robot import Robot

MOTOR: Colour = (1.0, 0.42, 0.05)
FORCE: Colour = (0.85, 0.1, 0.12)
MASS: Colour = (0.1, 0.35, 0.85)
SUPPORT: Colour = (0.1, 0.62, 0.35)
HIDDEN = 1e-6  # scale of what is not there at a frame
VISIBLE_TURN = 0.15  # rad to which the largest deflection is exaggerated by default
LEAST_FORCE = 1.0  # N at which a contact counts as one
NEAR_GROUND = 0.01  # m at which a contact frame counts as standing, where no forces are known
MOST_FRAMES = 1500
MOST_BYTES = 5_000_000  # of all frames: with meshes and MeshCat itself a page stays below 8 MB
LEAST_TRIANGLES = 1000

Colouring = Literal["deflection", "torque"]


@dataclass(frozen=True)
class Looks:
    """How motions are drawn.

    `rate` frames per second; `colour` of the springs by deflection theta - q or torque tau_t; `exaggerate` is
    the factor on the deflections that the motor side is drawn with (None: until one sees it); `geometry`
    visual, collision or sticks, of at most so many `triangles`.
    """

    rate: float = 25.0
    colour: Colouring = "deflection"
    exaggerate: float | None = None
    geometry: Kind = "visual"
    triangles: int = 100_000
    title: str = ""


def build(motions: Sequence[Motion], looks: Looks) -> Scene:
    """The scene of motions side by side; raises FlexJointError on what cannot be shown."""
    motion.check(motions)
    for name, word, known in (
        ("colour", looks.colour, get_args(Colouring)),
        ("geometry", looks.geometry, get_args(Kind)),
    ):
        if word not in known:
            raise FlexJointError(f"{name}: expected {' or '.join(known)}, got {word!r}")
    if looks.triangles < LEAST_TRIANGLES:
        raise FlexJointError(f"triangles: expected at least {LEAST_TRIANGLES}, got {looks.triangles}")
    for name, value in (("rate", looks.rate), ("exaggerate", looks.exaggerate)):
        if value is not None and not 0.0 < value < np.inf:
            raise FlexJointError(f"{name}: expected a number above 0, got {value}")
    times = _times(motions, looks.rate)
    motions = [motion.with_torque(item.at(times)) for item in motions]
    factor = _exaggeration(motions) if looks.exaggerate is None else looks.exaggerate
    legend = _legend(motions, looks.colour)
    robots = {id(item.robot): item.robot for item in motions}  # one that is shown several times is read once
    bodies = {key: shapes(robot, looks.geometry, looks.triangles) for key, robot in robots.items()}
    drawn = [_Drawn(item, bodies[id(item.robot)]) for item in motions]
    places = _places(drawn)
    nodes: list[Node] = []
    notes: list[str] = []
    strongest = max((d.strongest for d in drawn), default=0.0)
    for k, item in enumerate(drawn):
        nodes += item.robot_nodes(k)
        nodes += item.motor_nodes(k, factor)
        nodes += item.spring_nodes(k, looks.colour, legend)
        nodes += item.force_nodes(k, strongest)
        nodes += item.balance_nodes(k)
    present = {node.layer for node in nodes}
    if "motor" in present and factor != 1.0:
        notes.append(f"motor side: deflections drawn {factor:g} times as large")
    if strongest > 0.0:
        notes.append(f"longest arrow: {strongest:.3g} N")
    layers = [layer for layer in _layers(motions, factor, looks.colour) if layer.name in present]
    actors = [
        Actor(
            item.motion.label,
            (0.0, float(y), 0.0),
            (float(item.middle[0]), float(item.middle[1] + y), float(item.high[2]) + 0.06 * item.size),
        )
        for item, y in zip(drawn, places, strict=True)
    ]
    extent = np.concatenate([d.outline + np.array([0.0, y, 0.0]) for d, y in zip(drawn, places, strict=True)])
    ground = 0.0 if any(m.robot.floating for m in motions) else min(0.0, float(extent[:, 2].min()))
    return Scene(
        looks.title or ", ".join(dict.fromkeys(m.robot.name for m in motions)),
        times,
        tuple(actors),
        tuple(layers),
        tuple(nodes),
        extent,
        ground,
        legend if "springs" in present else None,
        tuple(notes),
        (1.0, -1.25, 0.55) if len(motions) == 1 else (1.0, -0.45, 0.35),
    )


def _times(motions: Sequence[Motion], rate: float) -> np.ndarray:
    """Frames from the earliest start to the latest end; fewer per second where they would be too many, or too
    heavy to send."""
    start = min(float(m.time[0]) for m in motions)
    length = max(float(m.time[-1]) for m in motions) - start
    # 7 numbers of 4 bytes a joint, twice with a motor side
    heavy = sum(28 * m.robot.model.njoints * (1 if m.theta is None else 2) for m in motions)
    most = max(min(MOST_FRAMES, int(MOST_BYTES / heavy)), 2)
    count = int(np.floor(length * rate + 1e-9)) + 1
    return start + (np.arange(count) / rate if count <= most else np.linspace(0.0, length, most))


def _exaggeration(motions: Sequence[Motion]) -> float:
    """1, 2 or 5 times a power of ten, such that the largest deflection becomes visible; at least 1."""
    largest = max((float(np.max(np.abs(m.theta - m.links), initial=0.0)) for m in motions if m.theta is not None), default=0.0)  # fmt: skip # noqa: E501
    wanted = VISIBLE_TURN / largest if largest > 0.0 else 1.0
    if wanted < 2.0 or largest < 1e-9:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1.0 + 1e-12)))


def _values(item: Motion, colour: Colouring) -> np.ndarray | None:
    """(N, n) what colours the springs."""
    if colour == "torque":
        return item.tau_t
    return None if item.theta is None else item.theta - item.links


def _legend(motions: Sequence[Motion], colour: Colouring) -> Legend | None:
    known = [v for v in (_values(item, colour) for item in motions) if v is not None]
    largest = max((float(np.nanmax(np.abs(v), initial=0.0)) for v in known), default=0.0)
    if not known:
        return None
    if colour == "torque":
        return Legend("spring torque", "N m", largest or 1.0)
    return Legend("spring deflection", "mrad", 1e3 * largest or 1.0)


def _layers(motions: Sequence[Motion], factor: float, colour: Colouring) -> list[Layer]:
    times = f" (deflection ×{factor:g})" if factor != 1.0 else ""
    floating = any(m.robot.floating or m.contacts for m in motions)
    return [
        Layer("robot", "robot, at q"),
        Layer("motor", f"motor side, at theta{times}", _css(MOTOR)),
        Layer("springs", f"springs, by {colour}"),
        Layer("forces", "contact forces", _css(FORCE)),
        Layer("mass", "centre of mass", _css(MASS), floating),
        Layer("support", "support polygon", _css(SUPPORT)),
    ]


def _css(colour: Colour) -> str:
    return "rgb({:.0f}, {:.0f}, {:.0f})".format(*(255 * c for c in colour))


def _places(drawn: Sequence[_Drawn]) -> list[float]:
    """Where the robots stand along y, none in another's way."""
    places = [0.0]
    for before, after in itertools.pairwise(drawn):
        gap = 0.4 * max(before.size, after.size)
        places.append(places[-1] + float(before.high[1] - after.low[1]) + gap)
    return places


class _Drawn:
    """One motion on its way into the scene."""

    def __init__(self, item: Motion, bodies: Sequence[Shape]) -> None:
        self.motion, self.bodies, self.robot = item, bodies, item.robot
        self.frames = placements(item.robot, item.q)
        self.outline = _outline(bodies, self.frames)
        self.low, self.high = self.outline.min(axis=0), self.outline.max(axis=0)
        self.middle = 0.5 * (self.low + self.high)
        self.size = float(np.max(self.high - self.low))
        forces = None if item.contacts is None else np.nan_to_num(item.contacts.forces)
        self.strongest = 0.0 if forces is None else float(np.max(np.linalg.norm(forces, axis=2), initial=0.0))

    def robot_nodes(self, actor: int) -> list[Node]:
        return _bodies("q", actor, "robot", self.bodies, self.frames)

    def motor_nodes(self, actor: int, factor: float) -> list[Node]:
        """A translucent copy at theta."""
        if self.motion.theta is None:
            return []
        q = self.motion.q.copy()
        for k, joint in enumerate(self.robot.joints):
            q[:, joint.idx_q] += factor * (self.motion.theta[:, k] - q[:, joint.idx_q])
        moving = [shape for shape in self.bodies if shape.joint > 0]
        return _bodies("theta", actor, "motor", moving, placements(self.robot, q), MOTOR)

    def spring_nodes(self, actor: int, colour: Colouring, legend: Legend | None) -> list[Node]:
        values = _values(self.motion, colour)
        if values is None or legend is None:
            return []
        scale = 1e3 if colour == "deflection" else 1.0
        out, size = [], 0.023 * self.size
        for k, joint in enumerate(self.robot.joints):
            if joint.rigid:
                continue
            placement = np.eye(4)
            placement[:3, :3] = along(_axis(self.robot, joint.pin_id)) * size
            part = Part(_COIL, placement, (0.8, 0.8, 0.8), 1.0, True)
            poses = self.frames[joint.pin_id]
            out.append(
                Node(f"spring/{joint.name}", actor, "springs", (part,), poses, None, scale * values[:, k])
            )
        return out

    def force_nodes(self, actor: int, strongest: float) -> list[Node]:
        contacts = self.motion.contacts
        if contacts is None or strongest <= 0.0:
            return []
        out = []
        length = 0.35 * self.size
        for c in range(contacts.points.shape[1]):
            force = np.nan_to_num(contacts.forces[:, c])
            size = np.linalg.norm(force, axis=1)
            poses, scales = np.zeros((len(force), 7)), np.full((len(force), 3), HIDDEN)
            poses[:, 6] = 1.0
            for k in np.flatnonzero(size > 1e-9):
                poses[k] = [*contacts.points[k, c], *_quaternion(along(force[k] / size[k]))]
                scales[k] = [length, length, length * size[k] / strongest]
            # drawn over the robot: what it pushes on hides where it acts
            part = Part(_ARROW, np.eye(4), FORCE, 1.0, True)
            out.append(Node(f"force/{c}", actor, "forces", (part,), poses, scales))
        return out

    def balance_nodes(self, actor: int) -> list[Node]:
        """Centre of mass with its plumb line, and the hull of the standing contacts on the ground."""
        model, data = self.robot.model, self.robot.model.createData()
        if model.nv == 0 or pin.computeTotalMass(model) <= 0.0:
            return []
        centre = np.array([pin.centerOfMass(model, data, row) for row in self.motion.q])
        ground = 0.0 if self.robot.floating else min(0.0, float(self.low[2]))
        poses = np.zeros((len(centre), 7))
        poses[:, :3], poses[:, 6] = centre, 1.0
        foot = poses.copy()
        foot[:, 2] = ground + 0.002
        lengths = np.ones((len(centre), 3))
        lengths[:, 2] = np.maximum(centre[:, 2] - ground, HIDDEN)
        size = 0.022 * self.size
        ball = Part(meshes.sphere(size), np.eye(4), MASS, 1.0, True)
        dot = Part(meshes.cylinder(size, 0.002), np.eye(4), MASS)
        line = _placed(meshes.cylinder(0.15 * size, 1.0), np.array([0.0, 0.0, 0.5]))
        out = [
            Node("mass/ball", actor, "mass", (ball,), poses),
            Node("mass/foot", actor, "mass", (dot,), foot),
            Node("mass/line", actor, "mass", (Part(line, np.eye(4), MASS, 1.0, True),), foot, lengths),
        ]
        return out + self._support_nodes(actor)

    def _support_nodes(self, actor: int) -> list[Node]:
        item = self.motion
        if item.contacts is not None:
            points = item.contacts.points
            stands = np.linalg.norm(np.nan_to_num(item.contacts.forces), axis=2) > LEAST_FORCE
        elif self.robot.floating and motion.contact_frames(self.robot):
            points = motion.contact_points(self.robot, item.q)
            stands = points[:, :, 2] < NEAR_GROUND
        else:
            return []
        hulls = [_hull(points[k][stands[k]][:, :2]) for k in range(len(points))]
        sides = max((len(hull) for hull in hulls), default=0)
        poses, scales = np.zeros((sides, len(points), 7)), np.full((sides, len(points), 3), HIDDEN)
        poses[:, :, 6] = 1.0
        for k, hull in enumerate(hulls):
            for side in range(len(hull) if len(hull) > 1 else 0):
                start, end = hull[side], hull[(side + 1) % len(hull)]
                length = float(np.linalg.norm(end - start))
                turn = along(np.array([*(end - start), 0.0]) / length)
                poses[side, k] = [*start, 0.004, *_quaternion(turn)]
                scales[side, k] = [1.0, 1.0, length]
        edge = _placed(meshes.cylinder(0.006 * self.size, 1.0), np.array([0.0, 0.0, 0.5]))
        return [
            Node(
                f"support/{side}",
                actor,
                "support",
                (Part(edge, np.eye(4), SUPPORT),),
                poses[side],
                scales[side],
            )
            for side in range(sides)
        ]


# --- geometry -----------------------------------------------------------------------------------------------
_COIL, _ARROW = meshes.coil(), meshes.arrow()


def placements(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(njoints, N, 7) position and quaternion x y z w of every joint frame at q (N, nq)."""
    model, data = robot.model, robot.model.createData()
    out = np.zeros((model.njoints, len(q), 7))
    out[:, :, 6] = 1.0
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for joint in range(1, model.njoints):
            out[joint, k] = pin.SE3ToXYZQUAT(data.oMi[joint])
    return out


def _bodies(
    name: str,
    actor: int,
    layer: str,
    bodies: Sequence[Shape],
    frames: np.ndarray,
    ghost: Colour | None = None,
) -> list[Node]:
    parts: dict[int, list[Part]] = {}
    for shape in bodies:
        part = Part(shape.mesh, shape.placement, shape.colour)
        if ghost is not None:
            part = replace(part, colour=ghost, opacity=0.35)
        parts.setdefault(shape.joint, []).append(part)
    return [Node(f"{name}/{joint}", actor, layer, tuple(own), frames[joint]) for joint, own in parts.items()]


def _outline(bodies: Sequence[Shape], frames: np.ndarray) -> np.ndarray:
    """(P, 3) the outermost corners [m] of the bodies' boxes over up to 20 of the frames."""
    corners = [np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])] if not bodies else []
    rows = np.unique(np.linspace(0, frames.shape[1] - 1, 20).astype(int))
    for shape in bodies:
        ends = shape.mesh.vertices.min(axis=0), shape.mesh.vertices.max(axis=0)
        box = np.array([[ends[i][0], ends[j][1], ends[k][2], 1.0] for i, j, k in np.ndindex(2, 2, 2)])
        local = (box @ shape.placement.T)[:, :3]
        for row in rows:
            place = pin.XYZQUATToSE3(frames[shape.joint, row])
            corners.append(local @ place.rotation.T + place.translation)
    flat = np.concatenate(corners)
    directions = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
    return flat[np.unique(np.argmax(flat @ directions.T, axis=0))]


def _axis(robot: Robot, joint: int) -> np.ndarray:
    """(3,) a joint's axis in its own frame; of a sliding one, its direction."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    # of a model with one degree of freedom it is a vector
    jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
    column = jacobian[:, model.joints[joint].idx_v]
    axis = column[3:] if np.linalg.norm(column[3:]) > 1e-9 else column[:3]
    return axis / np.linalg.norm(axis)


def _quaternion(rotation: np.ndarray) -> list[float]:
    return list(pin.Quaternion(rotation).coeffs())


def _placed(mesh: Mesh, by: np.ndarray) -> Mesh:
    return mesh.moved(np.eye(3), by)


def _hull(points: np.ndarray) -> np.ndarray:
    """(h, 2) convex hull of points (c, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(map(tuple, points[np.all(np.isfinite(points), axis=1)]))
    if len(ordered) < 2:
        return np.array(ordered).reshape(-1, 2)

    def half(items: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        out: list[tuple[float, ...]] = []
        for x, y in items:
            while len(out) > 1 and (out[-1][0] - out[-2][0]) * (y - out[-2][1]) <= (
                out[-1][1] - out[-2][1]
            ) * (x - out[-2][0]):
                out.pop()
            out.append((x, y))
        return out[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))
