"""A diagnosis as one self-contained HTML page: no network, ready to print; plots zoom, tables sort.

    from flexjoint import report
    report.write(diagnosis, robot, recording, Path("report.html"), before, after)

Needs matplotlib and jinja2 (`pip install 'flexjoint[report]'`); nothing of them is imported before a page
is asked for.
"""

from __future__ import annotations

from pathlib import Path

from flexjoint.core.files import write_text
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.recording.table import Recording
from flexjoint.report.material import Comparison, Material, require
from flexjoint.robot.robot import Robot

__all__ = ["Comparison", "render", "write"]


def write(
    diagnosis: Diagnosis,
    robot: Robot,
    recording: Recording,
    out: Path,
    before: Comparison | None = None,
    after: Comparison | None = None,
) -> None:
    """Write the page to `out`, whole or not at all. The same diagnosis gives the same bytes.

    `before` and `after` are the nominal and the extended model's simulation of this recording; without
    them the page leaves the traces out. Raises MissingExtraError when matplotlib or jinja2 is absent and
    FlexJointError when `out` cannot be written.
    """
    write_text(Path(out), render(diagnosis, robot, recording, before, after))


def render(
    diagnosis: Diagnosis,
    robot: Robot,
    recording: Recording,
    before: Comparison | None = None,
    after: Comparison | None = None,
) -> str:
    """The page as a string; see `write`."""
    for package in ("matplotlib", "jinja2"):
        require(package)
    from flexjoint.report import page

    return page.html(Material(diagnosis, robot, recording, before, after))
