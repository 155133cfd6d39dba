"""Sphinx's settings. `make docs` builds the site; pages that nobody writes come from scripts/docs_site."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

project = "radwrap"
version = release = version_of("radwrap")
copyright = ""  # LICENSE says whose it is
html_show_copyright = False

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "docs_site.mathml", "docs_site.extension"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
smartquotes = False  # options begin with two hyphens
html_theme = "furo"
html_title = "radwrap"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # it is fetched, which browsers refuse to pages that were opened as files
html_show_sourcelink = False
html_math_renderer = "mathml"
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_typehints = "none"  # the docstrings name types with shapes and units
autodoc_member_order = "bysource"
