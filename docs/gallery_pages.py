"""The gallery of the guide: an index with a picture of every example, and a page for each, with its code as script and notebook.

No example runs: pictures, models, times and measures are what `benchmarks/gallery.py` has kept in docs/gallery.
"""

from __future__ import annotations

import ast
import csv
import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
GALLERY = ROOT / "docs" / "gallery"
MODELS = GALLERY / "models"

GROUPS: dict[str, dict[str, str]] = {
    "Parts": {
        "build123d_bracket": "A bracket in build123d",
        "build123d_panel": "A sandwich panel in build123d",
        "cadquery_bracket": "A bracket in CadQuery",
        "cadquery_panel": "A sandwich panel in CadQuery",
        "trimmed": "A block with bores",
        "octet_truss": "Struts with nodes",
        "voronoi_foam": "An open-cell foam",
        "periodic_foam": "A foam that repeats",
        "closed_ring": "A closed ring",
    },
    "Implants and scans": {
        "spinal_cage": "A spinal cage of given pores",
        "implant": "An implant graded by CT",
        "scan": "A scan filled",
        "segmentation": "A segmented bone",
        "bone": "A bone scaffold of four structures",
        "tooth": "A porous tooth",
    },
    "Heat exchangers": {
        "heat_exchanger": "An exchanger of hundreds of cells",
        "exchanger_openings": "Cross flow without baffles",
        "counter_flow_exchanger": "Counter flow with manifolds",
        "nozzle": "The wall of a rocket nozzle",
    },
    "Large lattices, printing, studies": {
        "layers": "20,000 cells as layers",
        "sweep": "Stiffness against porosity",
        "mesh_gmsh": "Meshes for simulation",
        "solidify_dask": "Fits on a cluster",
    },
    "Graded and blended fields": {
        "solidify_graded": "A wall that thickens",
        "cell_size_grading": "Cells that shrink",
        "solidify_blend": "A diamond that turns into an I-WP",
        "blend_scaffold": "Scaffolds of four structures",
        "blend_round_regions": "Blends across round borders",
        "blend_free_regions": "Blends across borders of any shape",
        "persistence_diagrams": "Persistence of a blend",
        "beam_plate": "Topology optimisation with two lattices",
        "beam": "An optimised beam as a solid",
    },
}
"""Every example with its title, in the order of the gallery."""

SHARED = {
    "blend_slices": "Pictures of the blends",
    "cell_phases": "Cells of varying size",
    "voxel_beam": "Elasticity on voxels",
}
"""Modules that examples import."""

VIEW = """<figure class="part-view" data-model="{name}"><img src="../../_static/{picture}" alt="{title}">
<figcaption>Drag to turn, click and scroll to zoom, shift and drag to move; a coarse mesh of the solid.</figcaption></figure>
<script src="../../_static/viewer.js"></script><script src="../../_static/models/{name}.js"></script>"""


def make_gallery() -> dict[str, str]:
    """The index, and a page and a notebook for each example, by name."""
    made = {"examples.md": describe_gallery()}
    for name, title in list_examples().items():
        text = (EXAMPLES / f"{name}.py").read_text()
        made[f"examples/{name}.md"] = describe_example(name, title, text)
        made[f"notebooks/{name}.ipynb"] = json.dumps(make_notebook(name, text), indent=1) + "\n"
    return made


def list_examples() -> dict[str, str]:
    """All examples, and the modules that they share, with their titles."""
    return {name: title for group in (*GROUPS.values(), SHARED) for name, title in group.items()}


def describe_gallery() -> str:
    """The index: cards with pictures, in groups."""
    lines = [
        "# Examples",
        "",
        "Scripts to start from. Each page shows what a script makes, to be turned, its time, its code, and the script and a "
        "notebook to download. The tests run all of them, at the sizes that are their defaults.",
        "",
    ]
    for group, examples in GROUPS.items():
        lines += [f"## {group}", "", "::::{grid} 2 2 3 4", ":gutter: 3", ":class-container: gallery", ""]
        for name, title in examples.items():
            picture = find_pictures(name)[:1]
            lines += [":::{grid-item-card} " + title, *(f":img-top: ../gallery/{path.name}" for path in picture)]
            lines += [f":img-alt: {title}"] * len(picture)
            lines += [f":link: examples/{name}", ":link-type: doc", ":::", ""]
        lines += ["::::", ""]
    lines += ["## Recipes", "", "Blends and fields as TOML files for `tpmscad blend` and `tpmscad solidify`:", ""]
    lines += [f"- {{download}}`{path.name} <../../examples/{path.name}>`" for path in sorted(EXAMPLES.glob("*.toml"))]
    lines += [
        "",
        "```{toctree}",
        ":hidden:",
        ":maxdepth: 1",
        "",
        *(f"examples/{name}" for name in list_examples()),
        "```",
        "",
    ]
    return "\n".join(lines)


