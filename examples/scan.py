"""A scanned object filled with a gyroid: triangles in an STL file become an exact, porous solid.

The scan is made up here: a pebble with bumps, as closed triangles. Any STL, OBJ, PLY or 3MF file takes its place. The triangles
become a smooth field; with `main(skin=1.0)` a closed skin stays along it. The wall of the gyroid is that of the minimal surface.

    pip install "tpmscad[triangles]"
    python examples/scan.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import tpmscad
from tpmscad import fields


def write_scan(path: Path, radius: float) -> None:
    """A pebble as an STL file, in mm."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    x, y, z = ball.vertices.T
    bumps = 1 + 0.08 * np.sin(4 * x + 1) * np.cos(3 * y) + 0.06 * np.sin(5 * z + 2 * x)
    trimesh.Trimesh(radius * bumps[:, None] * ball.vertices * (1.0, 0.8, 0.65), ball.faces).export(path)


def main(
    folder: str | Path = ".", radius: float = 5.0, cell: float = 8.0, skin: float | None = None, tol: float = 0.25
) -> dict[str, Any]:
    """Make, draw and write the filled pebble, in mm; return what was measured on it."""
    scan = Path(folder) / "scan.stl"
    write_scan(scan, radius)
    body = fields.mesh(scan)
    model = tpmscad.infill(body, "gyroid", cell=cell, thickness=0.8, skin=skin, tol=tol)
    model.export(Path(folder) / "scan.step")
    model.render(Path(folder) / "scan.png", section="y")
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "scan to body": body.max_deviation,
        "volume fraction": float(model.volume / trimesh.load_mesh(scan).volume),
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
