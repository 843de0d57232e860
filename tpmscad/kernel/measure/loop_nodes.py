"""The loops of OCCT faces in the parameters of their surfaces, at the nodes of a quadrature along the edges.

OCCT edges agree with their pcurves only to a tolerance, which a STEP reader states for the pcurves that it computes. Pcurves
therefore serve to select the period of an angle, and to start Newton's method; all coordinates come from the curve in space.
"""

from __future__ import annotations

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.GeomAbs import GeomAbs_Line
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import Carrier, ConicalSurface, Plane, Quadric, SphericalSurface
from tpmscad.kernel.measure.edge_quadrature import CurveNodes, EdgeNodeCache, curve_breaks, nodes_on_intervals
from tpmscad.kernel.occt.exploration import edges_of
from tpmscad.kernel.recognise.face_carriers import evaluate_mid_face
from tpmscad.splines.bspline import BSplineSurface

MAX_NEWTON_STEPS = 12
"""Newton steps of the projection; from a pcurve accurate to 1e-7, two steps reach round-off."""

NEWTON_STEP_TOL = 1e-7
"""Newton step, as a fraction of the parameter range, below which quadratic convergence has reached round-off."""

MAX_LEVEL_SLOPE = 1e-10
"""Slope below which a straight pcurve is parallel to u, where dv = 0 and the integral vanishes."""

PANEL_GAUSS_POINTS = 12
"""Gauss points per interval of an edge that passes near a pole, or is one."""

MAX_PANEL_ANGLE = 0.6
"""Radians by which u may vary on an interval of an edge."""

MAX_HALVINGS = 30
"""Bisections of the intervals near a pole."""

POLE_REL_TOL = 1e-9
"""Distance from the axis, as a fraction of the distance from the origin, below which u is undefined."""


def find_loop_nodes(face: TopoDS_Face, surface: Carrier, nodes_of: EdgeNodeCache) -> Array:
    """Rows (n, 3) of u, v, and weight times dv/dt at nodes along all edges of a face, as its loops use them.

    surface: that of the face; a plane or quadric may have other parameters than OCCT's.
    """
    if isinstance(surface, BSplineSurface):
        return _follow_on_spline(face, surface, nodes_of)
    edges = [edge for edge in edges_of(face) if not BRep_Tool.Degenerated_s(edge)]
    if isinstance(surface, Plane):
        return np.concatenate([_follow_in_plane(surface, edge, nodes_of) for edge in edges])
    unwrapper = _AngleUnwrapper(face, surface)
    return np.concatenate([_follow_on_quadric(unwrapper, edge, nodes_of) for edge in edges])


def _follow_in_plane(plane: Plane, edge: TopoDS_Edge, nodes_of: EdgeNodeCache) -> Array:
    """Rows (n, 3) of u, v, and weight times dv/dt along an edge in a plane."""
    nodes, sign = nodes_of(edge)
    return np.column_stack([plane.parameters(nodes.points), sign * nodes.weights * (nodes.tangents @ plane.y_axis)])


def _follow_on_spline(face: TopoDS_Face, surface: BSplineSurface, nodes_of: EdgeNodeCache) -> Array:
    """The rows (n, 3) of all edges of a face on a spline but those along which v is constant."""
    at_poles, on_edges = [np.zeros((0, 3))], [np.zeros((0, 9))]
    for edge in edges_of(face):
        pcurve = BRepAdaptor_Curve2d(edge, face)
        if pcurve.GetType() == GeomAbs_Line and abs(pcurve.Line().Direction().Y()) < MAX_LEVEL_SLOPE:
            continue
        nodes, sign = nodes_of(edge)
        guess = evaluate_pcurve(pcurve, nodes.parameters)
        if BRep_Tool.Degenerated_s(edge):  # a line of parameters, of which the curve in space tells nothing
            slope = (guess[-1, 1] - guess[0, 1]) / (nodes.parameters[-1] - nodes.parameters[0])
            at_poles.append(np.column_stack([guess, sign * nodes.weights * slope]))
        else:
            on_edges.append(np.column_stack([guess, nodes.points, nodes.tangents, sign * nodes.weights]))
    rows = np.concatenate(on_edges)
    uv, points, tangents = rows[:, :2], rows[:, 2:5], rows[:, 5:8]
    low, high = np.array(surface.domain).T
    for _ in range(MAX_NEWTON_STEPS):
        at = np.clip(uv, low, high)
        point, along_u, along_v = surface.jet(*at.T)
        step = _find_coordinates(along_u, along_v, points - point)
        uv = at + step
        if (np.abs(step) < NEWTON_STEP_TOL * (high - low)).all():
            break
    _, along_u, along_v = surface.jet(*np.clip(uv, low, high).T)
    rise = _find_coordinates(along_u, along_v, tangents)[:, 1]
    return np.concatenate([*at_poles, np.column_stack([uv, rows[:, 8] * rise])])


