"""Lattices trimmed by bodies of planes and quadrics against the kernel's boolean of the same lattice and body, in one run.

    python -m benchmarks.trimming [--surfaces gyroid,diamond,schwarz_p,iwp] [--bodies box,cylinder,...] [--boolean yes]
    python -m benchmarks.trimming --cells 10

All times are CPU seconds. *cut* is the trim alone, *build* makes kernel faces and solids of the result, *boolean* is
BRepAlgoAPI_Common of the body with a closed block of the same lattice around it. Volumes must agree with the boolean's, or, where
that is left out, the solid's and the void's must add up to the body's. `valid` is the kernel's check; *ratio* is boolean over
cut + build. `--cells 10` is a gyroid of that many cells a side in its inscribed cylinder.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace

import build123d as bd
import numpy as np

from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import TrimmingError
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.boolean import boolean_operations
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape, is_valid
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.solids.matter.lattice_block import PatchesOverBox, fit_patches_over_box
from tpmscad.trimming.operands.polyhedra import box

CELL, TOL = 10.0, 1e-3
HEAD = f"{'surface':>10} {'body':>12} {'patches':>7} {'faces':>6} {'cut':>6} {'build':>6} {'boolean':>8} {'ratio':>6} "


def bracket() -> bd.Part:
    """Two walls at right angles with a fillet between them, three holes, two rounded corners."""
    part = bd.Box(40, 40, 8, align=(bd.Align.MIN,) * 3) + bd.Box(8, 40, 40, align=(bd.Align.MIN,) * 3)
    inner = [e for e in part.edges() if abs(e.center().X - 8) < 0.1 and abs(e.center().Z - 8) < 0.1]
    part = bd.fillet(inner, 6)
    for y in (12, 28):
        part -= bd.Pos(26, y, 0) * bd.Cylinder(4, 40)
    part -= bd.Pos(0, 20, 26) * bd.Rot(0, 90, 0) * bd.Cylinder(6, 40)
    return bd.fillet([e for e in part.edges().filter_by(bd.Axis.Z) if e.center().X > 39], 5)


BODIES = {
    "box": lambda: bd.Pos(20, 20, 20) * bd.fillet(bd.Box(38, 37, 36).edges(), 4),
    "cylinder": lambda: bd.Pos(20.3, 19.8, 20.1) * bd.Rot(20, 35, 10) * bd.Cylinder(14, 24),
    "sphere": lambda: bd.Pos(20.3, 19.7, 20.2) * bd.Sphere(19),
    "bracket": bracket,
    "torus": lambda: bd.Pos(20, 20.3, 19.8) * bd.Rot(10, 15, 0) * bd.Torus(13, 5.5),
}


def volume(brep: Brep) -> float:
    return float(integral_properties.volume(integral_properties.integrate_faces(brep))[0]) if len(brep.faces) else 0.0


def turned(lattice: Brep) -> Brep:
    return replace(lattice, faces=replace(lattice.faces, sense=-lattice.faces.sense))


def covering(surface: str, low: np.ndarray, high: np.ndarray) -> PatchesOverBox:
    """Whole patches around a box."""
    request = read_lattice_request(
        surface, cell=CELL, cells=1, thickness=1.0, offset=None, volume_fraction=None, kind="sheet", side="-",
        reference=None, boundary="box", phase=(0.0, 0.0, 0.0), tol=TOL,
    )  # fmt: skip
    return fit_patches_over_box(request, low, high, lambda _: None)


def lattice_around(surface: str, low: np.ndarray, high: np.ndarray) -> tuple[Brep, Brep]:
    """Whole patches around a box, and their solid in a box a little larger."""
    around = covering(surface, low, high)
    return around.patches, trim(around.patches, box(around.low, around.high)).brep


def measured(surface: str, name: str, patches: Brep, block: Brep, shape: bd.Part, by_boolean: bool) -> None:
    tool = brep_from_shape(shape)
    begun = time.process_time()
    try:
        cut = trim(patches, tool)
    except TrimmingError as error:
        print(f"{surface:>10} {name:>12} {len(patches.faces):>7} left to the kernel: {error}", flush=True)
        return
    traced = time.process_time() - begun
    begun = time.process_time()
    built = build_solids(cut.brep)
    made = time.process_time() - begun
    valid, found = is_valid(built.shape), volume(cut.brep)
    line = f"{surface:>10} {name:>12} {len(patches.faces):>7} {len(cut.brep.faces):>6} {traced:6.2f} {made:6.2f} "
    if by_boolean:
        solid = build_solids(block).shape
        begun = time.process_time()
        other = boolean_operations.intersect_solids(solid, shape.wrapped)
        spent = time.process_time() - begun
        off = sum(check_shape(s).volume for s in other) / found - 1
        line += f"{spent:8.2f} {spent / (traced + made):6.1f} "
    else:
        off = (found + volume(trim(turned(patches), tool).brep)) / volume(tool) - 1
        line += f"{'':>8} {'':>6} "
    print(f"{line} {valid!s:>5} {found:13.6f} {off:9.1e} {cut.report.shifted:7.1e}", flush=True)


def large(n: int) -> None:
    """A gyroid of n cells a side in its inscribed cylinder: seconds of wall time, CPU and memory."""
    half = n * CELL / 2
    wall, cpu = time.perf_counter(), time.process_time()
    shape = bd.Pos(half, half, half) * bd.Cylinder(half, 2 * half)
    request = read_lattice_request(
        "gyroid", cell=CELL, cells=1, thickness=1.0, offset=None, volume_fraction=None, kind="sheet", side="-",
        reference=None, boundary="box", phase=(0.0, 0.0, 0.0), tol=TOL,
    )  # fmt: skip
    patches = fit_patches_over_box(request, np.zeros(3), np.full(3, 2 * half), lambda _: None).patches
    stages = [("cover", time.process_time() - cpu)]
    begun = time.process_time()
    cut = trim(patches, brep_from_shape(shape))
    stages.append(("cut", time.process_time() - begun))
    begun = time.process_time()
    built = build_solids(cut.brep)
    stages.append(("build", time.process_time() - begun))
    begun = time.process_time()
    valid = is_valid(built.shape)
    stages.append(("check", time.process_time() - begun))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{len(cut.brep.faces)} faces, valid {valid}, volume {volume(cut.brep):.4f}, {cut.report}")
    print(
        ", ".join(f"{name} {s:.1f} s" for name, s in stages),
        f"CPU; wall {time.perf_counter() - wall:.1f} s, {memory:.2f} GiB",
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surfaces", default="gyroid,diamond,schwarz_p,iwp")
    parser.add_argument("--bodies", default=",".join(BODIES))
    parser.add_argument("--boolean", choices=("yes", "no"), default="yes")
    parser.add_argument("--cells", type=int, default=0)
    options = parser.parse_args(arguments)
    by_boolean = options.boolean == "yes"
    if options.cells:
        large(options.cells)
    else:
        print(f"{HEAD} {'valid':>5} {'volume':>13} {'off':>9} {'moved':>7}")
        for name in options.bodies.split(","):
            shape = BODIES[name]()
            bounds = shape.bounding_box()
            low, high = np.array([*bounds.min]), np.array([*bounds.max])
            for surface in options.surfaces.split(","):
                measured(surface, name, *lattice_around(surface, low, high), shape, by_boolean)


if __name__ == "__main__":
    main()
