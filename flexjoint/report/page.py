"""The page: all sections in order, through the templates beside this file."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined

from flexjoint.report.material import Material
from flexjoint.report.sections import (
    agreement,
    causes,
    compared,
    footer,
    limits,
    ranking,
    residuals,
    torques,
    trace,
    verdict,
)


def html(material: Material) -> str:
    """One self-contained HTML document. Every text is escaped by the templates."""
    environment = Environment(
        loader=PackageLoader("flexjoint.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(
        verdict=verdict.build(material),
        causes=causes.build(material),
        torques=torques.build(material),
        agreement=agreement.build(material),
        compared=compared.build(material),
        residuals=residuals.build(material),
        ranking=ranking.build(material),
        limits=limits.build(material),
        trace=trace.build(material),
        footer=footer.build(material),
    )
