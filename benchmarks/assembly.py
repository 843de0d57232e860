"""Time per face of solids from shared edges against BRepBuilderAPI_Sewing: N x N x N cells, natural boundary, one run.

    python -m benchmarks.assembly [--surface gyroid] [--cells 1,2,4,8] [--sew-up-to 8]

Sewing gets its faces ready made, so that its column is the sewing alone; the other is everything from the arrays to the solid.
Both are CPU seconds. Sewing finds the edges that the complex knows; its result is not even turned the right way out.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy

from tests.kernel import occt_oracle
from tpmscad import surfaces
from tpmscad.brep.boundary_representation import Brep, scale_brep
from tpmscad.kernel.build.solids import build_solids
from tpmscad.lattices import copies
from tpmscad.lattices.primitive import fit_offset_surfaces
from tpmscad.requests.lattice_request import read_lattice_request

CELL, THICKNESS, TOL = 10.0, 1.0, 1e-2
SEWING_TOLERANCE = 1e-4


def natural_lattice(surface: str, cells: int) -> Brep:
    """A closed sheet of whole cells with its gaps bridged, mm."""
    request = read_lattice_request(
        surface, cell=CELL, cells=cells, thickness=THICKNESS, offset=None, volume_fraction=None, kind="sheet", side="-",
        reference="minimal", boundary="natural", phase=(0.0, 0.0, 0.0), tol=TOL,
    )  # fmt: skip
    sheet = fit_offset_surfaces(request.surface, request.reference, request.layer_offsets, CELL, TOL).surfaces
    placements = copies.place_whole_cells(request.surface, request.cells, np.zeros(3))
    return scale_brep(copies.build_natural_lattice(surfaces.patch_symmetry(request.surface), sheet, placements), CELL)


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    begun = time.process_time()
    result = work()
    return result, time.process_time() - begun


def main(arguments: list[str] | None = None) -> list[dict[str, float]]:
    """Print the table; returns its rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surface", default="gyroid")
    parser.add_argument("--cells", default="1,2,4,8")
    parser.add_argument("--sew-up-to", type=int, default=8)
    options = parser.parse_args(arguments)
    print(f"{options.surface}, cell {CELL:g} mm, wall {THICKNESS:g} mm, tol {TOL:g} mm; CPU seconds")
    print(
        f"{'N':>3} {'faces':>7} {'shared edges':>13} {'us/face':>8} {'sewing':>9} {'us/face':>8} {'ratio':>7} {'peak GB':>8}"
    )
    rows = []
    for n in map(int, options.cells.split(",")):
        brep = natural_lattice(options.surface, n)
        built, shared = timed(lambda brep=brep: build_solids(brep))
        faces = len(brep.faces)
        sewing = float("nan")
        if n <= options.sew_up_to:
            lone = [BRepBuilderAPI_Copy(face, True).Shape() for face in built.faces]
            _, sewing = timed(lambda lone=lone: occt_oracle.sew_solids(lone, SEWING_TOLERANCE))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        rows.append({"n": n, "faces": faces, "shared": shared, "sewing": sewing})
        print(
            f"{n:3} {faces:7} {shared:13.2f} {1e6 * shared / faces:8.0f} {sewing:9.2f} {1e6 * sewing / faces:8.0f} "
            f"{sewing / shared:7.1f} {peak:8.2f}",
            flush=True,
        )
    by_n = {row["n"]: row["shared"] / row["faces"] for row in rows}
    if {2, 8} <= by_n.keys():
        print(f"time per face at N = 8 over N = 2: {by_n[8] / by_n[2]:.2f}")
    return rows


if __name__ == "__main__":
    main()
