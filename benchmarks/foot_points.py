"""Feet on ten kinds of free-form face: time, and errors, beside the kernel's projection.

    python -m benchmarks.foot_points [PART OF A NAME ...]

Of 20 000 points, in random order, at up to a tenth of the face's size from random points of its carrier. `own` is the share of
points with no nearer foot than the one they were made from; their distances are compared with the made ones, and gradients with
the normals there. `kernel` is GeomAPI_ProjectPointOnSurf on the same surface for some of the points; `farther` is how much
farther than the kernel's foot the farthest of ours is, in sizes. Microseconds are of processor time. `import` is the conversion
in milliseconds and its error in sizes of the face, `prepare` the making of the nodes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import build123d as bd
import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.Geom import Geom_OffsetSurface
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.surface_feet import find_feet, make_surface_grid
from tpmscad.kernel.body_import.free_form_carriers import convert_free_form
from tpmscad.kernel.occt.bounding_boxes import box_diagonal

POINTS, KERNEL_POINTS = 20_000, 300
REACH = 0.1
REPEATS = 5


def side_faces(shape: Any, kind: Any) -> list[TopoDS_Face]:
    """Faces of a type, the largest first."""
    found = [face for face in shape.faces() if face.geom_type == kind]
    return [face.wrapped for face in sorted(found, key=lambda face: -face.area)]


def blade() -> TopoDS_Face:
    """A ruled loft between two quadratic arcs."""
    low = bd.Edge.make_bezier((0, 0, 0), (5, 3, 0), (10, 0, 0))
    high = bd.Edge.make_bezier((1, 1, 12), (5, 2.2, 13), (8, 2, 12))
    return bd.Face.make_surface_from_curves(low, high).wrapped


def cam() -> TopoDS_Face:
    profile = bd.Spline((9, 0), (4, 6), (-3, 7), (-9, 2), (-7, -5), (1, -6), periodic=True)
    return side_faces(bd.extrude(bd.make_face(profile), 13), bd.GeomType.EXTRUSION)[0]


def handle() -> TopoDS_Face:
    side = bd.Spline((8, 0), (9, 4), (6, 10), (4, 15))
    profile = bd.make_face([*bd.Polyline((4, 15), (0, 15), (0, 0), (8, 0)).edges(), side])
    return side_faces(bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z), bd.GeomType.REVOLUTION)[0]


def elbow() -> TopoDS_Face:
    path = bd.Spline((0, 0, 0), (0, 0, 8), (5, 2, 13), (12, 4, 14))
    profile = bd.Plane(origin=path @ 0, z_dir=path % 0) * bd.Ellipse(2.5, 1.6)
    return side_faces(bd.sweep(profile, path), bd.GeomType.BSPLINE)[0]


def wing() -> TopoDS_Face:
    """An extruded profile with a sharp nose: its radius is a hundredth of the chord."""
    profile = bd.Spline((20, 0.05), (12, 1.1), (4, 1.5), (0.5, 0.6), (0, 0), (0.5, -0.4), (4, -0.8), (20, -0.05))
    return bd.Face.extrude(profile, (0, 0, 30)).wrapped


def dome() -> TopoDS_Face:
    side = bd.Spline((7, 0), (5.5, 4), (0, 6.5), tangents=((0, 1), (-1, 0)))
    profile = bd.make_face([side, *bd.Polyline((0, 6.5), (0, 0), (7, 0)).edges()])
    return side_faces(bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z), bd.GeomType.REVOLUTION)[0]


def blend() -> TopoDS_Face:
    """A fillet on the edge between an elliptic prism and its end."""
    prism = bd.extrude(bd.Ellipse(8, 5), 6)
    edge = prism.edges().group_by(bd.Axis.Z)[-1]
    return side_faces(bd.fillet(edge, 1.2), bd.GeomType.BSPLINE)[0]


def offset() -> TopoDS_Face:
    surface = BRep_Tool.Surface_s(elbow())
    return BRepBuilderAPI_MakeFace(Geom_OffsetSurface(surface, 0.4), 1e-7).Face()


def tube() -> TopoDS_Face:
    """A loft through closed sections, with a seam."""
    sections = [
        bd.Pos(0, 0, z) * bd.Spline(*points, periodic=True)
        for z, points in (
            (0, [(4, 0), (0, 3), (-4, 0), (0, -3)]),
            (5, [(3, 0), (0, 3.4), (-3.5, 0), (0, -2.6)]),
            (11, [(4.5, 0.5), (0, 2.5), (-4, 0.5), (0, -3)]),
        )
    ]
    return side_faces(bd.loft([bd.make_face(s) for s in sections]), bd.GeomType.BSPLINE)[0]


def ellipsoid() -> TopoDS_Face:
    """Half an ellipse revolved: a pole at both ends."""
    half = bd.EllipticalCenterArc((0, 0), 6, 4, start_angle=-90, arc_size=180)
    profile = bd.make_face([half, bd.Line(half @ 1, half @ 0)])
    return side_faces(bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z), bd.GeomType.REVOLUTION)[0]


FACES: dict[str, Callable[[], TopoDS_Face]] = {
    "blade, ruled loft": blade,
    "cam, extrusion": cam,
    "handle, revolution": handle,
    "elbow, sweep": elbow,
    "wing, sharp nose": wing,
    "dome with a pole": dome,
    "blend, rational": blend,
    "offset of the elbow": offset,
    "tube with a seam": tube,
    "ellipsoid, two poles": ellipsoid,
}


def points_beside(carrier: FreeFormSurface, count: int, reach: float, rng: np.random.Generator) -> tuple[Array, ...]:
    """Points at up to `reach` from random points of the carrier, with these distances and normals."""
    uv = np.array([rng.uniform(*interval, count) for interval in carrier.domain])
    normal = carrier.normal(*uv)
    length = np.linalg.norm(normal, axis=1)
    kept = length > 1e-6 * length.max()
    normal, uv = normal[kept] / length[kept, None], uv[:, kept]
    distance = rng.uniform(-reach, reach, len(normal))
    return carrier(*uv) + distance[:, None] * normal, distance, normal


def kernel_distances(face: TopoDS_Face, carrier: FreeFormSurface, points: Array) -> tuple[Array, float]:
    """Distances of the kernel's nearest feet on the parameters of the carrier, inf for none, and microseconds per point."""
    surface = BRep_Tool.Surface_s(face)
    (u0, u1), (v0, v1) = carrier.domain
    found = np.full(len(points), np.inf)
    begun = time.process_time()
    for i, point in enumerate(points.tolist()):
        projection = GeomAPI_ProjectPointOnSurf(gp_Pnt(*point), surface, u0, u1, v0, v1)
        if projection.NbPoints():
            found[i] = projection.LowerDistance()
    return found, (time.process_time() - begun) / len(points) * 1e6


