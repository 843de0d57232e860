"""Faces, edges and vertices of an OCCT solid as an `ImportedBody` on exact surfaces: placed, and oriented outwards."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.GeomAbs import (
    GeomAbs_BSplineCurve,
    GeomAbs_Circle,
    GeomAbs_Ellipse,
    GeomAbs_Line,
)
from OCP.TopAbs import TopAbs_FORWARD
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse, Plane
from tpmscad.brep.curve_recognition import recognise_line_or_circle
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.orthogonal_projection import project_to_curve
from tpmscad.brep.surface_correction import correct_surface
from tpmscad.kernel.body_import.crease_splitting import WiredFace
from tpmscad.kernel.body_import.free_form_carriers import convert_curve, convert_free_form
from tpmscad.kernel.body_import.gap_closing import (
    MAX_GAP_REL,
    MAX_MOVE_GAPS,
    Allowance,
    are_tangent_quadrics,
    close_edge,
    close_vertex,
    largest_miss,
    plane_through_seam,
)
from tpmscad.kernel.body_import.unrolled_faces import ImportedBody, ImportedEdge, ImportedFace, ImportedUse
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import axis_frame
from tpmscad.kernel.occt.exploration import ShapeKey, first_vertex, last_vertex, orientation_sign
from tpmscad.kernel.recognise.edge_curves import (
    POLE_REL_TOL,
    REFIT_SAMPLES,
    UnsupportedFace,
    fit_intersection_curve,
    is_at_pole,
    project_to_carriers,
)
from tpmscad.kernel.recognise.face_carriers import CHECK_SAMPLES, EXACT_REL_TOL, evaluate_mid_face, recognise_carrier
from tpmscad.splines.bspline import is_segment, isoparametric_curve, line_segment

VERTEX_REL_TOL = 1e-5
"""In body sizes: largest distance of an OCCT vertex from the common point of its faces' surfaces."""


CONTINUATION_REL = 0.02
"""In body sizes: how far a carrier goes on beyond the border of the kernel's surface, at most. An intersection curve is followed
beyond an edge of the body by a few steps of its marching grid."""


EXACT = Allowance()
"""Nothing but round-off is left."""


def read_exact_body(
    parts: Sequence[WiredFace], size: float, free_form: bool = False, allowance: Allowance = EXACT
) -> ImportedBody:
    """Body of faces without creases, which are oriented outwards; `size` sets the tolerances.

    Faces that are neither planes nor quadrics are taken, and gaps between faces closed, if `free_form` is set; what is left of
    them is carried by the edges, within the allowance. Raises UnsupportedFace if a face or an edge cannot be represented so.
    """
    carriers = [_read_carrier(part.face, size, free_form) for part in parts]
    edge_of: dict[ShapeKey, int] = {}
    vertex_of: dict[ShapeKey, int] = {}
    shapes: list[TopoDS_Edge] = []
    ends: list[tuple[int, int]] = []
    faces_of_edge: list[list[int]] = []
    loops_of = []
    for i, part in enumerate(parts):
        loops = []
        for wire in part.loops:
            loop = []
            for edge in wire:
                if BRep_Tool.Degenerated_s(edge):
                    continue
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
            if loop:
                loops.append(tuple(loop))
        loops_of.append(loops)
    faces_of_vertex: list[set[int]] = [set() for _ in vertex_of]
    for e, (start, end) in enumerate(ends):
        faces_of_vertex[start].update(faces_of_edge[e])
        faces_of_vertex[end].update(faces_of_edge[e])
    points = [np.array(BRep_Tool.Pnt_s(key.shape).Coord()) for key in vertex_of]
    move = 0.0
    if free_form:
        wires = _Wires(shapes, ends, faces_of_edge, points, faces_of_vertex)
        vertices, curves, carriers, move = _close_gaps(wires, carriers, size, allowance)
    else:
        vertices = [
            _exact_vertex(p, [carriers[i] for i in sorted(of)], size)
            for p, of in zip(points, faces_of_vertex, strict=True)
        ]
        curves = [
            _exact_edge(shape, [carriers[i] for i in of], vertices[a], vertices[b], size)
            for shape, of, (a, b) in zip(shapes, faces_of_edge, ends, strict=True)
        ]
        for (curve, span), of in zip(curves, faces_of_edge, strict=True):
            if not _has_kind_of_tangent_edge(curve, span, [carriers[i] for i in of]):
                raise UnsupportedFace(
                    f"is tangent to its neighbour along no line or circle near {curve(span[0]).round(6)}"
                )
    edges = [ImportedEdge(*curve, a, b) for curve, (a, b) in zip(curves, ends, strict=True)]
    result = []
    for i, (part, carrier, loops) in enumerate(zip(parts, carriers, loops_of, strict=True)):
        _, point, normal, _ = evaluate_mid_face(part.face)
        gradient_sense = 1 if normal @ carrier.gradient(point) > 0 else -1
        if gradient_sense < 0:
            loops = [tuple(ImportedUse(u.edge, -u.sense) for u in reversed(loop)) for loop in loops]
        outward = gradient_sense * orientation_sign(part.face)
        result.append(ImportedFace(carrier, outward, tuple(loops), i))
    return ImportedBody(tuple(vertices), tuple(edges), tuple(result), size, move)


