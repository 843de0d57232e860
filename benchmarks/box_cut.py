"""The box boundary against the kernel's boolean, N x N x N cells, and the whole way to a checked STEP file, in one run.

    python -m benchmarks.box_cut [--surfaces gyroid,diamond,schwarz_p] [--cut 1,2,3] [--whole 1,5]

The cut's columns are CPU seconds of the cut alone: traced on the patches' parameters and closed with caps, beside
BRepAlgoAPI_Common of the same lattice, whole cells that just cover the box, with the box. Volumes are per cell and must agree.
The second table is wall time from the request to a STEP file that was read back and checked.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import tpmscad
from tests.kernel import occt_oracle
from tests.trimming.network_operands import trim
from tpmscad import surfaces
from tpmscad.brep.boundary_representation import scale_brep
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape, is_valid
from tpmscad.lattices import copies
from tpmscad.lattices.primitive import fit_offset_surfaces
from tpmscad.trimming.operands.polyhedra import box

CELL, HALF, TOL = 10.0, 0.5, 1e-3


def cut(name: str, n: int) -> tuple[float, float, float, float]:
    """CPU seconds and volume per cell of both ways: (own, volume, boolean, volume)."""
    sheet = fit_offset_surfaces(name, "minimal", (-HALF, HALF), CELL, TOL).surfaces
    cells, motions = (n, n, n), surfaces.patch_symmetry(name)
    begun = time.process_time()
    covering = scale_brep(copies.patches_over_box(motions, sheet, cells, np.zeros(3)), CELL)
    own = trim(covering, box(np.zeros(3), np.full(3, n * CELL))).brep
    built = build_solids(own)
    seconds = time.process_time() - begun
    assert is_valid(built.shape)

    cover = copies.place_whole_cells(name, (n + 2,) * 3, np.full(3, -1.0))
    solid = build_solids(scale_brep(copies.build_natural_lattice(motions, sheet, cover), CELL)).shape
    begun = time.process_time()
    common = occt_oracle.intersect_with_box(solid, np.zeros(3), np.full(3, n * CELL))
    boolean = time.process_time() - begun
    return seconds, measure_solid(own).volume / n**3, boolean, check_shape(common).volume / n**3


def whole(name: str, n: int) -> tuple[tpmscad.Certificate, float, float, float]:
    """The certificate, seconds to the solid, seconds to the checked file, megabytes."""
    begun = time.perf_counter()
    model = tpmscad.lattice(name, cell=CELL, cells=n, thickness=2 * HALF, tol=TOL)
    made = time.perf_counter() - begun
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lattice.step"
        model.export_step(path)
        return model.certificate, made, time.perf_counter() - begun, path.stat().st_size / 1e6


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surfaces", default="gyroid,diamond,schwarz_p")
    parser.add_argument("--cut", default="1,2,3")
    parser.add_argument("--whole", default="1,5")
    options = parser.parse_args(arguments)
    names = options.surfaces.split(",")
    if options.cut:
        print(
            f"{'surface':>10} {'N':>2} {'own cut':>8} {'boolean':>8} {'ratio':>6} {'volume/cell':>13} {'boolean':>13}"
        )
        for name in names:
            for n in map(int, options.cut.split(",")):
                own, volume, boolean, other = cut(name, n)
                print(
                    f"{name:>10} {n:>2} {own:8.2f} {boolean:8.2f} {boolean / own:6.1f} {volume:13.7f} {other:13.7f}",
                    flush=True,
                )
    if options.whole:
        print(
            f"{'surface':>10} {'N':>2} {'faces':>6} {'solid s':>8} {'file s':>7} {'MB':>6} {'met':>5} {'pieces':>6} "
            "volume/theory-1"
        )
        for name in names:
            theory = CELL**3 * surfaces.volume_fraction(name, "minimal", -HALF / CELL, HALF / CELL)
            for n in map(int, options.whole.split(",")):
                found, made, written, size = whole(name, n)
                print(
                    f"{name:>10} {n:>2} {found.n_faces:>6} {made:8.2f} {written:7.2f} {size:6.2f} {found.met!s:>5} "
                    f"{len(found.pieces):>6} {found.volume / n**3 / theory - 1:.2e}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
