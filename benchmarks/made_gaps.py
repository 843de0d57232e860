"""Bodies with gaps of a known size, filled by the cut on the patches' parameters alone, and judged by two routes to the volume.

    python -m benchmarks.made_gaps [--count 100] [--seed 0] [--only NAME]

A clean body is made first: fillets between free-form faces, lofts of 3 to 8 sections, swept tubes, turned splines, blocks with
rounded edges. Then it is spoilt as files do: the poles of its edges' curves are rounded to a grid, or the poles of its free-form
surfaces are, by 1e-6 to 5e-3 of a model unit; the bodies are about ten units wide. Each is put into a gyroid at a random place.

Outcomes: met, if the certificate is and the volume is that of the clean body in the same place, within four gaps times the area;
WRONG, if it is not; refused, with the reason. "no body" is one that the kernel's check rejects before anything is done.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import build123d as bd
import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_ElementarySurface, Geom_Surface
from OCP.TopAbs import TopAbs_FORWARD
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face

import tpmscad
from tpmscad.errors import KernelError, TpmscadError
from tpmscad.fallbacks import Fallback
from tpmscad.kernel.body_import.free_form_carriers import convert_box, convert_curve
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import edges_of, faces_of, first_vertex, last_vertex
from tpmscad.solids import cut

GAPS = (1e-6, 1e-5, 1e-4, 1e-3, 5e-3)
"""Grids, in model units, to which poles are rounded."""

CELL, WALL = 6.0, 0.6


def fillet_between_free_forms(rng: np.random.Generator) -> bd.Shape:
    """An extruded ellipse with a fillet on its upper side, or on a side of an extruded spline."""
    height, radius = rng.uniform(4, 6), rng.uniform(0.4, 0.9)
    if rng.random() < 0.5:
        base = bd.extrude(bd.Ellipse(rng.uniform(3.5, 4.5), rng.uniform(2.2, 3.2)), height)
    else:
        angles = np.arange(6) * np.pi / 3
        points = [(r * np.cos(a), r * np.sin(a)) for a, r in zip(angles, rng.uniform(3.2, 4.2, 6), strict=True)]
        base = bd.extrude(bd.make_face(bd.Spline(*points, periodic=True)), height)
    return bd.fillet(base.edges().group_by(bd.Axis.Z)[-1], radius)


def loft(rng: np.random.Generator) -> bd.Shape:
    """A loft through 3 to 8 ellipses."""
    count = int(rng.integers(3, 9))
    places = [bd.Plane(origin=(*rng.uniform(-0.4, 0.4, 2), z)) for z in np.linspace(0, 8, count)]
    return bd.loft([place * bd.Ellipse(rng.uniform(2.6, 3.6), rng.uniform(1.8, 2.5)) for place in places])


def tube(rng: np.random.Generator) -> bd.Shape:
    """An ellipse swept along a spline."""
    middle, end = rng.uniform((1, 0.3, 4), (2.5, 1.2, 5)), rng.uniform((4, 1, 5), (5, 2, 6.5))
    path = bd.Spline((0, 0, 0), (0, 0, 2.5), tuple(middle), tuple(end))
    return bd.sweep(bd.Plane(origin=path @ 0, z_dir=path % 0) * bd.Ellipse(rng.uniform(1.6, 2.0), 1.3), path)


def turned_spline(rng: np.random.Generator) -> bd.Shape:
    """A turned spline that is open, or ends in a pole."""
    a, b = rng.uniform(3.0, 4.0), rng.uniform(2.0, 3.0)
    if rng.random() < 0.5:
        side = bd.Spline((a, 0), (a + 0.4, 1.6), (b, 4), (1.6, 6))
        profile = bd.make_face([*bd.Polyline((1.6, 6), (0, 6), (0, 0), (a, 0)).edges(), side])
    else:
        side = bd.Spline((a, 0), (0.8 * a, 0.6 * a), (0, a), tangents=((0, 1), (-1, 0)))
        profile = bd.make_face([side, *bd.Polyline((0, a), (0, 0), (a, 0)).edges()])
    return bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z)


def rounded_block(rng: np.random.Generator) -> bd.Shape:
    """A block with a boss, whose edges are rounded: planes, cylinders, spheres and tori."""
    block = bd.Box(*rng.uniform(5, 7, 3)) + bd.Pos(0, 0, 3) * bd.Cylinder(rng.uniform(1.2, 1.8), 3)
    return bd.fillet(block.edges(), rng.uniform(0.2, 0.4))


BODIES: dict[str, Callable[[np.random.Generator], bd.Shape]] = {
    f.__name__: f for f in (fillet_between_free_forms, loft, tube, turned_spline, rounded_block)
}


def use_surface(builder: BRep_Builder, face: TopoDS_Face, surface: Geom_Surface, tolerance: float) -> None:
    """Put a face on another surface, with the pcurves that it has."""
    pcurves = []
    for edge in edges_of(face):
        forward = convert.as_edge(edge.Oriented(TopAbs_FORWARD))
        both = [forward, convert.as_edge(edge.Reversed())] if BRep_Tool.IsClosed_s(edge, face) else [forward]
        pcurves.append((edge, [BRep_Tool.CurveOnSurface_s(e, face, 0.0, 1.0) for e in both]))
    builder.UpdateFace(face, surface, TopLoc_Location(), 1e-7)
    for edge, curves in pcurves:
        builder.UpdateEdge(edge, *curves, face, tolerance)


def spoil(shape: bd.Shape, grid: float, faces: bool) -> bd.Solid:
    """A copy of a solid whose edges are splines with poles rounded to a grid, or with `faces` its free-form surfaces."""
    copy = BRepBuilderAPI_Copy(shape.solids()[0].wrapped).Shape()
    builder, tolerance = BRep_Builder(), 4.0 * grid
    if faces:
        for face in faces_of(copy):
            surface = BRep_Tool.Surface_s(face)
            if isinstance(surface, Geom_ElementarySurface):
                continue
            spline, _ = convert_box(surface, np.array(BRepTools.UVBounds_s(face)).reshape(2, 2), 1e-9)
            spline = replace(spline, poles=grid * np.round(spline.poles / grid))
            use_surface(builder, convert.as_face(face.Oriented(TopAbs_FORWARD)), convert.surface(spline), tolerance)
    for edge in edges_of(copy):
        if BRep_Tool.Degenerated_s(edge):
            continue
        if not faces:
            curve = convert_curve(BRepAdaptor_Curve(edge), 0.1 * grid)
            assert curve is not None
            curve = replace(curve, poles=grid * np.round(curve.poles / grid))
            builder.UpdateEdge(edge, convert.curve(curve), tolerance)
        builder.UpdateEdge(edge, tolerance)
        for vertex in (first_vertex(edge), last_vertex(edge)):
            builder.UpdateVertex(vertex, tolerance)
    return bd.Solid(copy)


def fill(body: bd.Shape, angles: np.ndarray, phase: np.ndarray) -> tpmscad.Model:
    """The body with a gyroid in it, by the cut on the patches' parameters or not at all."""
    return tpmscad.infill(
        body,
        "gyroid",
        cell=CELL,
        thickness=WALL,
        rotation=tuple(angles.tolist()),
        phase=tuple(phase.tolist()),
        loose="keep",
        tol=0.02,
        progress=False,
    )


