"""Points and first derivatives of OCCT faces and edges at many parameters at once.

B-splines, planes, quadrics, lines and conics are evaluated in arrays, and other processes can have these evaluators; other kinds
are evaluated by OCCT, point by point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.GeomAbs import (
    GeomAbs_BSplineCurve,
    GeomAbs_BSplineSurface,
    GeomAbs_Circle,
    GeomAbs_Cone,
    GeomAbs_Cylinder,
    GeomAbs_Ellipse,
    GeomAbs_Line,
    GeomAbs_Plane,
    GeomAbs_Sphere,
    GeomAbs_Torus,
)
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import evaluate_pointwise
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SurfaceEvaluator = Callable[[Array], tuple[Array, ...]]
"""Parameters (n, 2) to points and both first derivatives, each (n, 3)."""

CurveEvaluator = Callable[[Array], tuple[Array, ...]]
"""Parameters (n,) to points and first derivatives, each (n, 3)."""


def face_evaluator(face: TopoDS_Face) -> SurfaceEvaluator:
    """Evaluator of the surface of a face, where the face lies."""
    adaptor = BRepAdaptor_Surface(face, False)
    kind = adaptor.GetType()
    if kind == GeomAbs_BSplineSurface and convert.is_plain_spline(adaptor.BSpline()):
        return SplineSurfaceEvaluator(convert.surface_from_occt(adaptor.BSpline()))
    if kind == GeomAbs_Plane:
        frame = adaptor.Plane().Position()
        corners = (frame.Location(), frame.XDirection(), frame.YDirection())
        return PlaneEvaluator(*(np.array(each.Coord()) for each in corners))
    if kind == GeomAbs_Cylinder:
        return RevolutionEvaluator(_frame_of(adaptor.Cylinder()), adaptor.Cylinder().Radius(), 0.0, False)
    if kind == GeomAbs_Cone:
        return RevolutionEvaluator(
            _frame_of(adaptor.Cone()), adaptor.Cone().RefRadius(), adaptor.Cone().SemiAngle(), False
        )
    if kind == GeomAbs_Sphere:
        return RevolutionEvaluator(_frame_of(adaptor.Sphere()), 0.0, adaptor.Sphere().Radius(), True)
    if kind == GeomAbs_Torus:
        torus = adaptor.Torus()
        return RevolutionEvaluator(_frame_of(torus), torus.MajorRadius(), torus.MinorRadius(), True)
    return partial(evaluate_pointwise, adaptor)


def edge_evaluator(edge: TopoDS_Edge) -> CurveEvaluator:
    """Evaluator of the curve of an edge, where the edge lies."""
    adaptor = BRepAdaptor_Curve(edge)
    kind = adaptor.GetType()
    if kind == GeomAbs_Line:
        line = adaptor.Line()
        return LineEvaluator(np.array(line.Location().Coord()), np.array(line.Direction().Coord()))
    if kind == GeomAbs_BSplineCurve and not (adaptor.IsRational() or adaptor.IsPeriodic()):
        return SplineCurveEvaluator(convert.curve_from_occt(adaptor.BSpline()))
    if kind in (GeomAbs_Circle, GeomAbs_Ellipse):
        conic = adaptor.Circle() if kind == GeomAbs_Circle else adaptor.Ellipse()
        radii = (conic.Radius(),) * 2 if kind == GeomAbs_Circle else (conic.MajorRadius(), conic.MinorRadius())
        frame = conic.Position()
        x, y = (np.array(each.Coord()) for each in (frame.XDirection(), frame.YDirection()))
        return ConicEvaluator(np.array(frame.Location().Coord()), radii[0] * x, radii[1] * y)
    return partial(evaluate_pointwise, adaptor)


def _frame_of(surface: Any) -> Array:
    """Location, directions of x and y, and axis of an elementary surface of OCCT, whose frame may be left-handed: (4, 3)."""
    frame = surface.Position()
    rows = (frame.Location(), frame.XDirection(), frame.YDirection(), frame.Direction())
    return np.array([row.Coord() for row in rows])


@dataclass(frozen=True, slots=True, eq=False)
class SplineSurfaceEvaluator:
    """Evaluator of a B-spline surface."""

    spline: BSplineSurface

    def __call__(self, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives at parameters."""
        s = self.spline
        found = np.empty((3, len(uv), 3))
        knots_u, knots_v, poles = (np.ascontiguousarray(a) for a in (s.knots_u, s.knots_v, s.poles))
        _evaluate_surface(knots_u, s.degree_u, knots_v, s.degree_v, poles, np.ascontiguousarray(uv), found)
        return found[0], found[1], found[2]

    def evaluate_grids(self, u: Array, v: Array) -> Array:
        """Points (n, k, l, 3) on grids of parameters u (n, k) with v (n, l), which ascend."""
        s = self.spline
        points = np.empty((*u.shape, v.shape[1], 3))
        knots_u, knots_v, poles = (np.ascontiguousarray(a) for a in (s.knots_u, s.knots_v, s.poles))
        _evaluate_grids(knots_u, s.degree_u, knots_v, s.degree_v, poles, u, v, points)
        return points


