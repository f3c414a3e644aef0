"""What an experiment shows, as tables in a terminal and as one page with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from flexjoint.cli.paper.grid import Grid
from flexjoint.report.page import script

if TYPE_CHECKING:
    from flexjoint.report.plots import Image

SOURCE = (
    "Kameduła, Kashiri, Caldwell, Tsagarakis 2016: A compliant actuation dynamics Gazebo-ROS plugin (ICINCO)"
)


@dataclass(frozen=True)
class Section:
    """A part of a page: texts, a legend of (measured, before or after; name), pairs of pictures, tables."""

    title: str
    texts: Sequence[str] = ()
    legend: Sequence[tuple[str, str]] = ()
    pictures: Sequence[Sequence[Image]] = ()
    grids: Sequence[Grid] = ()


@dataclass(frozen=True)
class Page:
    """One experiment."""

    title: str
    lead: Sequence[str]
    sections: Sequence[Section]
    source: str = field(default=SOURCE)

    def html(self) -> str:
        """One self-contained HTML document in the style of a diagnosis' report."""
        environment = Environment(
            loader=ChoiceLoader(
                [
                    PackageLoader("flexjoint.cli.paper", "templates"),
                    PackageLoader("flexjoint.report", "templates"),
                ]
            ),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        return environment.get_template("paper.html").render(page=self, script=script())