def evaluate_pcurve(pcurve: BRepAdaptor_Curve2d, t: Array) -> Array:
    """Points (n, 2) of a pcurve at parameters (n,)."""
    if pcurve.GetType() == GeomAbs_Line:
        line = pcurve.Line()
        return np.array(line.Location().Coord()) + t[:, None] * np.array(line.Direction().Coord())
    return np.array([pcurve.Value(s).Coord() for s in t.tolist()])


def _find_coordinates(along_u: Array, along_v: Array, vectors: Array) -> Array:
    """Coordinates (n, 2) of the tangential parts of vectors (n, 3) along the derivatives by u and by v."""
    e, f, g = ((a * b).sum(axis=1) for a, b in ((along_u, along_u), (along_u, along_v), (along_v, along_v)))
    a, b = ((vectors * along).sum(axis=1) for along in (along_u, along_v))
    return np.stack([g * a - f * b, e * b - f * a], axis=1) / (e * g - f * f)[:, None]


def _follow_on_quadric(unwrapper: _AngleUnwrapper, edge: TopoDS_Edge, nodes_of: EdgeNodeCache) -> Array:
    """Rows (n, 3) of u, v, and weight times dv/dt along an edge on a quadric."""
    quadric = unwrapper.quadric
    nodes, sign = nodes_of(edge)
    if isinstance(quadric, SphericalSurface | ConicalSurface):
        nodes = _refine_near_poles(edge, nodes, quadric)
    uv = unwrapper.parameters_on(edge, nodes)
    _, along_u, along_v = quadric.jet(*uv.T)
    rise = _find_coordinates(along_u, along_v, nodes.tangents)[:, 1]
    return np.column_stack([uv, sign * nodes.weights * rise])


def _refine_near_poles(edge: TopoDS_Edge, nodes: CurveNodes, quadric: Quadric) -> CurveNodes:
    """Denser nodes for an edge along which the angle u varies too fast for `nodes`, as it does near a pole."""
    curve = BRepAdaptor_Curve(edge)
    breaks = curve_breaks(curve)
    swing = _panel_angles(curve, breaks, quadric)
    if swing.max() < MAX_PANEL_ANGLE:
        return nodes
    for _ in range(MAX_HALVINGS):
        wide = np.flatnonzero(swing > MAX_PANEL_ANGLE)
        if len(wide) == 0:
            break
        breaks = np.union1d(breaks, 0.5 * (breaks[wide] + breaks[wide + 1]))
        swing = _panel_angles(curve, breaks, quadric)
    return nodes_on_intervals(curve, breaks, PANEL_GAUSS_POINTS)


def _panel_angles(curve: BRepAdaptor_Curve, breaks: Array, quadric: Quadric) -> Array:
    """Variation of the angle u on each interval between the breaks."""
    t = breaks[:-1, None] + np.diff(breaks)[:, None] * np.linspace(0.0, 1.0, PANEL_GAUSS_POINTS)
    points = np.array([curve.Value(s).Coord() for s in t.ravel().tolist()])
    angle = quadric.parameters(points)[:, 0].reshape(t.shape)
    arm = points - quadric.origin
    pole = (np.linalg.norm(np.cross(arm, quadric.axis), axis=1) < POLE_REL_TOL * np.abs(arm).max()).reshape(t.shape)
    angle[:, 0] = np.where(pole[:, 0], angle[:, 1], angle[:, 0])
    angle[:, -1] = np.where(pole[:, -1], angle[:, -2], angle[:, -1])
    return np.asarray(np.ptp(np.unwrap(angle, axis=1), axis=1))


class _AngleUnwrapper:
    """Surface parameters of a quadric along edges, in the same period as the pcurves of the OCCT face."""

    def __init__(self, face: TopoDS_Face, quadric: Quadric) -> None:
        self.face, self.quadric = face, quadric
        (u, v), point, _, beside = evaluate_mid_face(face)
        own = quadric.parameters(point)
        step = quadric.parameters(beside)[0] - own[0]
        self.u_sense = 1.0 if np.sin(step) > 0 else -1.0
        self.offset = own - np.array([self.u_sense * u, v])

    def parameters_on(self, edge: TopoDS_Edge, nodes: CurveNodes) -> Array:
        """(u, v) at the nodes of an edge: (n, 2)."""
        uv = self.quadric.parameters(nodes.points)
        at = len(nodes.parameters) // 2
        u, v = BRepAdaptor_Curve2d(edge, self.face).Value(float(nodes.parameters[at])).Coord()
        near = self.offset + np.array([self.u_sense * u, v])
        for axis, period in enumerate(self.quadric.period):
            if period:
                angle = np.unwrap(uv[:, axis], period=period)
                uv[:, axis] = angle + period * np.round((near[axis] - angle[at]) / period)
        return np.asarray(uv)
