"""Settings of the guide: `pip install -e '.[docs]' && sphinx-build -W docs site` builds it into the folder `site`.

Pages of reference, of examples and pictures are generated from the code before each build (docs/generated_pages.py) into
docs/_generated, which is not kept.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import generated_pages
import reference_pages

import tpmscad

sys.modules["cadquery"] = reference_pages.stand_in_for_cadquery()

project = "tpmscad"
author = copyright = "the authors of tpmscad"
release = version = tpmscad.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence", "deflist"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "site"]
html_theme = "furo"
html_title = f"tpmscad {version}"
HOME = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"]["hooks"][
    "custom"
]["home"]
if HOME:  # of the published repository, once; pages then link to their sources there
    html_theme_options = {"source_repository": HOME, "source_branch": "main", "source_directory": "docs/"}
html_copy_source = False  # pages that are generated have no source that is worth reading
html_static_path = ["static", "gallery"]  # the view in 3-D, and what it shows
html_css_files = ["guide.css"]
myst_heading_anchors = 3
numpydoc_show_class_members = False  # each public class lists its own members
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of parameters state types in words
numpydoc_xref_param_type = True
numpydoc_xref_aliases = reference_pages.ALIASES
numpydoc_xref_ignore = "all"
intersphinx_mapping = {name: (url, f"_generated/{name}.inv") for name, (url, _) in reference_pages.LINKED.items()}
suppress_warnings = ["myst.xref_missing", "config.cache"]  # documents in docs/ also link to files that are no pages


def setup(app: Any) -> None:
    """Generate pages before the pages are read; those have no link to a source."""
    generated_pages.write_all(Path(__file__).parent / "_generated")
    app.connect("html-page-context", leave_out_source)


def leave_out_source(_app: Any, name: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """A generated page is not in the repository."""
    if name.startswith("_generated/"):
        context["page_source_suffix"] = ""
