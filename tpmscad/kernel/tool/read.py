"""A kernel solid's faces, edges and vertices read out as a `Body`: placed, with outward sides, on their exact surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.GeomAbs import (
    GeomAbs_BSplineCurve,
    GeomAbs_Circle,
    GeomAbs_Cone,
    GeomAbs_Cylinder,
    GeomAbs_Ellipse,
    GeomAbs_Line,
    GeomAbs_Plane,
    GeomAbs_Sphere,
    GeomAbs_Torus,
)
from OCP.gp import gp_Cone, gp_Cylinder, gp_Pln, gp_Pnt, gp_Sphere, gp_Vec
from OCP.ShapeAnalysis import ShapeAnalysis_CanonicalRecognition
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_REVERSED, TopAbs_WIRE
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape

from tpmscad.kernel import convert
from tpmscad.kernel.edge_nodes import EdgeKey
from tpmscad.kernel.tool.body import Body, Edge, Face, Refused, Use
from tpmscad.kernel.tool.edges import DENSE, intersection, nearest, onto, recognised
from tpmscad.patches.carriers import Circle, Cone, Cylinder, EdgeCurve, Ellipse, Plane, Quadric, Sphere, Torus
from tpmscad.patches.complex import Array
from tpmscad.splines.bspline import line

EXACT = 1e-10
"""Of the body's size: what an edge may be off its surfaces, and a surface off the plane or quadric it is taken for."""

SAMPLES = 9
"""Points along an edge, and along either parameter of a face, where what is taken for exact is measured."""

FAR = 1e-5
"""Of the body's size: a vertex that is farther from its faces' common point is not one of this body's."""


def read(faces: Sequence[TopoDS_Face], size: float) -> Body:
    """The faces, with the orientation that makes them look outwards, as a body of that size.

    Refused where a face, or an edge, is not what a patch complex can hold exactly.
    """
    carriers = [carrier_of(face, size) for face in faces]
    edge_of: dict[EdgeKey, int] = {}
    vertex_of: dict[EdgeKey, int] = {}
    shapes: list[TopoDS_Edge] = []
    ends: list[tuple[int, int]] = []
    beside: list[list[int]] = []
    loops_of = []
    for i, face in enumerate(faces):
        loops = []
        for wire in _loops(face):
            loop = []
            for edge in wire:
                key = EdgeKey(edge)
                if key not in edge_of:
                    edge_of[key] = len(shapes)
                    forward = convert.as_edge(edge.Oriented(TopAbs_FORWARD))
                    shapes.append(forward)
                    vertices = [convert.first_vertex(forward), convert.last_vertex(forward)]
                    start, end = (vertex_of.setdefault(EdgeKey(v), len(vertex_of)) for v in vertices)
                    ends.append((start, end))
                    beside.append([])
                e = edge_of[key]
                if i not in beside[e]:
                    beside[e].append(i)
                loop.append(Use(e, -1 if edge.Orientation() == TopAbs_REVERSED else 1))
            loops.append(tuple(loop))
        loops_of.append(loops)
    around: list[set[int]] = [set() for _ in vertex_of]
    for e, (start, end) in enumerate(ends):
        around[start].update(beside[e])
        around[end].update(beside[e])
    points = [np.array(BRep_Tool.Pnt_s(key.edge).Coord()) for key in vertex_of]
    vertices = [_vertex(p, [carriers[i] for i in sorted(of)], size) for p, of in zip(points, around, strict=True)]
    edges = [
        Edge(*_edge(shape, [carriers[i] for i in of], vertices[a], vertices[b], size), a, b)
        for shape, of, (a, b) in zip(shapes, beside, ends, strict=True)
    ]
    result = []
    for i, (face, carrier, loops) in enumerate(zip(faces, carriers, loops_of, strict=True)):
        _, point, normal, _ = middle(face)
        agree = 1 if normal @ carrier.gradient(point) > 0 else -1
        if agree < 0:
            loops = [tuple(Use(u.edge, -u.sense) for u in reversed(loop)) for loop in loops]
        outward = -agree if face.Orientation() == TopAbs_REVERSED else agree
        result.append(Face(carrier, outward, tuple(loops), i))
    return Body(tuple(vertices), tuple(edges), tuple(result), size)


