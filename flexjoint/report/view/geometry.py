"""A robot's bodies as triangle meshes: visual or collision geometry of its description, else sticks."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import coal
import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError, RobotWarning
from flexjoint.core.files import read_text
from flexjoint.core.limits import DESCRIPTION
from flexjoint.core.messages import shown
from flexjoint.core.running import native_output
from flexjoint.report.view import meshes
from flexjoint.report.view.mesh_files import triangles_in
from flexjoint.report.view.meshes import Mesh
from flexjoint.robot.description import Description, leaves_package
from flexjoint.robot.robot import Robot

Kind = Literal["visual", "collision", "sticks"]
STICK = (0.55, 0.58, 0.62)
JOINT = (0.25, 0.27, 0.3)


@dataclass(frozen=True, eq=False)
class Shape:
    """One piece of a robot: on the joint of that index (0: fixed to the base), its mesh placed by the (4, 4)
    matrix, which may mirror and scale it. Shapes may share a mesh."""

    joint: int
    placement: np.ndarray
    mesh: Mesh
    colour: tuple[float, float, float]


def shapes(robot: Robot, kind: Kind = "visual", triangles: int = 100_000) -> tuple[Shape, ...]:
    """What a robot looks like.

    Args:
        kind: geometry of the description; a robot without any is drawn as sticks between its joints.
        triangles: of all meshes, one that is used several times counted once; more are simplified.

    Raises RobotError where a mesh cannot be read.
    """
    found = () if kind == "sticks" else _described(robot, kind)
    return _simplified(found, triangles) if found else _sticks(robot)


def _described(robot: Robot, kind: Kind) -> tuple[Shape, ...]:
    description = robot.description
    if description is None:
        return ()
    wanted = pin.VISUAL if kind == "visual" else pin.COLLISION
    folders = [str(folder) for folder in (*description.package_dirs, description.path.parent)]
    _check_meshes(description, folders)
    try:
        with native_output.held() as said:
            if description.kind == "urdf":
                loader = coal.CachedMeshLoader()
                built = pin.buildGeomFromUrdfString(
                    robot.model, description.text, wanted, None, folders, loader
                )
            elif description.kind == "mjcf":
                built = pin.buildGeomFromMJCF(robot.model, str(description.path), wanted)
            else:
                return ()
    except (ValueError, RuntimeError, LookupError) as error:
        raise RobotError(
            f"{robot.name}: a mesh of {description.path} cannot be read: {native_output.message(error)}; add"
            " its folder to package_dirs, or view the robot as sticks"
        ) from None
    for line in native_output.errors(said)[:1]:
        warnings.warn(f"{robot.name}: not all of its geometry is shown: {line}", RobotWarning, stacklevel=2)
    known: dict[str, Mesh] = {}
    out = []
    for item in built.geometryObjects:
        mesh, scale = _mesh(item, known)
        if mesh is not None:
            if not np.all(np.isfinite(mesh.vertices)):
                raise RobotError(
                    f"{robot.name}: mesh {shown(item.meshPath, 160)} holds numbers that are not finite"
                )
            placement = item.placement.homogeneous @ np.diag([*scale, 1.0])
            colour = tuple(float(c) for c in item.meshColor[:3])
            out.append(Shape(int(item.parentJoint), placement, mesh, colour))  # type: ignore[arg-type]
    return tuple(out)


def _check_meshes(description: Description, folders: Sequence[str]) -> None:
    """A page may be shared: nothing enters it from outside of a package that the description names. Memory
    and time grow with a mesh's file: its size is seen before it is read."""
    text = description.text or read_text(description.path, DESCRIPTION.file_bytes)
    within = re.search(r"""meshdir\s*=\s*["']([^"']*)""", text)  # of an MJCF
    places = [*folders, *([os.path.join(description.path.parent, within[1])] if within else [])]
    for name in dict.fromkeys(re.findall(r"""\bfile(?:name)?\s*=\s*["']([^"']*)""", text)):
        if name.startswith("package://") and leaves_package(name):
            raise RobotError(
                f"{description.path}: mesh {shown(name, 100)} leaves its package; name a place below it"
            )
        for place in places:
            path = Path(place, name.removeprefix("package://").removeprefix("file://"))
            if os.path.isfile(path):
                _check_size(path, f"{description.path}: mesh {shown(name, 100)}")


