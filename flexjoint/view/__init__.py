"""See robots move, in MeshCat: a page that opens offline, in a notebook, or as pictures.

from flexjoint import load_robot, read_recording, view

robot = load_robot("centauro")
view.show(view.posed(robot, "spider")).write_html("spider.html")
view.show([view.from_recording(robot, read_recording("run.parquet"))], rate=30)
"""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.view.geometry import Kind
from flexjoint.view.layers import Colouring, Looks, build
from flexjoint.view.motion import Contacts, Motion, from_recording, from_simulation, posed, still
from flexjoint.view.page import Page

__all__ = [
    "Contacts",
    "Motion",
    "Page",
    "from_recording",
    "from_simulation",
    "posed",
    "show",
    "still",
]


def show(
    motions: Motion | Sequence[Motion],
    rate: float = 25.0,
    colour: Colouring = "deflection",
    exaggerate: float | None = None,
    geometry: Kind = "visual",
    triangles: int = 100_000,
    title: str = "",
) -> Page:
    """Motions side by side, on one clock.

    Args:
        rate: frames per second; fewer where they would be more than 1500 or the page heavier than 8 MB.
        colour: springs by `deflection` theta - q or `torque` tau_t.
        exaggerate: factor on the deflections that the motor side is drawn with; default: 1, 2 or 5 times a
            power of ten, so that one sees them. The page states it.
        geometry: `visual`, `collision` or `sticks`.
        triangles: of all meshes of a robot; more are simplified.

    Raises FlexJointError on what cannot be shown.
    """
    given = [motions] if isinstance(motions, Motion) else list(motions)
    return Page(build(given, Looks(rate, colour, exaggerate, geometry, triangles, title)))