def carrier_of(face: TopoDS_Face, size: float) -> Plane | Quadric:
    """The plane or quadric that the face lies on. Refused where there is none."""
    adaptor = BRepAdaptor_Surface(face, False)
    kind = adaptor.GetType()
    if kind == GeomAbs_Plane:
        return _plane(adaptor.Plane())
    if kind == GeomAbs_Cylinder:
        return _cylinder(adaptor.Cylinder())
    if kind == GeomAbs_Cone:
        return _cone(adaptor.Cone(), middle(face)[1])
    if kind == GeomAbs_Sphere:
        return _sphere(adaptor.Sphere())
    if kind == GeomAbs_Torus:
        torus = adaptor.Torus()
        if torus.MajorRadius() <= torus.MinorRadius():
            raise Refused("is a torus that meets itself")
        return Torus(*_frame(torus), torus.MajorRadius(), torus.MinorRadius())
    found = _in_disguise(face, size)
    if found is None:
        raise Refused(f"is free-form ({str(kind).split('_')[-1]}), neither plane nor quadric")
    return found


def _in_disguise(face: TopoDS_Face, size: float) -> Plane | Quadric | None:
    """The plane or quadric that a surface of another kind is, to EXACT."""
    recognition = ShapeAnalysis_CanonicalRecognition(face)
    points = _samples(face)
    pln, cylinder, cone, sphere = gp_Pln(), gp_Cylinder(), gp_Cone(), gp_Sphere()
    tol = EXACT * size
    for found in (
        lambda: _plane(pln) if recognition.IsPlane(tol, pln) else None,
        lambda: _cylinder(cylinder) if recognition.IsCylinder(tol, cylinder) else None,
        lambda: _cone(cone, middle(face)[1]) if recognition.IsCone(tol, cone) else None,
        lambda: _sphere(sphere) if recognition.IsSphere(tol, sphere) else None,
        lambda: _torus_through(points, tol),
        lambda: _torus_through(np.swapaxes(points, 0, 1), tol),
    ):
        carrier = found()
        if carrier is not None and np.abs(carrier.distance(points)).max() <= tol:
            return carrier
    return None


def _torus_through(points: Array, tol: float) -> Torus | None:
    """The torus around whose middle the rows of points (n, m, 3) are circles, which the kernel does not look for."""
    circles = [found[0] for found in (recognised(row, tol) for row in points) if found and isinstance(found[0], Circle)]
    if len(circles) < len(points):
        return None
    around = recognised(np.array([circle.origin for circle in circles]), tol)
    if around is None or not isinstance(around[0], Circle) or around[0].radius <= circles[0].radius:
        return None
    return Torus(around[0].origin, around[0].x_axis, around[0].normal, around[0].radius, circles[0].radius)


def _frame(value: object) -> tuple[Array, Array, Array]:
    frame = value.Position()  # type: ignore[attr-defined]
    return tuple(np.array(c.Coord()) for c in (frame.Location(), frame.XDirection(), frame.Direction()))  # type: ignore[return-value]


def _plane(value: gp_Pln) -> Plane:
    return Plane(*_frame(value))


def _cylinder(value: gp_Cylinder) -> Cylinder:
    return Cylinder(*_frame(value), value.Radius())


def _sphere(value: gp_Sphere) -> Sphere:
    return Sphere(*_frame(value), value.Radius())


def _cone(value: gp_Cone, point: Array) -> Cone:
    """The nappe that a point of the face is on; the kernel's cones have both."""
    origin, x_axis, axis = _frame(value)
    radius, angle = value.RefRadius(), value.SemiAngle()
    height = float((point - origin) @ axis)
    if radius + height * np.tan(angle) >= 0:
        return Cone(origin, x_axis, axis, radius, angle)
    from_apex = height + radius / np.tan(angle)
    away = np.sign(from_apex)
    return Cone(origin + height * axis, x_axis, away * axis, abs(from_apex * np.tan(angle)), abs(angle))


def middle(face: TopoDS_Face) -> tuple[tuple[float, float], Array, Array, Array]:
    """The kernel's (u, v) amid the face's, away from poles, the point there, S_u x S_v, and a point at a slightly larger u."""
    surface = BRepAdaptor_Surface(face, False)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    u, v = 0.47 * u0 + 0.53 * u1, 0.47 * v0 + 0.53 * v1
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    surface.D1(u, v, point, along_u, along_v)
    beside = surface.Value(u + 0.01 * (u1 - u0), v).Coord()
    return (u, v), np.array(point.Coord()), np.cross(along_u.Coord(), along_v.Coord()), np.array(beside)


