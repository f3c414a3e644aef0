"""Sphinx's settings for the site; build.py lays its sources together: `make site`."""

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

project = "flexjoint"
author = copyright = "The flexjoint developers"  # Sphinx's name for it
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "flexjoint"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_extra"]
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_block"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the tests run them
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
default_role = "literal"  # docstrings write `name` for code
napoleon_google_docstring = True
napoleon_numpy_docstring = False
suppress_warnings = [
    "myst.header",  # a page may begin below its title
    "mystnb.unknown_mime_type",
    "misc.highlighting_failure",  # shells' and tables' blocks are highlighted where that is possible
]
exclude_patterns = ["_extra"]


# --- formulas: MathML, which browsers draw by themselves, so that a page needs nothing from elsewhere ------
def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _display(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
