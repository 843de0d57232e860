"""Pages of the guide that are made from the code: API, keys of recipes, commands, the catalogue, examples, and all pictures."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import command_pages
import gallery_pages

import tpmscad
from tpmscad import fields
from tpmscad.recipe.key_reference import format_reference

ROOT = Path(__file__).resolve().parents[1]
PICTURE_SIZE = (640, 480)

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
    command_pages.write_commands(folder)
    (folder / "catalogue.txt").write_text(run_command("surfaces"))
    gallery_pages.write_gallery(folder)
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
