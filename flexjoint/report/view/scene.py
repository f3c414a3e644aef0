"""A scene as data: nodes that move rigidly over frames, each with meshes; no viewer, no page."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexjoint.report.view.meshes import Mesh

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh on a node, placed by a (4, 4) matrix. `overlay` draws it through what is in front of it."""

    mesh: Mesh
    placement: np.ndarray
    colour: Colour
    opacity: float = 1.0
    overlay: bool = False


@dataclass(frozen=True, eq=False)
class Node:
    """Something that moves: poses (N, 7) position and quaternion x y z w, in its actor's frame; scales (N, 3)
    or None; values (N,) that colour it by the legend's scale, or None. N is 1 for what stands still."""

    name: str
    actor: int
    layer: str
    parts: tuple[Part, ...]
    poses: np.ndarray
    scales: np.ndarray | None = None
    values: np.ndarray | None = None


@dataclass(frozen=True)
class Actor:
    """One robot of a side-by-side view: where it stands and where its label hangs, in the world [m]."""

    label: str
    place: tuple[float, float, float]
    label_at: tuple[float, float, float]


@dataclass(frozen=True)
class Layer:
    """What the reader can switch on and off together."""

    name: str
    label: str
    colour: str = ""
    visible: bool = True


@dataclass(frozen=True)
class Legend:
    """What the colours of the springs mean: from -limit to +limit."""

    label: str
    unit: str
    limit: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that is shown: nodes over the frames' times (N,) [s]; `extent` (P, 3) [m] are its outermost
    points, `direction` leads from it to the camera."""

    title: str
    times: np.ndarray
    actors: tuple[Actor, ...]
    layers: tuple[Layer, ...]
    nodes: tuple[Node, ...]
    extent: np.ndarray
    ground: float = 0.0
    legend: Legend | None = None
    notes: tuple[str, ...] = field(default=())
    direction: tuple[float, float, float] = (1.0, -1.25, 0.55)


def packed(scene: Scene) -> str:
    """The scene as base64 of gzip: a length, a JSON header, then the numbers that it points into."""
    store = _Store()
    meshes: dict[int, int] = {}
    described: list[dict[str, Any]] = []
    for node in scene.nodes:
        for part in node.parts:
            if id(part.mesh) not in meshes:
                meshes[id(part.mesh)] = len(described)
                short = len(part.mesh.vertices) < 2**16
                described.append(
                    {
                        "vertices": store.add(part.mesh.vertices, "<f4"),
                        "triangles": store.add(part.mesh.triangles, "<u2" if short else "<u4"),
                    }
                )
    header = {
        "title": scene.title,
        "times": store.add(scene.times, "<f4"),
        "actors": [vars(actor) for actor in scene.actors],
        "layers": [vars(layer) for layer in scene.layers],
        "meshes": described,
        "nodes": [_node(node, meshes, store) for node in scene.nodes],
        "extent": np.round(scene.extent, 4).tolist(),
        "ground": float(scene.ground),
        "legend": vars(scene.legend) if scene.legend else None,
        "notes": list(scene.notes),
        "direction": list(scene.direction),
    }
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 4)  # the numbers begin on a multiple of their size
    whole = len(text).to_bytes(4, "little") + text + b"".join(store.parts)
    return base64.b64encode(gzip.compress(whole, 9, mtime=0)).decode("ascii")


def _node(node: Node, meshes: dict[int, int], store: _Store) -> dict[str, Any]:
    return {
        "name": node.name,
        "actor": node.actor,
        "layer": node.layer,
        "parts": [
            {
                "mesh": meshes[id(part.mesh)],
                "matrix": [round(float(x), 9) for x in np.asarray(part.placement).T.reshape(-1)],
                "colour": list(part.colour),
                "opacity": part.opacity,
                "overlay": part.overlay,
            }
            for part in node.parts
        ],
        "poses": store.track(node.poses),
        "scales": None if node.scales is None else store.track(node.scales),
        "values": None if node.values is None else store.track(node.values),
    }


class _Store:
    """Numbers one after the other; a place is (type, offset in bytes, count, rows)."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.length = 0
        self._known: dict[tuple[tuple[int, ...], bytes], list[Any]] = {}

    def add(self, values: np.ndarray | Sequence[float], kind: str) -> list[Any]:
        array = np.ascontiguousarray(values, dtype=np.dtype(kind))
        place = [kind[1:], self.length, int(array.size), len(array)]
        raw = array.tobytes()
        raw += b"\0" * (-len(raw) % 4)
        self.parts.append(raw)
        self.length += len(raw)
        return place

    def track(self, values: np.ndarray) -> list[Any]:
        """One row where nothing moves; what was stored before is pointed at. Rounded to 16 bits of mantissa,
        0.03 mm at 2 m, which halves what is left of it when packed."""
        rows = values[:1] if np.all(values == values[:1]) else values
        short = np.ascontiguousarray(rows, dtype="<f4").view("<u4") + np.uint32(0x80)
        rounded = (short & np.uint32(0xFFFFFF00)).view("<f4")
        key = (rounded.shape, rounded.tobytes())
        if key not in self._known:
            self._known[key] = self.add(rounded, "<f4")
        return self._known[key]