def rows(wanted: list[str]) -> Iterator[str]:
    """The lines of the table."""
    for name, make in FACES.items():
        if wanted and not any(part in name for part in wanted):
            continue
        rng = np.random.default_rng(7)
        face = make()
        size = box_diagonal(face)
        begun = time.process_time()
        converted = convert_free_form(face, size)
        read = time.process_time() - begun
        carrier = converted.carrier
        begun = time.process_time()
        grid = make_surface_grid(carrier.spline, carrier.closed, carrier.continuation)
        prepared = time.process_time() - begun
        points, distance, normal = points_beside(carrier, POINTS, REACH * size, rng)
        find_feet(grid, points[:10])
        seconds = np.inf
        for _ in range(REPEATS):
            begun = time.process_time()
            found = find_feet(grid, points)
            seconds = min(seconds, time.process_time() - begun)
        own = np.abs(np.abs(found.distance) - np.abs(distance)) < 1e-6 * size
        value = np.abs(found.distance - distance)[own].max() / size
        slope = np.abs(found.gradient - normal)[own].max()
        theirs, kernel = kernel_distances(face, carrier, points[:KERNEL_POINTS])
        ours = np.linalg.norm(carrier(*found.parameters[:KERNEL_POINTS].T) - points[:KERNEL_POINTS], axis=1)
        farther = (ours - theirs).max() / size
        us = seconds / len(points) * 1e6
        spline = carrier.spline
        yield (
            f"{name:22s}{spline.degree_u}x{spline.degree_v} {spline.poles.shape[0]:3d}x{spline.poles.shape[1]:<3d}"
            f"{grid.reach.size:6d}{us:7.2f}{own.mean():6.2f}{value:9.0e}{slope:8.0e}{kernel:8.0f}{kernel / us:6.0f}"
            f"{farther:9.0e}{read * 1e3:7.0f}{converted.error / size:8.0e}{prepared * 1e3:6.0f}"
        )


def main(wanted: list[str]) -> None:
    """Print the table."""
    print(
        "face                  deg  poles   nodes     us   own      |d|    grad  kernel ratio  farther import   error prep."
    )
    for line in rows(wanted):
        print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
