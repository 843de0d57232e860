"""The examples as the gallery of the guide shows them: CPU time, memory, measures, pictures, and meshes for the view in 3-D.

    python -m benchmarks.gallery [NAME ...]

Each script of `examples/` that is named, or all of SCENES, runs in an empty folder and a process of its own, with the arguments
of its scene. What it took goes into docs/gallery/runs.csv, what was measured on its solids into measures.csv (faces, megabytes,
deviation, Betti numbers), its pictures, reduced, beside them, and its solids, meshed coarsely, into docs/gallery/models. The
pages of the guide are made of these files: no example runs when the site is built.
"""

from __future__ import annotations

import csv
import os
import resource
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
MODELS = GALLERY / "models"
RUN_COLUMNS = ("example", "call", "cpu_seconds", "gib")
MEASURE_COLUMNS = ("example", "solid", "faces", "megabytes", "deviation_mm", "betti", "met")
PICTURE_WIDTHS = (640, 560, 480, 420)
PALETTE = (256, 128, 64, 32)
"""Widths and numbers of colours of a kept picture, the first ones that make it small enough."""

PICTURE_BYTES = 50_000
"""Greatest size of a kept picture."""


@dataclass(frozen=True)
class Scene:
    """The arguments of an example's `main` (as a script where it has none), and the files of its view in 3-D: STEP, or gmsh's."""

    arguments: dict[str, Any] = field(default_factory=dict)
    view: str = ""


SCENES: dict[str, Scene] = {
    "build123d_bracket": Scene(view="*.step"),
    "build123d_panel": Scene({"cells": (7, 4)}, view="*.step"),
    "cadquery_bracket": Scene(view="*.step"),
    "cadquery_panel": Scene(view="*.step"),
    "spinal_cage": Scene({"pore_size": 0.5}),
    "scan": Scene({"radius": 9.0, "cell": 6.0, "tol": 0.15}, view="*.step"),
    "segmentation": Scene({"size": 12.0, "cell": 5.0, "tol": 0.15}, view="*.step"),
    "implant": Scene({"radius": 5.0, "height": 8.0, "tol": 0.08}, view="*.step"),
    "octet_truss": Scene({"cells": 2}, view="*.step"),
    "voronoi_foam": Scene(view="*.step"),
    "periodic_foam": Scene(view="*.msh"),
    "trimmed": Scene(view="*schwarz_p.step"),
    "heat_exchanger": Scene({"cells": (5, 5, 8), "tol": 0.02}),
    "exchanger_openings": Scene({"size": (20.0, 18.0, 16.0), "tol": 0.1}, view="*.step"),
    "counter_flow_exchanger": Scene({"cells": (2, 2, 4), "tol": 0.05}, view="*.step"),
    "layers": Scene({"cell": 1.0, "height": 0.05}),
    "nozzle": Scene({"cells": (10, 1, 5), "tol": 0.05}, view="*.step"),
    "closed_ring": Scene(view="*.step"),
    "tooth": Scene(view="*.step"),
    "beam": Scene({"size": 2.5, "voxels": 10, "tol": 0.1}, view="*.step"),
    "cell_size_grading": Scene({"size": (40.0, 20.0, 20.0), "tol": 0.1, "voxels": 80}, view="*.step"),
    "bone": Scene({"arrangements": ("quadrants", "layers"), "tol": 0.08}, view="*quadrants.step"),
    "solidify_graded": Scene(view="*.step"),
    "solidify_blend": Scene(view="*.step"),
    "solidify_dask": Scene(),
    "sweep": Scene({"surfaces": ("gyroid", "diamond", "schwarz_p"), "thicknesses": (0.5, 1.0, 1.5, 2.0)}),
    "mesh_gmsh": Scene({"size": 1.0, "radius": 9.0, "tol": 0.02}, view="infilled_part.msh"),
    "beam_plate": Scene({"sizes": (5.0, 2.5, 1.25), "iterations": 15}),
    "persistence_diagrams": Scene(),
    "blend_scaffold": Scene(),
    "blend_round_regions": Scene(),
    "blend_free_regions": Scene(),
}
"""All examples, the most telling ones first. Those of CadQuery run in its environment."""


