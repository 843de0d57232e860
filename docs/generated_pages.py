"""Pages of the guide that are made from the code: API, keys of recipes, commands, the catalogue, examples, and all pictures."""

from __future__ import annotations

import ast
import csv
import inspect
import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import tpmscad
from tpmscad import fields
from tpmscad.recipe.key_reference import format_reference

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
MODELS = GALLERY / "models"
PICTURE_SIZE = (640, 480)

VIEWER = """<script type="module" crossorigin="anonymous"
src="https://cdn.jsdelivr.net/npm/@google/model-viewer@4.4.0/dist/model-viewer.min.js"
integrity="sha384-wjsPzEO+lXOf7d9csIDfAQpPt2OKuUU3m0K9qsdKIuzX4N8czSF6hdh23eAbZa3p"></script>
<style>model-viewer { width: 100%; height: 480px } model-viewer:not(:defined) { display: none }</style>"""
"""The web component that shows glTF, of one version, whose content browsers check. Without it, offline for example, the page
shows the pictures only."""

VIEW = (
    '<model-viewer src="../_static/{name}.glb" alt="{title}, to be turned" camera-controls touch-action="pan-y" '
    'camera-orbit="35deg 65deg auto" exposure="0.75" loading="lazy" interaction-prompt="none">'
    '<div slot="poster">The model is loading.</div></model-viewer>'
)
"""The view of a model. The distance of the camera follows from the model's size: glTF is in metres, with y up."""

MODULES = {
    "tpmscad": "Solids and files",
    "tpmscad.fields": "Fields",
    "tpmscad.maps": "Maps",
    "tpmscad.sweeps": "Sweeps",
    "tpmscad.blending": "Blends",
    "tpmscad.surfaces": "Surfaces",
    "tpmscad.topology": "Topology",
}
"""Modules with public names, and the titles of their pages."""


def write_all(folder: Path) -> None:
    """Write every generated page, and the pictures that are not there yet."""
    folder.mkdir(exist_ok=True)
    described: set[int] = set()
    for module, title in MODULES.items():
        (folder / f"api_{module.replace('.', '_')}.rst").write_text(describe_module(module, title, described))
    (folder / "recipe_keys.txt").write_text(format_reference(None, width=100))
    (folder / "commands.md").write_text(describe_commands())
    (folder / "catalogue.txt").write_text(run_command("surfaces"))
    (folder / "examples.md").write_text(describe_examples())
    for name, draw in PICTURES.items():
        if not (folder / f"{name}.png").exists():
            begun = time.perf_counter()
            draw(folder / f"{name}.png")
            print(f"picture {name}: {time.perf_counter() - begun:.1f} s")


def describe_module(module: str, title: str, described: set[int]) -> str:
    """A page of reStructuredText with the public names of a module that no other page describes yet."""
    home = import_module(module)
    lines = [title, "=" * len(title), "", f".. currentmodule:: {module}", ""]
    for name in home.__all__:
        value = getattr(home, name)
        if id(value) in described:
            continue
        described.add(id(value))
        if inspect.isclass(value):
            lines += [f".. autoclass:: {name}", "   :members:", ""]
        elif inspect.isfunction(value):
            lines += [f".. autofunction:: {name}", ""]
    return "\n".join(lines)


def run_command(*arguments: str) -> str:
    """What `tpmscad` prints."""
    command = [sys.executable, "-m", "tpmscad", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, env=_plain_terminal()).stdout


def _plain_terminal() -> dict[str, str]:
    return {**os.environ, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "100"}


def describe_commands() -> str:
    """A page with the help of every command."""
    from tpmscad import cli

    pages = ["# Commands", "", "What `tpmscad COMMAND --help` prints.", ""]
    for command in cli.make_app().registered_commands:
        pages += [
            f"## tpmscad {command.name}",
            "",
            "```text",
            run_command(str(command.name), "--help").rstrip(),
            "```",
            "",
        ]
    return "\n".join(pages)


