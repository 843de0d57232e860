"""Settings of the guide: `pip install -e '.[docs]' && sphinx-build -W docs site` builds it into the folder `site`.

Pages of reference, of examples and pictures are generated from the code before each build (docs/generated_pages.py) into
docs/_generated, which is not kept.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import generated_pages

import tpmscad

project = "tpmscad"
author = "the authors of tpmscad"
release = version = tpmscad.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence", "deflist"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "site"]
html_theme = "furo"
html_title = f"tpmscad {version}"
html_static_path = ["viewer", "gallery"]  # the view in 3-D, and what it shows
html_css_files = ["viewer.css"]
myst_heading_anchors = 3
numpydoc_show_class_members = False  # each public class lists its own members
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of parameters state types in words
suppress_warnings = ["myst.xref_missing", "config.cache"]  # documents in docs/ also link to files that are no pages


def setup(app: object) -> None:
    """Generate pages and pictures before the pages are read."""
    generated_pages.write_all(Path(__file__).parent / "_generated")