def flatten(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The measures of each solid of an example by its name; of a single one under the empty name."""
    if "met" in found:
        return {"": found} if "deviation" in found else {}
    return {name: value for name, value in found.items() if isinstance(value, dict) and "deviation" in value}


def keep_picture(example: str, path: Path) -> None:
    """A reduced picture under the name of the example, and its own name where that says more."""
    own = path.stem.removeprefix(example).strip("_")
    name = example if not own or own in example else f"{example}-{own}"
    reduce_picture(path, GALLERY / f"{name}.png")


def reduce_picture(source: Path, target: Path, limit: int = PICTURE_BYTES) -> None:
    """A picture for a page: of moderate width, in few colours, of at most `limit` bytes."""
    with Image.open(source) as image:
        drawn = image.convert("RGB")
    for width, colours in product(PICTURE_WIDTHS, PALETTE):
        reduced = drawn.copy()
        reduced.thumbnail((width, width), Image.Resampling.LANCZOS)
        reduced.quantize(colours, dither=Image.Dither.NONE).save(target, optimize=True)
        if target.stat().st_size <= limit:
            return
    raise ValueError(f"{target.name} has more than {limit} bytes at {width} pixels and {colours} colours")


def run_scene(name: str) -> None:
    """Run an example in this folder; keep its pictures, its view and what was measured."""
    from benchmarks.view_files import (
        draw_facets,
        read_facets,
        write_view,
    )  # loads the kernel: not in the process that starts the others
    from tpmscad import render

    scene, script = SCENES[name], ROOT / "examples" / f"{name}.py"
    sys.path.insert(0, str(script.parent))
    read = runpy.run_path(str(script))
    takes_main = "main" in read and not name.startswith("blend_")
    begun = sum(os.times()[:4])
    found = read["main"](**scene.arguments) if takes_main else runpy.run_path(str(script), run_name="__main__")
    seconds = sum(os.times()[:4]) - begun  # with child processes
    kib = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    call = ", ".join(f"{key}={value!r}" for key, value in scene.arguments.items())
    run = {
        "example": name,
        "call": f"main({call})" if call else "",
        "cpu_seconds": round(seconds),
        "gib": f"{kib / 2**20:.2g}",
    }
    replace_rows(GALLERY / "runs.csv", RUN_COLUMNS, name, [run])
    print(run, found if takes_main else "", flush=True)
    steps = sorted(Path().glob("*.step"), key=lambda file: len(file.stem))
    shown = sorted(Path().glob(scene.view)) if scene.view else []
    if not list(Path().glob("*.png")):
        if shown and shown[0].suffix == ".msh":
            Path(f"{name}.png").write_bytes(draw_facets(read_facets(shown[0])))
        elif steps:
            render(steps[0], f"{name}.png")
    for picture in Path().glob("*.png"):
        keep_picture(name, picture)
    rows = []
    for solid, values in flatten(found).items() if takes_main else ():
        written = [file for file in steps if solid in file.stem] or steps
        rows.append(
            {
                "example": name,
                "solid": solid or name,
                "faces": values.get("faces", values.get("n_faces")),
                "megabytes": round(written[0].stat().st_size / 1e6, 1),
                "deviation_mm": f"{values['deviation']:.2g}",
                "betti": " ".join(map(str, values["betti"])),
                "met": values["met"],
            }
        )
    replace_rows(GALLERY / "measures.csv", MEASURE_COLUMNS, name, rows)
    if shown:
        MODELS.mkdir(exist_ok=True)
        write_view(shown, MODELS / f"{name}.js")


def replace_rows(path: Path, columns: Sequence[str], example: str, rows: list[dict[str, Any]]) -> None:
    """Put rows in the place of those of an example in a table."""
    if path.exists():
        with path.open(newline="") as file:
            rows = rows + [row for row in csv.DictReader(file) if row["example"] != example]
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="ignore")
        table.writeheader()
        table.writerows(sorted(rows, key=lambda row: (row["example"], row.get("solid", ""))))


def main() -> None:
    if sys.argv[1:2] == ["--here"]:
        run_scene(sys.argv[2])
        return
    for name in sys.argv[1:] or SCENES:
        print(f"=== {name}", flush=True)
        if name.startswith("cadquery_") and find_spec("cadquery") is None:
            print("left out: CadQuery is not installed, pip install '.[cadquery]'", flush=True)
            continue
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            subprocess.run(
                [sys.executable, "-m", "benchmarks.gallery", "--here", name], cwd=folder, env=environment, check=False
            )


if __name__ == "__main__":
    main()
