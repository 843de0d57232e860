"""OCCT vertices, edges and pcurves of a boundary representation; `solids` builds faces on them.

A straight edge that lies on planes and quadrics only becomes a line with unit speed. An edge on a spline patch keeps the
parameter of its curve, which its pcurve shares.

Where a loop passes a pole of a sphere or of a spline surface, or the apex of a cone, OCCT requires a degenerate edge. A boundary
representation has no edge there: consecutive half-edges of the loop meet at the vertex with different u, and the step along
v = const between them is implicit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.Geom2d import Geom2d_Curve
from OCP.gp import gp_Trsf
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_REVERSED
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Vertex

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, sample_edges
from tpmscad.brep.carriers import Carrier, Circle, ConicalSurface, Ellipse, SphericalSurface, ToroidalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.quadrics import MIN_POLE_STEP_ANGLE
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment

UNIT_SPEED_TOL = 1e-12
"""Deviation from unit speed up to which a straight pcurve becomes an OCCT line, which has unit speed."""


def build_vertices(builder: BRep_Builder, brep: Brep) -> list[TopoDS_Vertex]:
    """OCCT vertices, each with a tolerance that covers the ends of its edges."""
    vertices = []
    for position, tolerance in zip(brep.vertices, vertex_tolerances(brep).tolist(), strict=True):
        vertex = TopoDS_Vertex()
        builder.MakeVertex(vertex, convert.point(position), tolerance)
        vertices.append(vertex)
    return vertices


def build_edges(builder: BRep_Builder, brep: Brep, vertices: list[TopoDS_Vertex]) -> list[TopoDS_Edge]:
    """OCCT edges with vertices, 3-D curves and ranges; their pcurves are added with the faces."""
    reversed_vertices = [vertex.Reversed() for vertex in vertices]
    edges = brep.edges
    moves = build_transforms(edges.motion)
    curves = [convert.curve(c) for c in brep.curves]
    straight = set(straight_edges(brep).tolist())
    tolerance = np.maximum(CONFUSION_TOLERANCE, edges.deviation).tolist()
    result = []
    spans, ends = (
        (edges.span + conic_range_shifts(brep)[:, None]).tolist(),
        np.column_stack([edges.start, edges.end]).tolist(),
    )
    for i, index in enumerate(edges.curve.tolist()):
        edge = TopoDS_Edge()
        start, end = ends[i]
        low, high = spans[i]
        if i in straight:
            a, b = brep.vertices[start], brep.vertices[end]
            builder.MakeEdge(edge, convert.line(a, b), tolerance[i])
            low, high = 0.0, float(np.linalg.norm(b - a))
        else:
            builder.MakeEdge(edge, curves[index].Transformed(moves[i]), tolerance[i])
        builder.Add(edge, vertices[start])
        builder.Add(edge, reversed_vertices[end])
        builder.Range(edge, low, high)
        result.append(edge)
    return result


def build_pcurves(brep: Brep) -> list[Geom2d_Curve | None]:
    """Pcurve of each edge use, None on planes.

    Pcurves of straight edges are parametrised by the distance from the start of the edge.
    """
    edges, uses = brep.edges, brep.uses
    straight = set(straight_edges(brep).tolist())
    on_patch = np.array([isinstance(c, BSplineSurface) for c in brep.carriers], bool)[brep.faces.carrier]
    shift = conic_range_shifts(brep).tolist()
    known: dict[tuple[int, bool, float], Geom2d_Curve] = {}
    result: list[Geom2d_Curve | None] = []
    for e, p, patch in zip(uses.edge.tolist(), uses.pcurve.tolist(), on_patch[brep.face_of_use].tolist(), strict=True):
        if p < 0:
            result.append(None)
        elif e in straight:
            result.append(convert.line_2d(*brep.pcurves[p](edges.span[e])))
        else:
            key = p, patch, shift[e]
            if key not in known:
                curve = brep.pcurves[p]
                curve = BSplineCurve(curve.poles, curve.knots + shift[e], curve.degree) if shift[e] else curve
                known[key] = convert.curve_2d(curve) if patch else _line_or_spline(curve)
            result.append(known[key])
    return result


def build_transforms(motion: Motion) -> list[gp_Trsf]:
    """OCCT transformation of each placed item; equal motions share one object."""
    rows = np.concatenate([motion.rotation, motion.translation[:, :, None]], axis=2).reshape(-1, 12)
    known: dict[tuple[float, ...], gp_Trsf] = {}
    result = []
    for row in map(tuple, rows.tolist()):
        if row not in known:
            known[row] = convert.transformation(row)
        result.append(known[row])
    return result


def straight_edges(brep: Brep) -> IntArray:
    """Indices of the straight edges that lie on planes and quadrics only.

    Pcurves on these surfaces can follow a change of parameter, so that such edges become lines with unit speed.
    """
    straight = np.array([is_segment(c) for c in brep.curves], bool)[brep.edges.curve]
    fixed = np.array([isinstance(c, BSplineSurface) for c in brep.carriers], bool)[brep.faces.carrier]
    straight[brep.uses.edge[fixed[brep.face_of_use]]] = False
    return np.flatnonzero(straight)


def conic_range_shifts(brep: Brep) -> Array:
    """Multiple of 2 pi to add to each edge's parameter (E,): conics start in [0, 2 pi); 0 for all other curves.

    OCCT takes an edge on a circle for another arc of it if its whole range is negative.
    """
    conic = np.array([isinstance(c, Circle | Ellipse) for c in brep.curves], bool)[brep.edges.curve]
    return np.where(conic, -TWO_PI * np.floor(brep.edges.span[:, 0] / TWO_PI), 0.0)


def _line_or_spline(curve: BSplineCurve) -> Geom2d_Curve:
    """Pcurve on a quadric: an OCCT line if it is straight with unit speed, else a B-spline."""
    low, high = curve.domain
    start, end = curve([low, high])
    speed = float(np.linalg.norm(end - start)) / (high - low)
    if not is_segment(curve) or abs(speed - 1.0) > UNIT_SPEED_TOL:
        return convert.curve_2d(curve)
    return convert.line_2d(start - low * (end - start) / (high - low), end)


def vertex_tolerances(brep: Brep) -> Array:
    """Tolerance of each vertex (V,): it covers the ends and the deviations of its edges."""
    edges = brep.edges
    tolerance = np.full(len(brep.vertices), CONFUSION_TOLERANCE)
    for vertex, miss in zip((edges.start, edges.end), end_misses(brep).T, strict=True):
        np.maximum.at(tolerance, vertex, np.maximum(miss, edges.deviation))
    return tolerance


def end_misses(brep: Brep) -> Array:
    """Distances of the vertices from the ends of the curves of their edges: (E, 2)."""
    vertices = brep.vertices[np.stack([brep.edges.start, brep.edges.end], axis=1)]
    return np.asarray(np.linalg.norm(vertices - sample_edges(brep, 2), axis=2))


@dataclass(frozen=True, slots=True)
class PoleStep:
    """Step of a loop along a pole at `vertex`, from (start, v) to (end, v)."""

    vertex: int
    start: float
    end: float
    v: float


def find_pole_steps(brep: Brep) -> dict[int, PoleStep]:
    """Pole step after each half-edge that ends at a pole and whose successor starts at a different u."""
    edges, uses, faces = brep.edges, brep.uses, brep.faces
    steps = {}
    has_pole = np.array([_has_pole(c) for c in brep.carriers], bool)[faces.carrier]
    for face in np.flatnonzero(has_pole).tolist():
        for loop in range(int(faces.loop_start[face]), int(faces.loop_start[face + 1])):
            members = list(range(int(faces.use_start[loop]), int(faces.use_start[loop + 1])))
            ends = [_use_end_parameters(brep, k) for k in members]
            for i, k in enumerate(members):
                (u, v), (then, _) = ends[i][1], ends[(i + 1) % len(members)][0]
                if abs(then - u) > MIN_POLE_STEP_ANGLE:
                    e = uses.edge[k]
                    vertex = edges.end[e] if uses.sense[k] > 0 else edges.start[e]
                    steps[k] = PoleStep(int(vertex), u, then, v)
    return steps


def _has_pole(carrier: Carrier) -> bool:
    """Whether a line v = const of the carrier is a point."""
    if isinstance(carrier, BSplineSurface):
        return bool(find_point_sides(carrier)[[0, 2]].any())
    if isinstance(carrier, ToroidalSurface):
        return carrier.major < carrier.minor
    return isinstance(carrier, SphericalSurface | ConicalSurface)


def _use_end_parameters(brep: Brep, use: int) -> list[list[float]]:
    """(u, v) at the start and at the end of a half-edge."""
    span = brep.edges.span[brep.uses.edge[use]]
    ends: list[list[float]] = brep.pcurves[brep.uses.pcurve[use]](span).tolist()
    return ends if brep.uses.sense[use] > 0 else ends[::-1]


def make_degenerate_edge(
    builder: BRep_Builder, face: TopoDS_Face, vertex: TopoDS_Vertex, step: PoleStep, tolerance: float
) -> TopoDS_Edge:
    """Edge from the vertex to itself without a 3-D curve, along increasing u, oriented as the loop uses it."""
    low, high = min(step.start, step.end), max(step.start, step.end)
    edge = TopoDS_Edge()
    builder.MakeEdge(edge)
    builder.UpdateEdge(edge, convert.line_2d(np.array([0.0, step.v]), np.array([1.0, step.v])), face, tolerance)
    builder.Add(edge, vertex.Oriented(TopAbs_FORWARD))
    builder.Add(edge, vertex.Oriented(TopAbs_REVERSED))
    builder.Range(edge, low, high)
    builder.Degenerated(edge, True)
    return convert.as_edge(edge.Oriented(TopAbs_FORWARD if step.end > step.start else TopAbs_REVERSED))
