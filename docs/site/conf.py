"""Sphinx's settings for the site; build.py lays its sources together: `make site`."""

project = "flexjoint"
author = copyright = "The flexjoint developers"  # Sphinx's name for it
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
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
