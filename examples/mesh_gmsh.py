"""From a solid to second-order meshes for simulation: one periodic cell, and an infilled part.

Writes gyroid_cell.msh, .inp and .vtu and infilled_part.msh, and prints what was measured on the meshes. Needs gmsh
(pip install "tpmscad[mesh]"; on a bare Debian or Ubuntu also
apt-get install libglu1-mesa libxcursor1 libxft2 libxinerama1 libgomp1).
"""

from __future__ import annotations

import build123d as bd

import tpmscad

if __name__ == "__main__":
    cell = tpmscad.lattice("gyroid", cell=10, thickness=1.5, tol=0.01).mesh(0.8, periodic=True)
    print(cell)
    for suffix in (".msh", ".inp", ".vtu"):
        cell.write(f"gyroid_cell{suffix}")

    bushing = bd.Pos(10, 10, 5) * (bd.Cylinder(9, 10) - bd.Cylinder(3, 10))
    part = tpmscad.infill(bushing, "gyroid", cell=10, thickness=1.5, tol=0.02).mesh(1.0)
    print(part)
    part.write("infilled_part.msh")
