"""Faces, edges and vertices of an OCCT solid as an `ImportedBody` on exact surfaces: placed, and oriented outwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepTools import BRepTools_WireExplorer
from OCP.GeomAbs import (
    GeomAbs_BSplineCurve,
    GeomAbs_Circle,
    GeomAbs_Ellipse,
    GeomAbs_Line,
)
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse, Plane, Quadric
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.kernel.body_import.unrolled_faces import ImportedBody, ImportedEdge, ImportedFace, ImportedUse
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import axis_frame
from tpmscad.kernel.occt.exploration import ShapeKey, first_vertex, last_vertex, list_subshapes, orientation_sign
from tpmscad.kernel.recognise.edge_curves import (
    REFIT_SAMPLES,
    UnsupportedFace,
    fit_intersection_curve,
    project_to_carriers,
    recognise_line_or_circle,
)
from tpmscad.kernel.recognise.face_carriers import CHECK_SAMPLES, EXACT_REL_TOL, evaluate_mid_face, recognise_carrier
from tpmscad.splines.bspline import line_segment

VERTEX_REL_TOL = 1e-5
"""In body sizes: largest distance of an OCCT vertex from the common point of its faces' surfaces."""


def read_exact_body(faces: Sequence[TopoDS_Face], size: float) -> ImportedBody:
    """Body of the faces, which are oriented outwards; `size` sets the tolerances.

    Raises UnsupportedFace if a face or an edge cannot be represented exactly.
    """
    carriers = [recognise_carrier(face, size) for face in faces]
    edge_of: dict[ShapeKey, int] = {}
    vertex_of: dict[ShapeKey, int] = {}
    shapes: list[TopoDS_Edge] = []
    ends: list[tuple[int, int]] = []
    faces_of_edge: list[list[int]] = []
    loops_of = []
    for i, face in enumerate(faces):
        loops = []
        for wire in _wire_edges(face):
            loop = []
            for edge in wire:
                key = ShapeKey(edge)
                if key not in edge_of:
                    edge_of[key] = len(shapes)
                    forward = convert.as_edge(edge.Oriented(TopAbs_FORWARD))
                    shapes.append(forward)
                    vertices = [first_vertex(forward), last_vertex(forward)]
                    start, end = (vertex_of.setdefault(ShapeKey(v), len(vertex_of)) for v in vertices)
                    ends.append((start, end))
                    faces_of_edge.append([])
                e = edge_of[key]
                if i not in faces_of_edge[e]:
                    faces_of_edge[e].append(i)
                loop.append(ImportedUse(e, orientation_sign(edge)))
            loops.append(tuple(loop))
        loops_of.append(loops)
    faces_of_vertex: list[set[int]] = [set() for _ in vertex_of]
    for e, (start, end) in enumerate(ends):
        faces_of_vertex[start].update(faces_of_edge[e])
        faces_of_vertex[end].update(faces_of_edge[e])
    points = [np.array(BRep_Tool.Pnt_s(key.shape).Coord()) for key in vertex_of]
    vertices = [
        _exact_vertex(p, [carriers[i] for i in sorted(of)], size) for p, of in zip(points, faces_of_vertex, strict=True)
    ]
    edges = [
        ImportedEdge(*_exact_edge(shape, [carriers[i] for i in of], vertices[a], vertices[b], size), a, b)
        for shape, of, (a, b) in zip(shapes, faces_of_edge, ends, strict=True)
    ]
    result = []
    for i, (face, carrier, loops) in enumerate(zip(faces, carriers, loops_of, strict=True)):
        _, point, normal, _ = evaluate_mid_face(face)
        gradient_sense = 1 if normal @ carrier.gradient(point) > 0 else -1
        if gradient_sense < 0:
            loops = [tuple(ImportedUse(u.edge, -u.sense) for u in reversed(loop)) for loop in loops]
        outward = gradient_sense * orientation_sign(face)
        result.append(ImportedFace(carrier, outward, tuple(loops), i))
    return ImportedBody(tuple(vertices), tuple(edges), tuple(result), size)


