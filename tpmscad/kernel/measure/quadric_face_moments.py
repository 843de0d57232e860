"""Moments of OCCT faces on cylinders, cones, spheres and tori, as line integrals over the 3-D curves of their edges.

    int_D f du dv = oint F dv,    F(u, v) = int_0^u f(s, v) ds in closed form,    as in brep.moments.loop_integrals.

OCCT edges agree with their pcurves only to a tolerance. Pcurves therefore serve to select the period of an angle; all
coordinates come from the curve in space.
"""

from __future__ import annotations

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Sphere, GeomAbs_Torus
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.carriers import ConicalSurface, Plane, Quadric, SphericalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.moments.loop_integrals import TRIGONOMETRIC_ORDER, antiderivative_matrix
from tpmscad.kernel.measure.edge_quadrature import CurveNodes, EdgeNodeCache, curve_breaks, nodes_on_intervals
from tpmscad.kernel.occt.exploration import edges_of
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.kernel.recognise.face_carriers import evaluate_mid_face, recognise_carrier

QUADRIC_TYPES = (GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_Sphere, GeomAbs_Torus)

PANEL_GAUSS_POINTS = 12
"""Gauss points per interval of an edge that passes near a pole."""

MAX_PANEL_ANGLE = 0.6
"""Radians by which u may vary on an interval of an edge."""

MAX_HALVINGS = 30
"""Bisections of the intervals near a pole."""

POLE_REL_TOL = 1e-9
"""Distance from the axis, as a fraction of the distance from the origin, below which u is undefined."""

NODES_PER_BATCH = 20000
"""Nodes evaluated at once; 20000 nodes are 140000 points and 30 MB."""


def recognise_quadric(face: TopoDS_Face) -> Quadric | None:
    """The quadric that underlies the face; None for other surfaces and for tori that intersect themselves."""
    if BRepAdaptor_Surface(face, False).GetType() not in QUADRIC_TYPES:
        return None
    try:
        carrier = recognise_carrier(face, 1.0)
    except UnsupportedFace:
        return None
    assert not isinstance(carrier, Plane)
    return carrier


def quadric_face_moments(face: TopoDS_Face, quadric: Quadric, nodes_of: EdgeNodeCache) -> Array:
    """Area, int x . n dA / 3 and int x (x . n) dA / 4 over the forward side of the face: (5,).

    The loops are oriented as the face uses them.
    """
    unwrapper = _AngleUnwrapper(face, quadric)
    parts = []
    for edge in edges_of(face):
        if not BRep_Tool.Degenerated_s(edge):
            nodes, sign = nodes_of(edge)
            if isinstance(quadric, SphericalSurface | ConicalSurface):
                nodes = _refine_near_poles(edge, nodes, quadric)
            uv = unwrapper.parameters_on(edge, nodes)
            along_v = quadric(uv[:, 0], uv[:, 1], 0, 1)
            rise = (nodes.tangents * along_v).sum(1) / (along_v * along_v).sum(1)
            parts.append(np.column_stack([uv, sign * nodes.weights * rise]))
    table = np.concatenate(parts)
    total = np.zeros(5)
    least = float(table[:, 0].min())
    for first in range(0, len(table), NODES_PER_BATCH):
        u, v, rise = table[first : first + NODES_PER_BATCH].T
        total += _integrate_loop(quadric, u, v, rise, least)
    total[0] *= unwrapper.side
    return total


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


def _integrate_loop(quadric: Quadric, u: Array, v: Array, rise: Array, start: float) -> Array:
    """Sum of F(u, v) dv, with F the integral from `start` to u of |N|, x . N / 3 and x (x . N) / 4: (5,)."""
    samples = np.arange(2 * TRIGONOMETRIC_ORDER + 1) * TWO_PI / (2 * TRIGONOMETRIC_ORDER + 1)
    inner_v = np.broadcast_to(v[:, None], (len(v), len(samples)))
    x = quadric(samples, inner_v)
    n = np.cross(quadric(samples, inner_v, 1, 0), quadric(samples, inner_v, 0, 1))
    from_start = antiderivative_matrix(u, samples) - antiderivative_matrix(np.array([start]), samples)
    weights = rise[:, None] * from_start
    cone = weights * (x * n).sum(-1)
    return np.concatenate(
        [[(weights * np.linalg.norm(n, axis=-1)).sum(), cone.sum() / 3.0], np.einsum("nk,nkd->d", cone, x) / 4.0]
    )


class _AngleUnwrapper:
    """Surface parameters of a quadric along edges, in the same period as the pcurves of the OCCT face.

    `side` is -1 if S_u x S_v of the quadric opposes that of the OCCT surface.
    """

    def __init__(self, face: TopoDS_Face, quadric: Quadric) -> None:
        self.face, self.quadric = face, quadric
        (u, v), point, normal, beside = evaluate_mid_face(face)
        self.side = 1.0 if normal @ quadric.gradient(point) > 0 else -1.0
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