def judge(make: Callable[[np.random.Generator], bd.Shape], seed: int) -> tuple[str, str]:
    """The outcome of a body in words, and what was done or what is wrong."""
    rng = np.random.default_rng(seed)
    clean = make(rng)
    grid, faces = float(rng.choice(GAPS)), bool(rng.random() < 0.5)
    angles, phase = rng.uniform(-180, 180, 3), rng.random(3)
    spoilt = spoil(clean, grid, faces)
    what = f"{'faces' if faces else 'edges'} off by {grid:g}"
    if not BRepCheck_Analyzer(spoilt.wrapped).IsValid():
        return "no body", f"{what}: the kernel's check rejects the body itself"
    try:
        model = fill(spoilt, angles, phase)
    except TpmscadError as error:
        return "refused", f"{what}: {error}"
    if not model.certificate.met or not model.certificate.valid:
        return "not met", f"{what}: {'; '.join(model.certificate.shortfalls)}"
    try:
        expected = fill(clean, angles, phase).volume
    except TpmscadError as error:
        return "no witness", f"{what}: {error}"
    allowed = 4.0 * grid * model.certificate.area + 1e-6 * expected
    if abs(model.volume - expected) > allowed:
        return "WRONG", f"{what}: it takes {model.volume:.9g}, the clean body {expected:.9g} +- {allowed:.2g}"
    return "met", f"{what}: {model.volume - expected:.1e} of {expected:.6g}; {'; '.join(model.certificate.notes[1:])}"


def _refuse(*_: Any) -> Any:
    """In place of the kernel's boolean, which would hide what is asked here."""
    raise KernelError("trim", "the kernel's boolean is left out")


def main(arguments: list[str] | None = None) -> None:
    """Print a line for each body, and how many have each outcome."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    given = parser.parse_args(arguments)
    cut.BY_KERNEL = Fallback("nothing else", _refuse)
    names = [name for name in BODIES if given.only in name]
    counts: Counter[str] = Counter()
    for k in range(given.seed, given.seed + given.count):
        name, begun = names[k % len(names)], time.process_time()
        outcome, words = judge(BODIES[name], k)
        counts[outcome] += 1
        print(f"{k:4d} {name:26s} {outcome:10s} {time.process_time() - begun:6.1f} {words[:300]}", flush=True)
    print(dict(counts))


if __name__ == "__main__":
    main()
