"""Gauss quadrature along the 3-D curves of OCCT edges, evaluated once for an edge that two faces share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.GeomAbs import GeomAbs_BSplineCurve
from OCP.TopoDS import TopoDS_Edge

from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import ShapeKey, evaluate_pointwise, orientation_sign
from tpmscad.splines.quadrature import composite_gauss_legendre

GAUSS_POINTS_SINGLE_SPAN = 16
"""Gauss points of a curve with a single span, such as a whole side of a patch; volumes are converged to round-off."""

GAUSS_POINTS_PER_SPAN = 6
"""Gauss points per span of a curve with several, such as a fitted intersection curve; volumes are converged to round-off. A
spline of the kernel has two more than its degree: the edge of a fillet, of a high degree, had an area 5e-5 off with 6."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveNodes:
    """Quadrature nodes along an edge: parameters (n,), weights (n,), points (n, 3) and tangents (n, 3)."""

    parameters: Array
    weights: Array
    points: Array
    tangents: Array


class EdgeNodeCache:
    """Quadrature nodes of edges, computed once per edge."""

    def __init__(self) -> None:
        self._known: dict[Any, CurveNodes] = {}

    def __call__(self, edge: TopoDS_Edge) -> tuple[CurveNodes, int]:
        """Nodes of an edge, and -1 if its orientation opposes its curve, else 1."""
        key = ShapeKey(edge)
        if key not in self._known:
            curve = BRepAdaptor_Curve(edge)
            breaks = curve_breaks(curve)
            points = GAUSS_POINTS_PER_SPAN if len(breaks) > 2 else GAUSS_POINTS_SINGLE_SPAN
            if curve.GetType() == GeomAbs_BSplineCurve:
                points = max(points, curve.Degree() + 2)
            self._known[key] = nodes_on_intervals(curve, breaks, points)
        return self._known[key], orientation_sign(edge)


def curve_breaks(curve: BRepAdaptor_Curve) -> Array:
    """Parameters at the start, the knots and the end of an edge's curve."""
    low, high = curve.FirstParameter(), curve.LastParameter()
    inside = np.zeros(0)
    if curve.GetType() == GeomAbs_BSplineCurve:
        spline = curve.BSpline()
        knots = np.array([spline.Knot(i) for i in range(1, spline.NbKnots() + 1)])
        inside = knots[(knots > low) & (knots < high)]
    return np.concatenate([[low], inside, [high]])


def nodes_on_intervals(curve: BRepAdaptor_Curve, breaks: Array, points: int) -> CurveNodes:
    """Gauss nodes on every interval between the breaks."""
    t, weights = composite_gauss_legendre(breaks, points)
    if curve.GetType() == GeomAbs_BSplineCurve and not (curve.IsRational() or curve.IsPeriodic()):
        spline = convert.curve_from_occt(curve.BSpline())
        return CurveNodes(t, weights, spline(t), spline(t, 1))
    places, tangents = evaluate_pointwise(curve, t)
    return CurveNodes(t, weights, places, tangents)