@dataclass(frozen=True, slots=True, eq=False)
class _Wires:
    """The kernel's edges with the numbers of their vertices and faces, and its vertices with the numbers of their faces."""

    edges: list[TopoDS_Edge]
    ends: list[tuple[int, int]]
    faces_of_edge: list[list[int]]
    points: list[Array]
    faces_of_vertex: list[set[int]]


_Curve = tuple[EdgeCurve, tuple[float, float]]


def _close_gaps(
    wires: _Wires, carriers: list[BodyCarrier], size: float, allowance: Allowance
) -> tuple[list[Array], list[_Curve], list[BodyCarrier], float]:
    """Vertices, curves of edges and carriers, which meet, and the largest move of a face."""
    tol = EXACT_REL_TOL * size
    paths = [_sample_curve(shape) for shape in wires.edges]
    vertices = _close_vertices(wires, carriers, paths, size, allowance)
    curves: list[_Curve | None] = []
    for shape, of, (a, b), path in zip(wires.edges, wires.faces_of_edge, wires.ends, paths, strict=True):
        own, start, end = [carriers[i] for i in of], vertices[a], vertices[b]
        if len(own) == 1 and isinstance(own[0], FreeFormSurface):
            curves.append(None)  # a seam follows its surface
            continue
        curve = None
        if largest_miss(np.stack([start, end]), own) <= tol:
            with contextlib.suppress(UnsupportedFace, ValueError):
                curve = _exact_edge(shape, own, start, end, size)
        if curve is None or not _has_kind_of_tangent_edge(*curve, own):
            curve = close_edge(path, own, start, end, tol, size, allowance)
            gap = largest_miss(path, own)
            if (
                largest_miss(curve[0](np.linspace(*curve[1], len(path))), own) > MAX_MOVE_GAPS * gap
                and gap <= allowance.length
            ):
                # surfaces that are nearly tangent meet far away, or the edge is rough: its gap is the least that can be carried
                curve = _occt_spline(BRepAdaptor_Curve(shape), own, start, end, tol, MAX_MOVE_GAPS * gap) or curve
        curves.append(curve)
    found, move = list(carriers), 0.0
    for i, carrier in enumerate(carriers):
        if isinstance(carrier, FreeFormSurface):
            border = [c for c, of in zip(curves, wires.faces_of_edge, strict=True) if i in of and c is not None]
            found[i], moved = _close_face(carrier, border, size, allowance)
            move = max(move, moved)
    result = []
    for e, curve in enumerate(curves):
        if curve is None:
            start, end = (vertices[v] for v in wires.ends[e])
            curve = _exact_edge(wires.edges[e], [found[i] for i in wires.faces_of_edge[e]], start, end, size)
        result.append(curve)
    return vertices, result, found, move


def _has_kind_of_tangent_edge(curve: EdgeCurve, span: tuple[float, float], carriers: list[BodyCarrier]) -> bool:
    """Whether an edge between tangent planes and quadrics is a line or a circle, as it must be; True for other edges.

    A curve that a file has rounded lies on both surfaces to second order only.
    """
    if isinstance(curve, Circle) or is_segment(curve):
        return True
    return not are_tangent_quadrics(carriers, curve(np.linspace(*span, CHECK_SAMPLES)))