def _samples(face: TopoDS_Face) -> Array:
    """Points on a grid of the face's parameters: (SAMPLES, SAMPLES, 3)."""
    surface = BRepAdaptor_Surface(face, False)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    grid = [surface.Value(u, v).Coord() for u in np.linspace(u0, u1, SAMPLES) for v in np.linspace(v0, v1, SAMPLES)]
    return np.array(grid).reshape(SAMPLES, SAMPLES, 3)


def _loops(face: TopoDS_Face) -> list[list[TopoDS_Edge]]:
    """The face's edges, loop by loop in order, counter-clockwise about the kernel's S_u x S_v; none at poles."""
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    loops = []
    wires = TopExp_Explorer(forward, TopAbs_WIRE)
    while wires.More():
        wire = convert.as_wire(wires.Current())
        wires.Next()
        walk, loop = BRepTools_WireExplorer(wire, forward), []
        while walk.More():
            loop.append(walk.Current())
            walk.Next()
        if len(loop) != _count(wire):
            raise Refused("has a border that can't be followed")
        loop = [edge for edge in loop if not BRep_Tool.Degenerated_s(edge)]
        if loop:
            loops.append(loop)
    return loops


def _count(shape: TopoDS_Shape) -> int:
    explorer, count = TopExp_Explorer(shape, TopAbs_EDGE), 0
    while explorer.More():
        count += 1
        explorer.Next()
    return count


def _vertex(point: Array, carriers: Sequence[Plane | Quadric], size: float) -> Array:
    """The faces' common point next to the kernel's vertex."""
    exact = onto(carriers, point[None])[0]
    if np.linalg.norm(exact - point) > FAR * size:
        raise Refused(f"has no common point with its neighbours near {point.round(6)}")
    return exact


def _edge(
    shape: TopoDS_Edge, carriers: Sequence[Plane | Quadric], start: Array, end: Array, size: float
) -> tuple[EdgeCurve, tuple[float, float]]:
    """The edge's curve and span, on all its carriers to EXACT, from one vertex to the other."""
    adaptor = BRepAdaptor_Curve(shape)
    low, high = adaptor.FirstParameter(), adaptor.LastParameter()
    tol = EXACT * size
    curve = _conic(adaptor)
    if curve is not None:
        span = nearest(curve, start, low), nearest(curve, end, high)
        if _off(curve(np.linspace(*span, SAMPLES)), carriers) <= tol:
            if isinstance(curve, Circle | Ellipse):
                return curve, span
            length = float(np.linalg.norm(curve(span[1]) - curve(span[0])))
            return line(curve(span[0]), curve(span[1]), (0.0, length)), (0.0, length)
    breaks = [low, high]
    if adaptor.GetType() == GeomAbs_BSplineCurve:
        spline = adaptor.BSpline()
        knots = [spline.Knot(i) for i in range(1, spline.NbKnots() + 1)]
        breaks = [low, *[k for k in knots if low < k < high], high]
    each = max(4, DENSE // (len(breaks) - 1))
    t = np.unique(np.concatenate([np.linspace(a, b, each) for a, b in zip(breaks[:-1], breaks[1:], strict=True)]))
    points = onto(carriers, np.array([adaptor.Value(s).Coord() for s in t.tolist()]))
    points[[0, -1]] = start, end
    known = recognised(points, tol)
    if known is not None:
        return known
    if len(carriers) != 2:
        raise Refused("has a seam that is neither line nor circle")
    fit = intersection(carriers[0], carriers[1], points, tol / 4)  # its parameter curves are to keep to tol as well
    return fit, fit.domain


def _conic(adaptor: BRepAdaptor_Curve) -> EdgeCurve | None:
    """A line (from parameter 0 to 1 at unit speed), circle or ellipse of the kernel with its parameter."""
    kind = adaptor.GetType()
    if kind == GeomAbs_Line:
        start, along = np.array(adaptor.Line().Location().Coord()), np.array(adaptor.Line().Direction().Coord())
        return line(start, start + along)
    if kind == GeomAbs_Circle:
        return Circle(*_frame(adaptor.Circle()), adaptor.Circle().Radius())
    if kind == GeomAbs_Ellipse:
        return Ellipse(*_frame(adaptor.Ellipse()), adaptor.Ellipse().MajorRadius(), adaptor.Ellipse().MinorRadius())
    return None


def _off(points: Array, carriers: Sequence[Plane | Quadric]) -> float:
    return max(float(np.abs(c.distance(points)).max()) for c in carriers)
