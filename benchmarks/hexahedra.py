"""Hexahedra straight from the patches against tetrahedra of gmsh: quality, volume and elastic constants of a cell.

    python -m benchmarks.hexahedra [SURFACE ...] [--tetrahedra]

The volume is that of the trivariate splines against the solid's. Elastic constants are homogenised, Young's modulus 1, Poisson's
ratio 0.3, at a volume fraction of 0.2, on elements of 27 nodes, for several cuts of the patches. With --tetrahedra the same
cell, cut by its box, is meshed by gmsh with second-order elements, opposite sides periodic, and solved too.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import tpmscad
from tpmscad._typing import Array
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.periodic_cell import IsotropicMaterial, solve_cell

SURFACES = ("gyroid", "diamond", "schwarz_p", "iwp", "neovius", "frd")
VOLUME_FRACTION = 0.2
REFINEMENTS = ((1, 0), (2, 0), (3, 0), (3, 1))
TETRAHEDRON_SIZE = {"diamond": 0.045}
DEFAULT_SIZE = 0.055
"""Edge lengths of tetrahedra in cells."""


def constants(mesh: VolumeMesh) -> tuple[Array, int]:
    """C11, C12 and C44, averaged over the axes, and the number of unknowns."""
    found = solve_cell(mesh, IsotropicMaterial())
    c = found.stiffness
    values = c[:3, :3].trace() / 3, (c[:3, :3].sum() - c[:3, :3].trace()) / 6, c[3:, 3:].trace() / 3
    return np.array(values), found.unknowns


def row(what: str, mesh: VolumeMesh, reference: Array | None) -> Array:
    """Solve, print a row and return the constants."""
    start = time.process_time()
    values, unknowns = constants(mesh)
    text = "".join(f"{v:>9.5f}" for v in values)
    if reference is not None:
        text += "".join(f"{100 * (v / r - 1):>+8.2f} %" for v, r in zip(values, reference, strict=True))
    print(
        f"  {what:<22} {mesh.n_cells:>7} {unknowns:>9} {mesh.quality.smallest_scaled_jacobian:>7.3f} {text} "
        f"{time.process_time() - start:>6.1f} s"
    )
    return values


def run(name: str, tetrahedra: bool) -> None:
    """One surface."""
    reference = "nodal" if name in ("iwp", "neovius", "frd") else "minimal"
    options = {"cell": 1.0, "volume_fraction": VOLUME_FRACTION, "reference": reference, "tol": 1e-3}
    model = tpmscad.lattice(name, boundary="natural", **options)
    volumes = model.make_spline_volumes()
    miss = volumes.integrate_volume() / model.volume - 1
    print(
        f"{name}: {len(volumes)} bodies of degrees {volumes.primitives[0].degrees}, volume {miss:+.1e} of the solid's"
    )
    known = None
    if tetrahedra:
        mesh = tpmscad.lattice(name, **options).mesh(TETRAHEDRON_SIZE.get(name, DEFAULT_SIZE), periodic=True)
        known = row("tetrahedra", mesh, None)
    for refine in REFINEMENTS:
        row(f"hexahedra, refine={refine}", model.hexahedra(refine=refine), known)


def main(arguments: list[str]) -> None:
    """Print the tables."""
    names = [name for name in arguments if not name.startswith("-")] or SURFACES
    print(f"  {'':<22} {'elements':>7} {'unknowns':>8} {'sc.Jac.':>8} {'C11':>8} {'C12':>8} {'C44':>8}")
    for name in names:
        run(name, "--tetrahedra" in arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