@dataclass(frozen=True, slots=True, eq=False)
class PlaneEvaluator:
    """Evaluator of a plane by its origin and the directions of u and v, (3,) each."""

    origin: Array
    along_u: Array
    along_v: Array

    def __call__(self, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives at parameters."""
        return (
            self.origin + uv[:, :1] * self.along_u + uv[:, 1:] * self.along_v,
            np.broadcast_to(self.along_u, (len(uv), 3)),
            np.broadcast_to(self.along_v, (len(uv), 3)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RevolutionEvaluator:
    """Evaluator of a cylinder, cone, sphere or torus with OCCT's parameters.

    frame: location, directions of x and y, and axis, (4, 3). If it is `round` (torus, sphere), the profile is a circle of the
    radius `second`, with its centre at the distance `first` from the axis; else (cylinder, cone) it is a line that begins at the
    distance `first` and is inclined by `second` radians.
    """

    frame: Array
    first: float
    second: float
    round: bool

    def __call__(self, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives at parameters."""
        origin, x, y, axis = self.frame
        u, v = uv[:, :1], uv[:, 1:]
        away, around = np.cos(u) * x + np.sin(u) * y, np.cos(u) * y - np.sin(u) * x
        if self.round:
            r, z = self.first + self.second * np.cos(v), self.second * np.sin(v)
            by_r, by_z = -z, self.second * np.cos(v)
        else:
            sine, cosine = np.sin(self.second), np.cos(self.second)
            r, z, by_r, by_z = self.first + v * sine, v * cosine, np.full_like(v, sine), np.full_like(v, cosine)
        return origin + r * away + z * axis, r * around, by_r * away + by_z * axis

    def bound_heights(self, low: Array, high: Array) -> tuple[float, float]:
        """Heights between which the part over the parameters from low to high (2,) lies; not the narrowest ones."""
        origin, x, y, axis = self.frame[:, 2].tolist()
        v = np.array([low[1], high[1]])
        if self.round:
            cosine, sine = _bound_cosine(v), _bound_cosine(v - 0.5 * np.pi)
            r, z = self.first + self.second * cosine, self.second * sine
        else:
            r, z = self.first + v * np.sin(self.second), v * np.cos(self.second)
        across = np.hypot(x, y) * _bound_cosine(np.array([low[0], high[0]]) - np.arctan2(y, x))
        products, lifts = np.outer(r, across), z * axis
        return origin + float(products.min() + lifts.min()), origin + float(products.max() + lifts.max())


def _bound_cosine(angles: Array) -> Array:
    """The least and the greatest cosine between two ascending angles (2,): (2,)."""
    low, high = np.cos(angles).min(), np.cos(angles).max()
    turns = angles / np.pi
    crests = np.arange(np.ceil(turns[0]), min(np.floor(turns[1]), np.ceil(turns[0]) + 1) + 1)
    return np.array([-1.0 if (crests % 2 == 1).any() else low, 1.0 if (crests % 2 == 0).any() else high])


@dataclass(frozen=True, slots=True, eq=False)
class ConicEvaluator:
    """Evaluator of a circle or an ellipse by its centre and both half axes, (3,) each."""

    origin: Array
    major: Array
    minor: Array

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives at parameters."""
        cosine, sine = np.cos(t)[:, None], np.sin(t)[:, None]
        return self.origin + cosine * self.major + sine * self.minor, cosine * self.minor - sine * self.major


@dataclass(frozen=True, slots=True, eq=False)
class SplineCurveEvaluator:
    """Evaluator of a B-spline curve."""

    spline: BSplineCurve

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives at parameters."""
        value, slope = design_matrices(self.spline.knots, self.spline.degree, t, (0, 1))
        return value @ self.spline.poles, slope @ self.spline.poles


@dataclass(frozen=True, slots=True, eq=False)
class LineEvaluator:
    """Evaluator of a straight line by its origin and direction, (3,) each."""

    origin: Array
    along: Array

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives at parameters."""
        return self.origin + t[:, None] * self.along, np.broadcast_to(self.along, (len(t), 3))


@njit_cached
def _evaluate_surface(
    knots_u: Array, degree_u: int, knots_v: Array, degree_v: int, poles: Array, uv: Array, found: Array
) -> None:  # pragma: no cover - compiled
    """Points and derivatives by u and by v at parameters (n, 2), into found (3, n, 3); the last spans go on beyond the domain."""
    basis_u, slope_u = np.empty(degree_u + 1), np.empty(degree_u + 1)
    basis_v, slope_v = np.empty(degree_v + 1), np.empty(degree_v + 1)
    for i in range(len(uv)):
        first_u = evaluate_basis(knots_u, degree_u, uv[i, 0], basis_u, slope_u)
        first_v = evaluate_basis(knots_v, degree_v, uv[i, 1], basis_v, slope_v)
        for axis in range(3):
            x, xu, xv = 0.0, 0.0, 0.0
            for a in range(degree_u + 1):
                along, across = 0.0, 0.0
                for b in range(degree_v + 1):
                    pole = poles[first_u + a, first_v + b, axis]
                    along += pole * basis_v[b]
                    across += pole * slope_v[b]
                x += basis_u[a] * along
                xu += slope_u[a] * along
                xv += basis_u[a] * across
            found[0, i, axis], found[1, i, axis], found[2, i, axis] = x, xu, xv


@njit_cached
def _evaluate_grids(
    knots_u: Array, degree_u: int, knots_v: Array, degree_v: int, poles: Array, u: Array, v: Array, points: Array
) -> None:  # pragma: no cover - compiled
    """Points on grids of parameters u (n, k) with v (n, l), into points (n, k, l, 3)."""
    n, k, l = u.shape[0], u.shape[1], v.shape[1]  # noqa: E741
    basis_u, basis_v, slope = np.empty(degree_u + 1), np.empty((l, degree_v + 1)), np.empty(max(degree_u, degree_v) + 1)
    first_v = np.empty(l, np.int64)
    row = np.empty((poles.shape[1], 3))
    for i in range(n):
        for b in range(l):
            first_v[b] = evaluate_basis(knots_v, degree_v, v[i, b], basis_v[b], slope)
        for a in range(k):
            first_u = evaluate_basis(knots_u, degree_u, u[i, a], basis_u, slope)
            for j in range(first_v[0], first_v[l - 1] + degree_v + 1):
                for axis in range(3):
                    row[j, axis] = 0.0
                    for m in range(degree_u + 1):
                        row[j, axis] += basis_u[m] * poles[first_u + m, j, axis]
            for b in range(l):
                for axis in range(3):
                    x = 0.0
                    for m in range(degree_v + 1):
                        x += basis_v[b, m] * row[first_v[b] + m, axis]
                    points[i, a, b, axis] = x


@njit_cached
def evaluate_basis(
    knots: Array, degree: int, t: float, basis: Array, slope: Array
) -> int:  # pragma: no cover - compiled
    """The degree + 1 basis functions that do not vanish at t, and their slopes; returns the number of the first (Cox-de Boor)."""
    span = int(np.searchsorted(knots, t, side="right")) - 1
    span = min(max(span, degree), len(knots) - degree - 2)
    basis[0] = 1.0
    for order in range(1, degree + 1):
        if order == degree:
            for r in range(degree + 1):
                slope[r] = 0.0
                if r > 0:
                    slope[r] += degree * basis[r - 1] / (knots[span + r] - knots[span + r - degree])
                if r < degree:
                    slope[r] -= degree * basis[r] / (knots[span + r + 1] - knots[span + r + 1 - degree])
        carried = 0.0
        for r in range(order):
            right, left = knots[span + r + 1] - t, t - knots[span + 1 - order + r]
            ratio = basis[r] / (right + left)
            basis[r] = carried + right * ratio
            carried = left * ratio
        basis[order] = carried
    return span - degree