def _close_vertices(
    wires: _Wires, carriers: list[BodyCarrier], paths: list[Array], size: float, allowance: Allowance
) -> list[Array]:
    """The vertices: common points of their surfaces, or what comes nearest."""
    tips: list[list[Array]] = [[] for _ in wires.points]
    seams: list[list[tuple[Plane, bool]]] = [[] for _ in wires.points]  # with marks of those of free-form surfaces
    for (start, end), of, path in zip(wires.ends, wires.faces_of_edge, paths, strict=True):
        for vertex, tip, beside in ((start, path[0], path[1]), (end, path[-1], path[-2])):
            tips[vertex].append(tip)
            at_pole = (
                len(of) == 1 and is_at_pole(carriers[of[0]], tip[None], size)[0]
            )  # which is the vertex, without a plane
            if len(of) == 1 and not at_pole and np.linalg.norm(beside - tip) > 0:
                plane = plane_through_seam(carriers[of[0]], tip, beside - tip)
                seams[vertex].append((plane, isinstance(carriers[of[0]], FreeFormSurface)))
    vertices = []
    for point, of, ends, planes in zip(wires.points, wires.faces_of_vertex, tips, seams, strict=True):
        own = [carriers[i] for i in sorted(of)]
        with contextlib.suppress(UnsupportedFace):
            vertex = _exact_vertex(point, own, size)
            soft = [plane for plane, is_soft in planes if is_soft]
            if largest_miss(vertex[None], own) <= EXACT_REL_TOL * size and (
                not soft or largest_miss(vertex[None], soft) <= SEAM_REL_TOL * size
            ):
                vertices.append(vertex)
                continue
        vertices.append(close_vertex(np.mean(ends, axis=0), own, [plane for plane, _ in planes], size, allowance))
    return vertices


def _close_face(
    carrier: FreeFormSurface, border: list[_Curve], size: float, allowance: Allowance
) -> tuple[FreeFormSurface, float]:
    """The surface of a face corrected so that its edges are on it, and how far it was moved.

    A surface that would have to move by more than is allowed stays as it is: its edges carry the gap.
    """
    points = [curve(np.linspace(*span, CORRECTION_SAMPLES)) for curve, span in border]
    if not points or largest_miss(np.concatenate(points), [carrier]) <= EXACT_REL_TOL * size:
        return carrier, 0.0
    corrected = correct_surface(carrier, np.concatenate(points), CLOSED_REL_TOL * size)
    between = np.concatenate([curve(np.linspace(*span, 2 * CORRECTION_SAMPLES)) for curve, span in border])
    gap = largest_miss(between, [carrier])
    off = np.abs(corrected.surface.distance(between))
    left, place = float(off.max()), between[off.argmax()].round(6)
    if corrected.move > max(MAX_MOVE_GAPS * gap, allowance.length):
        words = f"would have to move by {corrected.move:.2g} to close a gap of {gap:.2g} near {between[0].round(6)}"
        allowance.require(gap, 0.0, words)
        return carrier, 0.0
    if left > MAX_LEFT_REL * size:
        words = f"could not be moved onto its edges: {min(left, gap):.2g} is left near {place}"
        allowance.require(min(left, gap), MAX_LEFT_REL * size, words)
        if gap <= left:
            return carrier, 0.0
    return corrected.surface, corrected.move


CORRECTION_SAMPLES = 241
"""Points of each edge through which the surface of its face is to pass."""

CLOSED_REL_TOL = 5e-10
"""In body sizes: distance of edges from a corrected surface at which it is good enough."""

MAX_LEFT_REL = 1e-8
"""In body sizes: the greatest distance that is taken. It is written into the tolerances of edges."""


def _read_carrier(face: TopoDS_Face, size: float, free_form: bool) -> BodyCarrier:
    """The plane or quadric of a face, else its free-form carrier if that is asked for.

    Raises UnsupportedFace if there is none, or none within EXACT_REL_TOL, or one with poles along both parameters.
    """
    try:
        return recognise_carrier(face, size)
    except UnsupportedFace:
        if not free_form:
            raise
    converted = convert_free_form(face, size)
    if converted.error > EXACT_REL_TOL * size:
        raise UnsupportedFace(f"is free-form, and its spline is {converted.error:.2g} off")
    carrier = replace(converted.carrier, continuation=CONTINUATION_REL * size)
    is_point = find_point_sides(carrier.spline)
    if is_point[[1, 3]].any():
        if is_point[[0, 2]].any():
            raise UnsupportedFace("is free-form with poles along both parameters")
        # the poles lie across v then, as those of a sphere
        carrier = replace(carrier, spline=carrier.spline.turned(1), closed=carrier.closed[::-1])
    return carrier


def _exact_vertex(point: Array, carriers: Sequence[BodyCarrier], size: float) -> Array:
    """Common point of the surfaces closest to the OCCT vertex, or the pole of a free-form one that is there."""
    poles = [p for c in carriers if isinstance(c, FreeFormSurface) for _, p in c.poles_across_v()]
    for pole in poles:
        if np.linalg.norm(pole - point) <= POLE_REL_TOL * size:
            return pole
    exact = project_to_carriers(carriers, point[None])[0]
    if np.linalg.norm(exact - point) > VERTEX_REL_TOL * size:
        raise UnsupportedFace(f"shares no point with its neighbouring faces near {point.round(6)}")
    return exact


