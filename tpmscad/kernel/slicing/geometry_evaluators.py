"""Points and first derivatives of OCCT faces and edges at many parameters at once.

B-splines, planes and lines are evaluated in arrays; other kinds by OCCT, point by point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_BSplineSurface, GeomAbs_Line, GeomAbs_Plane
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SurfaceEvaluator = Callable[[Array], tuple[Array, Array, Array]]
"""Parameters (n, 2) to points and both first derivatives, each (n, 3)."""

CurveEvaluator = Callable[[Array], tuple[Array, Array]]
"""Parameters (n,) to points and first derivatives, each (n, 3)."""


def face_evaluator(face: TopoDS_Face) -> SurfaceEvaluator:
    """Evaluator of the surface of a face, where the face lies."""
    adaptor = BRepAdaptor_Surface(face, False)
    kind = adaptor.GetType()
    if kind == GeomAbs_BSplineSurface and not (adaptor.IsURational() or adaptor.IsVRational() or _is_periodic(adaptor)):
        return _spline_evaluator(convert.surface_from_occt(adaptor.BSpline()))
    if kind == GeomAbs_Plane:
        origin, along_u, along_v = (np.array(xyz.Coord()) for xyz in _plane_frame(adaptor.Plane()))
        return lambda uv: (
            origin + uv[:, :1] * along_u + uv[:, 1:] * along_v,
            np.broadcast_to(along_u, (len(uv), 3)),
            np.broadcast_to(along_v, (len(uv), 3)),
        )
    return _pointwise_surface_evaluator(adaptor)


def edge_evaluator(edge: TopoDS_Edge) -> CurveEvaluator:
    """Evaluator of the curve of an edge, where the edge lies."""
    adaptor = BRepAdaptor_Curve(edge)
    kind = adaptor.GetType()
    if kind == GeomAbs_Line:
        line = adaptor.Line()
        origin, along = np.array(line.Location().Coord()), np.array(line.Direction().Coord())
        return lambda t: (origin + t[:, None] * along, np.broadcast_to(along, (len(t), 3)))
    if kind == GeomAbs_BSplineCurve and not (adaptor.IsRational() or adaptor.IsPeriodic()):
        curve = convert.curve_from_occt(adaptor.BSpline())
        return lambda t: _evaluate_curve(curve, t)
    return _pointwise_curve(adaptor)


def _is_periodic(adaptor: BRepAdaptor_Surface) -> bool:
    return bool(adaptor.IsUPeriodic() or adaptor.IsVPeriodic())


def _plane_frame(plane: Any) -> tuple[Any, Any, Any]:
    """Origin and directions of u and v."""
    frame = plane.Position()
    return frame.Location(), frame.XDirection(), frame.YDirection()


def _spline_evaluator(surface: BSplineSurface) -> SurfaceEvaluator:
    poles = surface.poles

    def evaluate(uv: Array) -> tuple[Array, Array, Array]:
        u, du = design_matrices(surface.knots_u, surface.degree_u, uv[:, 0], (0, 1))
        v, dv = design_matrices(surface.knots_v, surface.degree_v, uv[:, 1], (0, 1))
        flat = poles.reshape(len(poles), -1)
        rows, slopes = ((m @ flat).reshape(len(uv), poles.shape[1], 3) for m in (u, du))
        return (
            np.einsum("nvd,nv->nd", rows, v),
            np.einsum("nvd,nv->nd", slopes, v),
            np.einsum("nvd,nv->nd", rows, dv),
        )

    return evaluate


def _evaluate_curve(curve: BSplineCurve, t: Array) -> tuple[Array, Array]:
    value, slope = design_matrices(curve.knots, curve.degree, t, (0, 1))
    return value @ curve.poles, slope @ curve.poles


def _pointwise_surface_evaluator(adaptor: BRepAdaptor_Surface) -> SurfaceEvaluator:
    def evaluate(uv: Array) -> tuple[Array, Array, Array]:
        point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
        found = np.empty((3, len(uv), 3))
        for i, (u, v) in enumerate(uv.tolist()):
            adaptor.D1(u, v, point, along_u, along_v)
            found[:, i] = point.Coord(), along_u.Coord(), along_v.Coord()
        return found[0], found[1], found[2]

    return evaluate


def _pointwise_curve(adaptor: BRepAdaptor_Curve) -> CurveEvaluator:
    def evaluate(t: Array) -> tuple[Array, Array]:
        point, along = gp_Pnt(), gp_Vec()
        found = np.empty((2, len(t), 3))
        for i, at in enumerate(t.tolist()):
            adaptor.D1(at, point, along)
            found[:, i] = point.Coord(), along.Coord()
        return found[0], found[1]

    return evaluate