def _wire_edges(face: TopoDS_Face) -> list[list[TopoDS_Edge]]:
    """Edges of the face loop by loop, counter-clockwise about S_u x S_v of OCCT, without degenerate edges."""
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    loops = []
    for shape in list_subshapes(forward, TopAbs_WIRE):
        wire = convert.as_wire(shape)
        walk, loop = BRepTools_WireExplorer(wire, forward), []
        while walk.More():
            loop.append(walk.Current())
            walk.Next()
        if len(loop) != len(list_subshapes(wire, TopAbs_EDGE)):
            raise UnsupportedFace("has a wire whose edges are not connected in order")
        loop = [edge for edge in loop if not BRep_Tool.Degenerated_s(edge)]
        if loop:
            loops.append(loop)
    return loops


def _exact_vertex(point: Array, carriers: Sequence[Plane | Quadric], size: float) -> Array:
    """Common point of the surfaces closest to the OCCT vertex."""
    exact = project_to_carriers(carriers, point[None])[0]
    if np.linalg.norm(exact - point) > VERTEX_REL_TOL * size:
        raise UnsupportedFace(f"shares no point with its neighbouring faces near {point.round(6)}")
    return exact


def _exact_edge(
    shape: TopoDS_Edge, carriers: Sequence[Plane | Quadric], start: Array, end: Array, size: float
) -> tuple[EdgeCurve, tuple[float, float]]:
    """Curve and span of an edge, within EXACT_REL_TOL of all its surfaces, from its start to its end vertex."""
    adaptor = BRepAdaptor_Curve(shape)
    low, high = adaptor.FirstParameter(), adaptor.LastParameter()
    tol = EXACT_REL_TOL * size
    curve = _occt_conic(adaptor)
    if curve is not None:
        span = (
            float(project_to_curve(curve, (low, low), start[None])[0][0]),
            float(project_to_curve(curve, (high, high), end[None])[0][0]),
        )
        if _max_distance(curve(np.linspace(*span, CHECK_SAMPLES)), carriers) <= tol:
            if isinstance(curve, Circle | Ellipse):
                return curve, span
            length = float(np.linalg.norm(curve(span[1]) - curve(span[0])))
            return line_segment(curve(span[0]), curve(span[1]), (0.0, length)), (0.0, length)
    breaks = [low, high]
    if adaptor.GetType() == GeomAbs_BSplineCurve:
        spline = adaptor.BSpline()
        knots = [spline.Knot(i) for i in range(1, spline.NbKnots() + 1)]
        breaks = [low, *[k for k in knots if low < k < high], high]
    each = max(4, REFIT_SAMPLES // (len(breaks) - 1))
    t = np.unique(np.concatenate([np.linspace(a, b, each) for a, b in zip(breaks[:-1], breaks[1:], strict=True)]))
    points = project_to_carriers(carriers, np.array([adaptor.Value(s).Coord() for s in t.tolist()]))
    points[[0, -1]] = start, end
    known = recognise_line_or_circle(points, tol)
    if known is not None:
        return known
    if len(carriers) != 2:
        raise UnsupportedFace("has a seam that is neither a line nor a circle")
    fit = fit_intersection_curve(
        carriers[0], carriers[1], points, tol / 4
    )  # the rest of the tolerance is left to its pcurves
    return fit, fit.domain


def _occt_conic(adaptor: BRepAdaptor_Curve) -> EdgeCurve | None:
    """Line (unit speed, parameters 0 to 1), circle or ellipse with the parameter of the OCCT curve; else None."""
    kind = adaptor.GetType()
    if kind == GeomAbs_Line:
        start, along = np.array(adaptor.Line().Location().Coord()), np.array(adaptor.Line().Direction().Coord())
        return line_segment(start, start + along)
    if kind == GeomAbs_Circle:
        return Circle(*axis_frame(adaptor.Circle()), adaptor.Circle().Radius())
    if kind == GeomAbs_Ellipse:
        return Ellipse(*axis_frame(adaptor.Ellipse()), adaptor.Ellipse().MajorRadius(), adaptor.Ellipse().MinorRadius())
    return None


def _max_distance(points: Array, carriers: Sequence[Plane | Quadric]) -> float:
    """Largest distance of the points from any of the carriers."""
    return max(float(np.abs(c.distance(points)).max()) for c in carriers)
