"""Triangle meshes of the viewer: simple bodies, arrows and springs, and coarser copies of large meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FINEST, COARSEST = 400, 6  # cells along a mesh's longest side when it is simplified


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices (V, 3) [m] and triangles (T, 3), indices of vertices."""

    vertices: np.ndarray
    triangles: np.ndarray

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Mesh:
        return Mesh(self.vertices @ rotation.T + translation, self.triangles)


def joined(*meshes: Mesh) -> Mesh:
    """The meshes as one."""
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, counts[:-1], strict=True)]),
    )


def simplified(mesh: Mesh, most: int) -> Mesh:
    """A mesh of at most `most` triangles (or the coarsest that this method makes): vertices that share a cell
    of a grid become their mean, triangles that collapse go (Rossignac and Borrel 1993)."""
    if len(mesh.triangles) <= most:
        return mesh
    low, high = COARSEST, FINEST
    best = _clustered(mesh, low)
    while high - low > 1:
        cells = (low + high) // 2
        tried = _clustered(mesh, cells)
        if len(tried.triangles) <= most:
            low, best = cells, tried
        else:
            high = cells
    return best


def _clustered(mesh: Mesh, cells: int) -> Mesh:
    start = mesh.vertices.min(axis=0)
    side = max(float(np.max(mesh.vertices.max(axis=0) - start)), 1e-9) / cells
    place = np.floor((mesh.vertices - start) / side).astype(np.int64)
    key = (place[:, 0] * (cells + 2) + place[:, 1]) * (cells + 2) + place[:, 2]
    _, group = np.unique(key, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, weights=mesh.vertices[:, k]) / count for k in range(3)], axis=1)
    triangles = group[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    triangles = triangles[_first_of_each(np.sort(triangles, axis=1), len(count))]
    used, triangles = np.unique(triangles, return_inverse=True)
    return Mesh(mean[used], triangles.reshape(-1, 3))


def _first_of_each(rows: np.ndarray, below: int) -> np.ndarray:
    """Places, in order, of the first of each different row (N, 3) of numbers from 0 on, and `below` a bound.
    As whole numbers rows are sorted twenty times faster than as rows; two after the other, which do not
    overflow."""
    _, pair = np.unique(rows[:, 0] * below + rows[:, 1], return_inverse=True)
    _, first = np.unique(pair.reshape(-1) * below + rows[:, 2], return_index=True)
    return np.sort(first)


# --- simple bodies -----------------------------------------------------------------------------------------
def box(sides: np.ndarray) -> Mesh:
    """A box of the given sides (3,) [m] about the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    # every face has its own corners, so that its edges stay sharp
    flat = np.array(triangles).reshape(-1)
    return Mesh(corners[flat] * np.asarray(sides), np.arange(len(flat)).reshape(-1, 3))


def lathe(profile: np.ndarray, around: int = 28) -> Mesh:
    """The body that a profile (P, 2) of radius and height [m] sweeps about the z axis."""
    angle = 2.0 * np.pi * np.arange(around) / around
    radius, height = np.asarray(profile, dtype=float).T
    vertices = np.stack(
        [
            radius[:, None] * np.cos(angle),
            radius[:, None] * np.sin(angle),
            np.repeat(height[:, None], around, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    triangles = []
    for p in range(len(radius) - 1):
        for k in range(around):
            a, b = p * around + k, p * around + (k + 1) % around
            triangles += [(a, b, a + around), (b, b + around, a + around)]
    return Mesh(vertices, np.array(triangles))


def cylinder(radius: float, length: float) -> Mesh:
    """A cylinder along z about the origin."""
    h = 0.5 * length
    return lathe(np.array([[0, -h], [radius, -h], [radius, -h], [radius, h], [radius, h], [0, h]]))


def cone(radius: float, length: float) -> Mesh:
    """A cone along z about the middle of its height, tip up."""
    h = 0.5 * length
    return lathe(np.array([[0, -h], [radius, -h], [radius, -h], [0, h]]))


def sphere(radius: float, length: float = 0.0) -> Mesh:
    """A sphere about the origin, or a capsule along z with a cylinder of that length between its halves."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    height = radius * np.sin(angle) + np.where(angle < 0.0, -0.5 * length, 0.5 * length)
    if length > 0.0:
        angle = np.insert(angle, 6, -1e-9)
        height = np.insert(height, 6, -0.5 * length)
    return lathe(np.column_stack([radius * np.cos(angle), height]))


def arrow() -> Mesh:
    """An arrow of length 1 along z from the origin, its shaft 0.056 thick where it is not scaled."""
    shaft = [
        [0, 0],
        [0.028, 0],
        [0.028, 0],
        [0.028, 0.78],
        [0.028, 0.78],
        [0.085, 0.78],
        [0.085, 0.78],
        [0, 1],
    ]
    return lathe(np.array(shaft), 18)


def coil(turns: float = 3.0, radius: float = 1.0, wire: float = 0.16, length: float = 1.2) -> Mesh:
    """A helical spring about z, radius 1 where it is not scaled."""
    along, around = int(20 * turns) + 1, 7
    t = np.linspace(0.0, 2.0 * np.pi * turns, along)
    pitch = length / (2.0 * np.pi * turns)
    centre = np.column_stack([radius * np.cos(t), radius * np.sin(t), pitch * t - 0.5 * length])
    out = np.column_stack([np.cos(t), np.sin(t), np.zeros_like(t)])
    tangent = np.column_stack([-radius * np.sin(t), radius * np.cos(t), np.full_like(t, pitch)])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, out)
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = out[:, None] * np.cos(angle)[:, None] + side[:, None] * np.sin(angle)[:, None]
    vertices = (centre[:, None] + wire * ring).reshape(-1, 3)
    triangles = []
    for p in range(along - 1):
        for k in range(around):
            a, b = p * around + k, p * around + (k + 1) % around
            triangles += [(a, b, a + around), (b, b + around, a + around)]
    return Mesh(vertices, np.array(triangles))
