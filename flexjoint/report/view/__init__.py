"""See robots move, in MeshCat: a page that opens offline, in a notebook, or as pictures.

import flexjoint as fj
from flexjoint.report import view

robot = fj.load_robot("centauro")
fj.view(robot, view.posed(robot, "spider")).write_html("spider.html")
fj.view(robot, fj.read_recording("run.parquet"), rate=30)
"""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as tables
from flexjoint.recording.table import Recording
from flexjoint.report.view.geometry import Kind
from flexjoint.report.view.layers import Colouring, Looks, build
from flexjoint.report.view.motion import (
    Contacts,
    Motion,
    from_recording,
    from_simulation,
    posed,
    still,
)
from flexjoint.report.view.page import Page
from flexjoint.robot.robot import Robot, expect
from flexjoint.simulation.simulate import Simulation

__all__ = [
    "Contacts",
    "Motion",
    "Page",
    "from_recording",
    "from_simulation",
    "posed",
    "show",
    "still",
    "view",
]


def view(
    robot: Robot | FlexibleJointModel,
    data: Recording | Simulation | Motion | Sequence[Recording | Simulation | Motion] | None = None,
    *,
    rate: float = 25.0,
    colour: Colouring = "deflection",
    exaggerate: float | None = None,
    geometry: Kind = "visual",
    triangles: int = 100_000,
    title: str = "",
) -> Page:
    """A robot in its initial pose, or recordings and simulations of it side by side; arguments as of `show`.

    A notebook shows the page by itself; `write_html`, `write_images` and `write_video` keep it.

    Raises FlexJointError on what cannot be shown.
    """
    shown = robot.robot if isinstance(robot, FlexibleJointModel) else expect(robot, "view")
    if data is None:
        motions = [posed(shown, "initial")]
    else:
        given = data if isinstance(data, Sequence) and not isinstance(data, str) else [data]
        motions = [_motion(shown, item) for item in given]
    return show(motions, rate, colour, exaggerate, geometry, triangles, title)


def _motion(robot: Robot, item: object) -> Motion:
    if isinstance(item, Motion):
        return item
    if isinstance(item, Simulation):
        return from_simulation(robot, item)
    return from_recording(robot, tables.expect(item, "view"))


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