def _exact_edge(
    shape: TopoDS_Edge, carriers: Sequence[BodyCarrier], start: Array, end: Array, size: float
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
        if largest_miss(curve(np.linspace(*span, CHECK_SAMPLES)), carriers) <= tol:
            if isinstance(curve, Circle | Ellipse):
                return curve, span
            length = float(np.linalg.norm(curve(span[1]) - curve(span[0])))
            return line_segment(curve(span[0]), curve(span[1]), (0.0, length)), (0.0, length)
    if any(isinstance(c, FreeFormSurface) for c in carriers):
        spline_edge = _occt_spline(adaptor, carriers, start, end, tol, tol)
        if spline_edge is not None:
            return spline_edge
        if len(carriers) == 1 and isinstance(carriers[0], FreeFormSurface):
            t = np.linspace(low, high, CHECK_SAMPLES)
            return _seam_curve(carriers[0], np.array([adaptor.Value(s).Coord() for s in t.tolist()]), start, end, size)
    points = project_to_carriers(carriers, _sample_curve(shape))
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


SAMPLES_PER_DEGREE = 8
"""Points in each span of a spline of a degree: a span of degree 13 may be a whole turn of a helix."""


def _sample_curve(shape: TopoDS_Edge) -> Array:
    """Points (m, 3) along the kernel's curve of an edge, several in each of its spans."""
    adaptor = BRepAdaptor_Curve(shape)
    breaks, degree = [adaptor.FirstParameter(), adaptor.LastParameter()], 1
    if adaptor.GetType() == GeomAbs_BSplineCurve:
        spline = adaptor.BSpline()
        knots = [spline.Knot(i) for i in range(1, spline.NbKnots() + 1)]
        breaks = [breaks[0], *[k for k in knots if breaks[0] < k < breaks[1]], breaks[1]]
        degree = spline.Degree()
    each = max(SAMPLES_PER_DEGREE * degree, REFIT_SAMPLES // (len(breaks) - 1))
    t = np.unique(np.concatenate([np.linspace(a, b, each) for a, b in zip(breaks[:-1], breaks[1:], strict=True)]))
    return np.array([adaptor.Value(s).Coord() for s in t.tolist()])


def _occt_spline(
    adaptor: BRepAdaptor_Curve, carriers: Sequence[BodyCarrier], start: Array, end: Array, tol: float, within: float
) -> tuple[EdgeCurve, tuple[float, float]] | None:
    """The kernel's own curve as a polynomial spline to `tol`, and its span, if it is `within` of the surfaces and vertices."""
    low, high = adaptor.FirstParameter(), adaptor.LastParameter()
    curve = None
    if adaptor.GetType() == GeomAbs_BSplineCurve:
        geometry = adaptor.BSpline().Copy()
        if geometry.IsPeriodic():
            geometry.SetNotPeriodic()
        if not geometry.IsRational() and geometry.FirstParameter() <= low and geometry.LastParameter() >= high:
            curve = convert.curve_from_occt(geometry)
    if curve is None:
        curve = convert_curve(adaptor, tol / 4)
    if curve is None:
        return None
    if np.abs(curve([low, high]) - np.stack([start, end])).max() > within:
        return None
    ends = curve.knots[(curve.knots > low) & (curve.knots < high)]
    t = np.unique(np.concatenate([np.linspace(low, high, REFIT_SAMPLES), ends]))
    return (curve, (low, high)) if largest_miss(curve(t), carriers) <= within else None


SEAM_REL_TOL = 1e-6
"""In body sizes: largest distance of the vertices of a seam from a line of the carrier."""


def _seam_curve(
    carrier: FreeFormSurface, points: Array, start: Array, end: Array, size: float
) -> tuple[EdgeCurve, tuple[float, float]]:
    """The line of constant parameter along which points (m, 3) of a seam lie, from the vertex `start` to `end`."""
    uv = carrier.parameters(points)
    for axis, period in enumerate(carrier.period):
        if not period:
            continue
        (low, _), along = carrier.domain[axis], uv[:, 1 - axis]
        off = uv[:, axis] - low - period * np.round((uv[:, axis] - low) / period)
        across = np.linalg.norm(carrier(uv[:, 0], uv[:, 1], int(axis == 0), int(axis == 1)), axis=1)
        if (np.abs(off) * across).max() > MAX_GAP_REL * size:
            continue
        curve = isoparametric_curve(carrier.spline, axis, low)
        if along[-1] < along[0]:
            curve = curve.reversed()
        ends, apart = project_to_curve(curve, curve.domain, np.stack([start, end]))
        if apart.max() <= SEAM_REL_TOL * size:
            return curve, (float(ends[0]), float(ends[1]))
    raise UnsupportedFace("has a seam that is no line of its parameters")


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
