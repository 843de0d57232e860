"""From a solid to second-order meshes for simulation: one periodic cell, and an infilled part.

Writes gyroid_cell.msh, .inp and .vtu and infilled_part.msh, and returns what was measured on the meshes. Needs gmsh
(pip install "tpmscad[mesh]"; on a bare Debian or Ubuntu also
apt-get install libglu1-mesa libxcursor1 libxft2 libxinerama1 libgomp1).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd

import tpmscad


def main(folder: str | Path = ".", size: float = 1.6, radius: float = 5.5, tol: float = 0.05) -> dict[str, Any]:
    """Mesh both with edges near `size`, the part of an outer `radius`, in mm; return elements, quality and volumes."""
    cell = tpmscad.lattice("gyroid", cell=10, thickness=1.5, tol=tol)
    cell_mesh = cell.mesh(size, periodic=True)
    for suffix in (".msh", ".inp", ".vtu"):
        cell_mesh.write(Path(folder) / f"gyroid_cell{suffix}")

    bushing = bd.Pos(5, 5, 5) * (bd.Cylinder(radius, 8) - bd.Cylinder(3, 8))
    part = tpmscad.infill(bushing, "gyroid", cell=10, thickness=1.5, tol=tol)
    part_mesh = part.mesh(size)
    part_mesh.write(Path(folder) / "infilled_part.msh")
    return {
        name: {
            "elements": mesh.n_cells,
            "least quality": mesh.quality.smallest,
            "volume": mesh.volume,
            "volume of the solid": model.volume,
        }
        for name, (mesh, model) in {"cell": (cell_mesh, cell), "part": (part_mesh, part)}.items()
    }


if __name__ == "__main__":
    for name, values in main().items():
        print(name, values)