def describe_examples() -> str:
    """A gallery: of every example the first paragraph, the kept pictures and the text to download; a table of measures."""
    pages = [
        "# Examples",
        "",
        "The scripts in `examples/`; each runs as it is (those for CadQuery with the extra `cadquery`), and the tests run them. "
        "Views in 3-D are turned by dragging; they need WebGL, and the network for their script.",
        "",
        *describe_measures(),
        *_raw_html(VIEWER),
    ]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text())) or ""
        pages += [
            f"## {path.stem.replace('_', ' ')}",
            "",
            text.split("\n\n")[0],
            "",
            *show_pictures(path.stem),
            f"{{download}}`{path.name} <../../examples/{path.name}>`",
            "",
        ]
        pages += [f"```{{literalinclude}} ../../examples/{path.name}", ":language: python", "```", ""]
    return "\n".join(pages)


def show_pictures(example: str) -> list[str]:
    """The pictures of an example, and the view of its model if one is kept."""
    lines = [f"![{path.stem.replace('_', ' ')}](../gallery/{path.name})\n" for path in find_pictures(example)]
    if (MODELS / f"{example}.glb").exists():
        lines += _raw_html(VIEW.format(name=example, title=example.replace("_", " ")))
    return lines


def _raw_html(text: str) -> list[str]:
    return ["```{raw} html", text, "```", ""]


def find_pictures(example: str) -> list[Path]:
    """The kept pictures of an example, which `benchmarks/gallery.py` draws."""
    return sorted(path for path in GALLERY.glob("*.png") if path.stem == example or path.stem.startswith(f"{example}-"))


def describe_measures() -> list[str]:
    """A table of the solids of the applications, which `benchmarks/gallery.py` measures."""
    with (GALLERY / "measures.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        return []
    head = ["example", "solid", "CPU seconds", "faces", "MB", "deviation, mm", "pieces, tunnels, cavities"]
    names = ["solid", "cpu_seconds", "faces", "megabytes", "deviation_mm", "betti"]
    link = "[{0}](#{1})".format
    cells = [
        [link(row["example"].replace("_", " "), row["example"].replace("_", "-")), *(row[name] for name in names)]
        for row in rows
    ]
    lines = ["| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *cells)]
    return ["Applications at full size; the CPU seconds include drawing and writing:", "", *lines, ""]


def _draw_lattice(**keywords: Any) -> Callable[[Path], None]:
    view = {key: keywords.pop(key) for key in ("section", "color_by") if key in keywords}
    surface = keywords.pop("surface")
    return lambda path: tpmscad.lattice(surface, progress=False, **keywords).render(path, size=PICTURE_SIZE, **view)


def _draw_graded(path: Path) -> None:
    level = fields.ramp("z", (0, 10), (0.15, 0.6))
    field = fields.sheet(fields.tpms("gyroid", period=5), -level, level)
    tpmscad.solidify(field, ((0, 0, 0), (5, 5, 10)), tol=0.05, progress=False).render(path, size=PICTURE_SIZE)


def _draw_infill(path: Path) -> None:
    body = fields.cylinder((0, 0, 6), 10, height=12)
    model = tpmscad.infill(body, "gyroid", cell=8, thickness=0.8, tol=0.1, progress=False)
    model.render(path, size=PICTURE_SIZE)


PICTURES: dict[str, Callable[[Path], None]] = {
    "sheet": _draw_lattice(surface="gyroid", cell=10, thickness=1, tol=0.05),
    "skeletal": _draw_lattice(surface="gyroid", cell=10, volume_fraction=0.3, kind="skeletal", tol=0.05),
    "natural": _draw_lattice(surface="schwarz_p", cell=10, cells=2, thickness=1, boundary="natural", tol=0.05),
    "section": _draw_lattice(surface="diamond", cell=10, thickness=1, tol=0.05, section="z=5", color_by="deviation"),
    "graded": _draw_graded,
    "infill": _draw_infill,
}
"""Pictures by name, drawn once."""