def describe_example(name: str, title: str, text: str) -> str:
    """The page of an example."""
    page = [f"# {title}", "", *format_docstring(ast.get_docstring(ast.parse(text)) or ""), ""]
    pictures = find_pictures(name)
    if (MODELS / f"{name}.js").exists():
        page += ["```{raw} html", VIEW.format(name=name, picture=pictures[0].name, title=title), "```", ""]
        pictures = pictures[1:]
    page += [f"![{title}](../../gallery/{path.name})\n" for path in pictures]
    page += [*describe_run(name), *describe_solids(name)]
    needed = [f"{{download}}`{file} <../../../examples/{file}>`" for file in list_needed_files(text)]
    page += [f"It needs {' and '.join(needed)} beside it.", ""] if needed else []
    page += [
        f"{{download}}`{name}.py <../../../examples/{name}.py>` {{download}}`{name}.ipynb <../notebooks/{name}.ipynb>`",
        "",
        f"```{{literalinclude}} ../../../examples/{name}.py",
        ":language: python",
        "```",
        "",
    ]
    return "\n".join(page)


def format_docstring(text: str) -> list[str]:
    """The paragraphs of a docstring; those that are indented are commands."""
    lines = []
    for block in text.split("\n\n"):
        indented = all(line.startswith("    ") for line in block.splitlines())
        lines += (
            ["```sh", *(line[4:] for line in block.splitlines()), "```"]
            if indented
            else [block.rstrip(":") + "."[: block.endswith(":")]]
        )
        lines.append("")
    return lines


def find_pictures(example: str) -> list[Path]:
    """The kept pictures of an example, that of its own name first."""
    found = [path for path in GALLERY.glob("*.png") if path.stem == example or path.stem.startswith(f"{example}-")]
    return sorted(found, key=lambda path: path.stem)


def read_rows(table: str, example: str) -> list[dict[str, str]]:
    """The rows of an example in a table of the gallery."""
    with (GALLERY / table).open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["example"] == example]


def describe_run(name: str) -> list[str]:
    """What the run took of which pictures and measures are shown."""
    lines = []
    for row in read_rows("runs.csv", name):
        call = f"`{row['call']}`" if row["call"] else "The script as it is"
        memory = f" and {row['gib']} GiB of memory" if row["gib"] else ""
        lines += [f"{call} took {row['cpu_seconds']} s of CPU time{memory}.", ""]
    return lines


def describe_solids(name: str) -> list[str]:
    """A table of the solids of an example."""
    rows = read_rows("measures.csv", name)
    if not rows:
        return []
    head = ["solid", "faces", "STEP, MB", "deviation, mm", "pieces, tunnels, cavities"]
    names = ["solid", "faces", "megabytes", "deviation_mm", "betti"]
    cells = [[row[name].replace("_", " ") for name in names] for row in rows]
    return [*("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *cells)), ""]


def list_needed_files(text: str) -> list[str]:
    """Files beside an example that it imports or reads."""
    tree = ast.parse(text)
    modules = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    needed = sorted(f"{module}.py" for module in modules if module and (EXAMPLES / f"{module}.py").exists())
    return needed + sorted(set(re.findall(r'with_name\("([^"]+)"\)', text)))


def make_notebook(name: str, text: str) -> dict[str, Any]:
    """The script as a notebook: its docstring, its imports and constants, its functions, and its main program."""
    tree = ast.parse(text)
    cells = [make_cell("markdown", "\n".join(format_docstring(ast.get_docstring(tree) or "")))]
    if "__file__" in text:
        cells.append(make_cell("code", f'__file__ = "{name}.py"  # files are looked for beside the notebook'))
    cells += [make_cell("code", source) for source in split_cells(text, tree)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    for number, cell in enumerate(cells):
        cell["id"] = f"{name}-{number}".replace("_", "-")
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def make_cell(kind: str, source: str) -> dict[str, Any]:
    """A cell of a notebook."""
    outputs = {"execution_count": None, "outputs": []} if kind == "code" else {}
    return {"cell_type": kind, "metadata": {}, "source": source.strip("\n").splitlines(keepends=True), **outputs}


def split_cells(text: str, tree: ast.Module) -> list[str]:
    """The code of a script without its docstring, cut before functions and classes, and the main program, dedented."""
    lines = text.splitlines()
    cells, begun = [], tree.body[0].end_lineno or 0
    for node in tree.body[1:]:
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))]) - 1
        main = isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
        if isinstance(node, ast.FunctionDef | ast.ClassDef) or main:
            cells.append("\n".join(lines[begun:first]))
            begun = first
        if main:
            body = [line[4:] for line in lines[node.lineno : node.end_lineno]]
            cells.append("\n".join(body))
            begun = node.end_lineno or begun
    cells.append("\n".join(lines[begun:]))
    return [cell for cell in cells if cell.strip()]
