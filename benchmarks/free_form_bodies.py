"""Bodies with free-form faces cut on the patches' parameters, in random placements, beside the kernel's boolean.

    python -m benchmarks.free_form_bodies [--bodies cam,handle,...] [--placements 20] [--boolean 1] [--cell 6] [--thickness 0.7]

Each placement turns the body at random and shifts the lattice. Columns: placements that are valid by the kernel's full check; CPU
seconds from the whole patches to the checked solid, median and worst; the greatest relative difference of the volume from that of
the kernel's faces, by another quadrature, and from that of the kernel's boolean of the same lattice, for the first `--boolean`
placements, with its CPU seconds; what failed and why.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import build123d as bd
import numpy as np

from tpmscad.brep.moments import integral_properties
from tpmscad.errors import TpmscadError
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.boolean_operations import intersect_solids
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.occt.convert import transform_shape
from tpmscad.requests.lattice_request import LatticeRequest, read_lattice_request
from tpmscad.rigid_motion import Motion
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import cut_on_parameters
from tpmscad.solids.matter.lattice_block import build_lattice_block
from tpmscad.stage_timer import StageTimer


def cam() -> Any:
    """An extruded periodic spline: its third derivative jumps across six lines."""
    return bd.extrude(bd.make_face(bd.Spline((9, 0), (4, 6), (-3, 7), (-9, 2), (-7, -5), (1, -6), periodic=True)), 13)


def handle() -> Any:
    """A spline revolved."""
    side = bd.Spline((8, 0), (9, 4), (6, 10), (4, 15))
    profile = bd.make_face([*bd.Polyline((4, 15), (0, 15), (0, 0), (8, 0)).edges(), side])
    return bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z)


def elbow() -> Any:
    """An ellipse swept along a spline in space."""
    path = bd.Spline((0, 0, 0), (0, 0, 8), (5, 2, 13), (12, 4, 14))
    return bd.sweep(bd.Plane(origin=path @ 0, z_dir=path % 0) * bd.Ellipse(5, 3.2), path)


def blade() -> Any:
    """A ruled loft between two quadratic arcs with a chord each."""
    sections = []
    for z, ends, top in ((0, ((0, 0), (14, 0)), (7, 12)), (12, ((2, 2), (12, 3)), (7, 13))):
        (a, b), c = ((x, y, z) for x, y in ends), (*top, z)
        sections.append(bd.Face(bd.Wire([bd.Edge.make_bezier(a, c, b), bd.Edge.make_line(b, a)])))
    return bd.loft(sections, ruled=True)


def wing() -> Any:
    """An extruded profile with a nose of small radius and a blunt trailing edge."""
    points = [(20, 0.5), (12, 2.8), (4, 3.6), (0.6, 1.6), (0, 0), (0.6, -1.2), (4, -2), (12, -1.6), (20, -0.5)]
    return bd.extrude(bd.make_face([bd.Spline(*points), bd.Line(points[-1], points[0])]), 15)


def dome() -> Any:
    """A spline revolved that meets its axis at a right angle."""
    side = bd.Spline((7, 0), (5.5, 4), (0, 6.5), tangents=((0, 1), (-1, 0)))
    profile = bd.make_face([side, *bd.Polyline((0, 6.5), (0, 0), (7, 0)).edges()])
    return bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z)


def spindle() -> Any:
    """A torus that intersects itself, without the lemon inside."""
    return bd.Solid.make_torus(3.0, 5.0)


def blend() -> Any:
    """An elliptic prism with a fillet: surfaces that meet at a tangent, rational."""
    prism = bd.extrude(bd.Ellipse(8, 5), 12)
    return bd.fillet(prism.edges().group_by(bd.Axis.Z)[-1], 1.2)


BODIES: dict[str, Callable[[], Any]] = {
    "cam": cam,
    "handle": handle,
    "elbow": elbow,
    "ellipse": lambda: bd.extrude(bd.Ellipse(9, 5), 12),
    "blade": blade,
    "wing": wing,
    "dome": dome,
    "spindle": spindle,
    "blend": blend,
}


def wanted(cell: float, thickness: float, phase: tuple[float, float, float]) -> LatticeRequest:
    """A gyroid sheet."""
    request = read_lattice_request(
        "gyroid",
        cell=cell,
        cells=1,
        thickness=thickness,
        offset=None,
        volume_fraction=None,
        kind="sheet",
        side="-",
        reference="minimal",
        boundary="box",
        phase=phase,
        tol=None,
    )
    return replace(request, reference="minimal")


def run_body(name: str, options: argparse.Namespace) -> None:
    """Cut a body in all its placements and print its row."""
    rng = np.random.default_rng(11)
    seconds, kernel_seconds, apart, apart_kernel, failures, valid = [], [], [0.0], [0.0], [], 0
    for placement in range(options.placements):
        body = read_body(bd.Rotation(*rng.uniform(0, 360, 3)) * BODIES[name]())
        request = wanted(options.cell, options.thickness, tuple(rng.uniform(0, 1, 3).tolist()))
        block = build_lattice_block(request, np.eye(3), body, StageTimer(None))
        begun = time.process_time()
        try:
            cut = cut_on_parameters(KernelBody(body), block)
        except TpmscadError as error:
            failures.append(f"{placement}: {error}")
            continue
        finally:
            seconds.append(time.process_time() - begun)
        valid += 1
        volume = float(integral_properties.volume(integral_properties.integrate_faces(cut.built.brep))[0])
        apart.append(abs(sum(solid_moments(solid)[1] for solid in cut.built.solids) / volume - 1))
        if placement < options.boolean:
            begun, move = time.process_time(), Motion(np.eye(3), cut.shift)
            try:
                solids = intersect_solids(transform_shape(block.built.shape, move), body.shape)
                apart_kernel.append(abs(sum(solid_moments(solid)[1] for solid in solids) / volume - 1))
            except TpmscadError as error:
                failures.append(f"boolean of {placement}: {error}")
            kernel_seconds.append(time.process_time() - begun)
    print(
        f"{name:>8} {valid:>3}/{options.placements:<3} {np.median(seconds):7.1f} {max(seconds):7.1f} {max(apart):9.0e} "
        f"{max(apart_kernel):9.0e} {np.median(kernel_seconds or [np.nan]):7.1f}  {'; '.join(failures)[:200]}",
        flush=True,
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default=",".join(BODIES))
    parser.add_argument("--placements", type=int, default=20)
    parser.add_argument("--boolean", type=int, default=1)
    parser.add_argument("--cell", type=float, default=6.0)
    parser.add_argument("--thickness", type=float, default=0.7)
    options = parser.parse_args(arguments)
    print(
        f"{'body':>8} {'valid':>7} {'median':>7} {'worst s':>7} {'kernel V':>9} {'boolean V':>9} {'its s':>7}  failures"
    )
    for name in options.bodies.split(","):
        run_body(name, options)


if __name__ == "__main__":
    main()
