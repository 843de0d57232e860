"""The applications of the gallery at full size: measures, pictures, and meshes for the view in 3-D.

    python -m benchmarks.gallery [NAME ...]

Each script of `examples/` that is named, or all of APPLICATIONS and PLOTS, runs in an empty folder. Its rows go into
docs/gallery/measures.csv (seconds, faces, megabytes, deviation, Betti numbers) and its pictures, reduced, beside it; the page of
examples shows both. The solids of VIEWS are meshed coarsely into docs/gallery/models, for the interactive view of that page.
"""

from __future__ import annotations

import csv
import os
import runpy
import sys
import tempfile
from collections.abc import Iterable
from contextlib import chdir
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from PIL import Image

from tpmscad.kernel.export.gltf_file import write_glb
from tpmscad.kernel.export.mesh_parts import group_faces
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.render.palette import SURFACE_COLOUR, piece_colour

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"
COLUMNS = ("example", "solid", "cpu_seconds", "faces", "megabytes", "deviation_mm", "betti", "met")
PICTURE_WIDTH = 640
PALETTE = 256
"""Colours of a kept picture, for small files."""

APPLICATIONS = (
    "trimmed",
    "build123d_bracket",
    "implant",
    "bone",
    "counter_flow_exchanger",
    "beam",
    "cell_size_grading",
    "nozzle",
    "tooth",
)
"""Examples that make a solid, without CadQuery."""

PLOTS = ("sweep",)
"""Examples that draw a plot, whose pictures are kept without a row of measures."""

VIEWS = {
    "build123d_bracket": "*.step",
    "counter_flow_exchanger": "*fluid*.step",
    "implant": "*.step",
    "trimmed": "*.step",
}
"""Examples that are shown in 3-D, too, and their STEP files of which the solids are taken."""

MODELS = GALLERY / "models"
VIEW_BYTES = 1_500_000
"""Greatest size of a GLB file of the page."""

VIEW_DEVIATION, VIEW_ANGLE = 2e-3, np.radians(25.0)
"""Deviation of the meshes of views in diagonals of the solid, and the turn between facets; more if a file is too large."""

COARSENING = 1.5

FULL_SIZE: dict[str, dict[str, Any]] = {
    "bone": {"arrangements": ("quadrants", "layers")},
    "cell_size_grading": {"size": (40.0, 20.0, 20.0), "voxels": 80},
    "nozzle": {"cells": (16, 1, 7)},
}
"""Arguments of examples that make less by default."""


def flatten(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The measures of each solid of an example by its name; of a single one under the empty name."""
    if "met" in found:
        return {"": found}
    return {name: value for name, value in found.items() if isinstance(value, dict) and "met" in value}


def keep_picture(example: str, path: Path) -> None:
    """A reduced picture under the name of the example, and its own name where that says more."""
    own = path.stem.removeprefix(example).strip("_")
    name = example if not own or own in example else f"{example}-{own}"
    reduce_picture(path, GALLERY / f"{name}.png")


def reduce_picture(source: Path, target: Path) -> None:
    """A picture for a page: of moderate width, in few colours."""
    with Image.open(source) as image:
        reduced = image.convert("RGB")
        reduced.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH), Image.Resampling.LANCZOS)
        reduced.quantize(PALETTE).save(target, optimize=True)


def write_view(files: Iterable[Path], target: Path) -> None:
    """The solids of STEP files as GLB of at most VIEW_BYTES, in as many colours, with sharp edges round planes and quadrics."""
    shape = bd.Compound([solid for file in sorted(files) for solid in bd.import_step(file).solids()])
    solids = shape.solids()
    colours = [SURFACE_COLOUR] if len(solids) == 1 else [piece_colour("", i) for i in range(len(solids))]
    deviation, angle = VIEW_DEVIATION * shape.bounding_box().diagonal, VIEW_ANGLE
    while True:
        meshes = mesh_solids(shape.wrapped, deviation, angle)
        parts = [
            group_faces(f"solid {i}", mesh, [smooth_group(face) for face in solid.faces()], lambda _, i=i: colours[i])
            for i, (solid, mesh) in enumerate(zip(solids, meshes, strict=True))
        ]
        write_glb(parts, target, target.stem)
        size = target.stat().st_size
        print(f"{target.name}: {size / 1e6:.2f} MB, deviation {deviation:.3g} mm", flush=True)
        if size <= VIEW_BYTES:
            return
        deviation, angle = COARSENING * deviation, min(COARSENING * angle, np.radians(80.0))


def smooth_group(face: bd.Face) -> str:
    """The faces within which normals are averaged: all patches, all faces in one plane, all quadrics of one kind."""
    if face.geom_type != bd.GeomType.PLANE:
        return face.geom_type.name
    normal = face.normal_at()
    place = np.round([*normal, normal.dot(face.center())], 3) + 0.0  # no -0
    return f"PLANE {place.tolist()}"


def run_example(name: str) -> list[dict[str, Any]]:
    """Run an example, keep its pictures, and return a row for each of its solids."""
    sys.path.insert(0, str(ROOT / "examples"))
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        begun = sum(os.times()[:4])  # with child processes
        found = runpy.run_path(str(ROOT / "examples" / f"{name}.py"))["main"](**FULL_SIZE.get(name, {}))
        seconds = sum(os.times()[:4]) - begun
        for picture in Path().glob("*.png"):
            keep_picture(name, picture)
        if name in PLOTS:
            print(found)
            return []
        for key, value in found.items():
            print(f"{name}: {key}: {value}")
        files = sorted(Path().glob("*.step"), key=lambda file: len(file.stem))
        if name in VIEWS:
            MODELS.mkdir(exist_ok=True)
            write_view(Path().glob(VIEWS[name]), MODELS / f"{name}.glb")
        rows = []
        for solid, values in flatten(found).items():
            written = [file for file in files if solid in file.stem] or files
            rows.append(
                {
                    "example": name,
                    "solid": solid or name,
                    "cpu_seconds": round(seconds),
                    "faces": values["faces"],
                    "megabytes": round(written[0].stat().st_size / 1e6, 1),
                    "deviation_mm": f"{values['deviation']:.2g}",
                    "betti": " ".join(map(str, values["betti"])),
                    "met": values["met"],
                }
            )
        return rows


def main() -> None:
    GALLERY.mkdir(exist_ok=True)
    path = GALLERY / "measures.csv"
    for name in sys.argv[1:] or (*APPLICATIONS, *PLOTS):
        rows = run_example(name)
        if path.exists():
            rows += [row for row in csv.DictReader(path.open(newline="")) if row["example"] != name]
        with path.open("w", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(sorted(rows, key=lambda row: (row["example"], row["solid"])))
    print(path.read_text())


if __name__ == "__main__":
    main()
