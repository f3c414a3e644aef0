"""The page: all sections in order, through the templates beside this file."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from flexjoint.report.material import Material
from flexjoint.report.sections import (
    agreement,
    causes,
    compared,
    footer,
    learned,
    limits,
    ranking,
    residuals,
    torques,
    trace,
    verdict,
)


@dataclass(frozen=True)
class Script:
    """The one script of a page, and the hash by which the page's security policy lets it run and no other."""

    text: Markup
    source: str


def template(name: str) -> Template:
    """One of the report's templates; it escapes every text, and an unknown name in it is an error."""
    environment = Environment(
        loader=PackageLoader("flexjoint.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def html(material: Material) -> str:
    """One self-contained HTML document. Every text is escaped by the templates."""
    return template("page.html").render(
        verdict=verdict.build(material),
        causes=causes.build(material),
        torques=torques.build(material),
        agreement=agreement.build(material),
        compared=compared.build(material),
        residuals=residuals.build(material),
        learned=learned.build(material),
        ranking=ranking.build(material),
        limits=limits.build(material),
        trace=trace.build(material),
        footer=footer.build(material),
        script=script(),
    )


def script() -> Script:
    """What enlarges plots and sorts tables."""
    text = resources.files("flexjoint.report").joinpath("templates/page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return Script(Markup(text), f"sha256-{digest}")