def _check_size(path: Path, what: str) -> None:
    most = ""
    if path.stat().st_size > DESCRIPTION.mesh_bytes:
        most = f"{DESCRIPTION.mesh_bytes} bytes"
    elif triangles_in(path, DESCRIPTION.mesh_triangles) > DESCRIPTION.mesh_triangles:
        most = f"{DESCRIPTION.mesh_triangles} triangles"
    if most:
        raise RobotError(
            f"{what} has more than {most}, the most that is read (docs/reference/limits.md); make it coarser,"
            " or view the robot as sticks"
        )


def _mesh(item: Any, known: dict[str, Mesh]) -> tuple[Mesh | None, Sequence[float]]:
    """A geometry object's mesh, from `known` where the same file was read before, and its scale."""
    body = item.geometry
    if isinstance(body, coal.BVHModelBase):
        scale = np.array(item.meshScale)
        if not np.all(np.abs(scale) > 0.0):
            return None, scale.tolist()
        if item.meshPath not in known:
            corners = np.array([(t[0], t[1], t[2]) for t in map(body.tri_indices, range(body.num_tris))])
            known[item.meshPath] = Mesh(np.array(body.vertices()) / scale, corners.reshape(-1, 3))
        return known[item.meshPath], scale.tolist()
    for kind, make in _PRIMITIVES.items():
        if isinstance(body, kind):
            return make(body), (1.0, 1.0, 1.0)
    return None, (1.0, 1.0, 1.0)  # planes and the like are not part of a robot's looks


_PRIMITIVES: Mapping[type, Callable[[Any], Mesh]] = {
    coal.Box: lambda b: meshes.box(2.0 * np.array(b.halfSide)),
    coal.Sphere: lambda b: meshes.sphere(b.radius),
    coal.Capsule: lambda b: meshes.sphere(b.radius, 2.0 * b.halfLength),
    coal.Cylinder: lambda b: meshes.cylinder(b.radius, 2.0 * b.halfLength),
    coal.Cone: lambda b: meshes.cone(b.radius, 2.0 * b.halfLength),
    coal.Ellipsoid: lambda b: Mesh(
        meshes.sphere(1.0).vertices * np.array(b.radii), meshes.sphere(1.0).triangles
    ),
}


def _simplified(found: Sequence[Shape], triangles: int) -> tuple[Shape, ...]:
    """Large meshes made coarser, the largest first, until all together have at most so many triangles."""
    unique = {id(shape.mesh): shape.mesh for shape in found}
    sizes = sorted(len(mesh.triangles) for mesh in unique.values())
    left, most = triangles, float("inf")
    for k, size in enumerate(sizes):
        share = left / (len(sizes) - k)
        if size > share:
            most = share
            break
        left -= size
    if most == float("inf"):
        return tuple(found)
    coarse = {key: meshes.simplified(mesh, int(most)) for key, mesh in unique.items()}
    return tuple(replace(shape, mesh=coarse[id(shape.mesh)]) for shape in found)


# --- a robot without geometry ----------------------------------------------------------------------------
def _sticks(robot: Robot) -> tuple[Shape, ...]:
    """A ball at each joint, a stick to each joint that it carries, and to the last link's centre of mass."""
    model = robot.model
    lengths = [np.linalg.norm(model.jointPlacements[k].translation) for k in range(1, model.njoints)]
    size = 0.06 * max([float(np.median(lengths)) if lengths else 0.0, 0.02])
    ball = meshes.sphere(1.4 * size)
    out = []
    for k in range(1, model.njoints):
        out.append(Shape(k, np.eye(4), ball, JOINT))
        out += _stick(model.parents[k], model.jointPlacements[k].translation, size)
        if not list(model.children[k]):
            out += _stick(k, 2.0 * np.array(model.inertias[k].lever), size)
    return tuple(out)


def _stick(joint: int, end: np.ndarray, radius: float) -> list[Shape]:
    length = float(np.linalg.norm(end))
    if length < 1e-6:
        return []
    placement = np.eye(4)
    placement[:3, :3] = along(end / length)
    placement[:3, 3] = 0.5 * end
    return [Shape(int(joint), placement, meshes.cylinder(radius, length), STICK)]


def along(direction: np.ndarray) -> np.ndarray:
    """(3, 3) a rotation that turns z into the unit vector `direction`."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(direction, x), direction])
