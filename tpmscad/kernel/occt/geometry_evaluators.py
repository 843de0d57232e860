"""Points and first derivatives of OCCT faces and edges at many parameters at once, and of many faces or edges, each at its own.

B-splines, planes, quadrics, lines and conics lie side by side in flat arrays, and one compiled loop serves them all: a call for
each face would cost more than the evaluation. Other processes can have these evaluators. Other kinds of surfaces and curves are
evaluated by OCCT, point by point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from tpmscad._typing import Array, IntArray
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import evaluate_pointwise, orientation_sign
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SurfaceEvaluator = Callable[[Array], tuple[Array, ...]]
"""Parameters (n, 2) to points and both first derivatives, each (n, 3)."""

CurveEvaluator = Callable[[Array], tuple[Array, ...]]
"""Parameters (n,) to points and first derivatives, each (n, 3)."""


LINEAR, FOREIGN, INCLINED, ROUND = 0, -1, -2, -3
"""Degrees that stand for planes and lines, of which the table holds origin and directions; for what OCCT evaluates; and for
surfaces of revolution with a straight and a circular profile, of which it holds the frame and a row with two lengths or angles.
Conics are ROUND curves: the table holds the centre and both half axes."""

NO_KNOTS = np.zeros(0)

TableRow = tuple[tuple[int, ...], int, tuple[Array, ...], Array]
"""Of one surface or curve in a table: degrees, columns of poles (of a curve 0), knots and poles."""


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


class OutwardNormals:
    """Points and outward unit normals of a face's surface."""

    def __init__(self, face: TopoDS_Face) -> None:
        self.evaluate = face_evaluator(face)
        self.sign = orientation_sign(face)

    def __call__(self, uv: Array) -> tuple[Array, Array]:
        """Points and normals, (n, 3) each, at parameters (n, 2); normals are zero where the surface is singular."""
        points, along_u, along_v = self.evaluate(uv)
        normals = np.cross(along_u, along_v)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points, self.sign * np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def _frame_of(surface: Any) -> Array:
    """Location, directions of x and y, and axis of an elementary surface of OCCT, whose frame may be left-handed: (4, 3)."""
    frame = surface.Position()
    rows = (frame.Location(), frame.XDirection(), frame.YDirection(), frame.Direction())
    return np.array([row.Coord() for row in rows])


class PackedSurface:
    """A surface that tables hold."""

    __slots__ = ()

    @property
    def row(self) -> TableRow:
        """Its row."""
        raise NotImplementedError

    def __call__(self, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives, (n, 3) each, at parameters (n, 2)."""
        return pack_surfaces([self])(np.zeros(len(uv), np.int64), uv)


@dataclass(frozen=True, slots=True, eq=False)
class SplineSurfaceEvaluator(PackedSurface):
    """Evaluator of a B-spline surface."""

    spline: BSplineSurface

    @property
    def row(self) -> TableRow:
        """Degrees, number of poles along v, knots and poles."""
        s = self.spline
        return (s.degree_u, s.degree_v), s.poles.shape[1], (s.knots_u, s.knots_v), s.poles.reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneEvaluator(PackedSurface):
    """Evaluator of a plane by its origin and the directions of u and v, (3,) each."""

    origin: Array
    along_u: Array
    along_v: Array

    @property
    def row(self) -> TableRow:
        """Origin and both directions in place of poles."""
        return (LINEAR, LINEAR), 0, (NO_KNOTS, NO_KNOTS), np.stack([self.origin, self.along_u, self.along_v])


@dataclass(frozen=True, slots=True, eq=False)
class RevolutionEvaluator(PackedSurface):
    """Evaluator of a cylinder, cone, sphere or torus with OCCT's parameters.

    frame: location, directions of x and y, and axis, (4, 3). If it is `round` (torus, sphere), the profile is a circle of the
    radius `second`, with its centre at the distance `first` from the axis; else (cylinder, cone) it is a line that begins at the
    distance `first` and is inclined by `second` radians.
    """

    frame: Array
    first: float
    second: float
    round: bool

    @property
    def row(self) -> TableRow:
        """The frame, and a row with both lengths or angles, in place of poles."""
        kind = ROUND if self.round else INCLINED
        return (kind, kind), 0, (NO_KNOTS, NO_KNOTS), np.concatenate([self.frame, [[self.first, self.second, 0.0]]])


class PackedCurve:
    """A curve that tables hold."""

    __slots__ = ()

    @property
    def row(self) -> TableRow:
        """Its row."""
        raise NotImplementedError

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives, (n, 3) each, at parameters (n,)."""
        return pack_curves([self])(np.zeros(len(t), np.int64), t)


@dataclass(frozen=True, slots=True, eq=False)
class ConicEvaluator(PackedCurve):
    """Evaluator of a circle or an ellipse by its centre and both half axes, (3,) each."""

    origin: Array
    major: Array
    minor: Array

    @property
    def row(self) -> TableRow:
        """Centre and half axes in place of poles."""
        return (ROUND,), 0, (NO_KNOTS,), np.stack([self.origin, self.major, self.minor])


@dataclass(frozen=True, slots=True, eq=False)
class SplineCurveEvaluator(PackedCurve):
    """Evaluator of a B-spline curve."""

    spline: BSplineCurve

    @property
    def row(self) -> TableRow:
        """Degree, knots and poles."""
        return (self.spline.degree,), 0, (self.spline.knots,), self.spline.poles


@dataclass(frozen=True, slots=True, eq=False)
class LineEvaluator(PackedCurve):
    """Evaluator of a straight line by its origin and direction, (3,) each."""

    origin: Array
    along: Array

    @property
    def row(self) -> TableRow:
        """Origin and direction in place of poles."""
        return (LINEAR,), 0, (NO_KNOTS,), np.stack([self.origin, self.along])


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTable:
    """Surfaces by number: degrees (F, 2), columns of poles (F,), and where their knots and poles begin in the flat arrays."""

    evaluators: tuple[SurfaceEvaluator, ...]
    degrees: IntArray
    columns: IntArray
    knots: Array
    knots_from: IntArray
    poles: Array
    poles_from: IntArray

    def __call__(self, which: IntArray, uv: Array) -> tuple[Array, Array, Array]:
        """Points and both first derivatives, (n, 3) each, of surfaces (n,) at parameters (n, 2)."""
        found = np.empty((3, len(uv), 3))
        packed = (self.degrees, self.columns, self.knots, self.knots_from, self.poles, self.poles_from)
        _evaluate_surfaces(*packed, which, np.ascontiguousarray(uv), found)
        _ask_foreign(self.evaluators, self.degrees[:, 0], which, uv, found)
        return found[0], found[1], found[2]

    def select(self, chosen: IntArray) -> SurfaceTable:
        """The table of some surfaces (k,)."""
        return pack_surfaces([self.evaluators[i] for i in chosen.tolist()])


@dataclass(frozen=True, slots=True, eq=False)
class CurveTable:
    """Curves by number: degrees (E,), and where their knots and poles begin in the flat arrays."""

    evaluators: tuple[CurveEvaluator, ...]
    degrees: IntArray
    knots: Array
    knots_from: IntArray
    poles: Array
    poles_from: IntArray

    def __call__(self, which: IntArray, t: Array) -> tuple[Array, Array]:
        """Points and first derivatives, (n, 3) each, of curves (n,) at parameters (n,)."""
        found = np.empty((2, len(t), 3))
        packed = (self.degrees, self.knots, self.knots_from, self.poles, self.poles_from)
        _evaluate_curves(*packed, which, np.ascontiguousarray(t), found)
        _ask_foreign(self.evaluators, self.degrees, which, t, found)
        return found[0], found[1]

    def select(self, chosen: IntArray) -> CurveTable:
        """The table of some curves (k,)."""
        return pack_curves([self.evaluators[i] for i in chosen.tolist()])


def pack_surfaces(evaluators: Sequence[SurfaceEvaluator]) -> SurfaceTable:
    """The table of surfaces."""
    foreign = (FOREIGN, FOREIGN), 0, (NO_KNOTS, NO_KNOTS), np.zeros((0, 3))
    rows = [each.row if isinstance(each, PackedSurface) else foreign for each in evaluators]
    degrees = np.array([row[0] for row in rows], np.int64).reshape(-1, 2)
    return SurfaceTable(tuple(evaluators), degrees, np.array([row[1] for row in rows], np.int64), *_lay_out(rows))


def pack_curves(evaluators: Sequence[CurveEvaluator]) -> CurveTable:
    """The table of curves."""
    foreign = (FOREIGN,), 0, (NO_KNOTS,), np.zeros((0, 3))
    rows = [each.row if isinstance(each, PackedCurve) else foreign for each in evaluators]
    return CurveTable(tuple(evaluators), np.array([row[0][0] for row in rows], np.int64), *_lay_out(rows))


def _lay_out(rows: Sequence[TableRow]) -> tuple[Array, IntArray, Array, IntArray]:
    """Knots one after another and where each vector begins, with the end; poles likewise."""
    knots, poles = [vector for row in rows for vector in row[2]], [row[3] for row in rows]
    return (
        np.concatenate([NO_KNOTS, *knots]),
        np.cumsum([0, *map(len, knots)]),
        np.concatenate([np.zeros((0, 3)), *poles]),
        np.cumsum([0, *map(len, poles)]),
    )


def _ask_foreign(
    evaluators: Sequence[Callable[[Any], tuple[Array, ...]]],
    degrees: IntArray,
    which: IntArray,
    at: Array,
    found: Array,
) -> None:
    """Fill the rows of `found` whose carriers OCCT evaluates."""
    foreign = np.flatnonzero(degrees[which] == FOREIGN)
    for number in np.unique(which[foreign]).tolist():
        rows = foreign[which[foreign] == number]
        for k, values in enumerate(evaluators[number](at[rows])):
            found[k, rows] = values


@njit_cached
def _evaluate_surfaces(
    degrees: IntArray,
    columns: IntArray,
    knots: Array,
    knots_from: IntArray,
    poles: Array,
    poles_from: IntArray,
    which: IntArray,
    uv: Array,
    found: Array,
) -> None:  # pragma: no cover - compiled
    """Points and derivatives by u and by v into found (3, n, 3); the last spans go on beyond the domain."""
    most = 1
    for f in range(len(degrees)):
        most = max(most, degrees[f, 0] + 1, degrees[f, 1] + 1)
    basis_u, slope_u, basis_v, slope_v = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for i in range(len(which)):
        f = which[i]
        degree_u, degree_v, first = degrees[f, 0], degrees[f, 1], poles_from[f]
        if degree_u == LINEAR:
            for axis in range(3):
                along_u, along_v = poles[first + 1, axis], poles[first + 2, axis]
                found[0, i, axis] = poles[first, axis] + uv[i, 0] * along_u + uv[i, 1] * along_v
                found[1, i, axis], found[2, i, axis] = along_u, along_v
        elif degree_u in (INCLINED, ROUND):
            p, q, v = poles[first + 4, 0], poles[first + 4, 1], uv[i, 1]
            cosine, sine = np.cos(uv[i, 0]), np.sin(uv[i, 0])
            if degree_u == ROUND:
                r, z = p + q * np.cos(v), q * np.sin(v)
                by_r, by_z = -z, q * np.cos(v)
            else:
                by_r, by_z = np.sin(q), np.cos(q)
                r, z = p + v * by_r, v * by_z
            for axis in range(3):
                e_x, e_y, e_z = poles[first + 1, axis], poles[first + 2, axis], poles[first + 3, axis]
                away = cosine * e_x + sine * e_y
                found[0, i, axis] = poles[first, axis] + r * away + z * e_z
                found[1, i, axis] = r * (cosine * e_y - sine * e_x)
                found[2, i, axis] = by_r * away + by_z * e_z
        elif degree_u > 0:
            knots_u = knots[knots_from[2 * f] : knots_from[2 * f + 1]]
            knots_v = knots[knots_from[2 * f + 1] : knots_from[2 * f + 2]]
            first_u = evaluate_basis(knots_u, degree_u, uv[i, 0], basis_u, slope_u)
            first_v = evaluate_basis(knots_v, degree_v, uv[i, 1], basis_v, slope_v)
            for axis in range(3):
                x, xu, xv = 0.0, 0.0, 0.0
                for a in range(degree_u + 1):
                    row = first + (first_u + a) * columns[f] + first_v
                    along, across = 0.0, 0.0
                    for b in range(degree_v + 1):
                        along += poles[row + b, axis] * basis_v[b]
                        across += poles[row + b, axis] * slope_v[b]
                    x += basis_u[a] * along
                    xu += slope_u[a] * along
                    xv += basis_u[a] * across
                found[0, i, axis], found[1, i, axis], found[2, i, axis] = x, xu, xv


@njit_cached
def _evaluate_curves(
    degrees: IntArray,
    knots: Array,
    knots_from: IntArray,
    poles: Array,
    poles_from: IntArray,
    which: IntArray,
    t: Array,
    found: Array,
) -> None:  # pragma: no cover - compiled
    """Points and derivatives into found (2, n, 3); the last spans go on beyond the domain."""
    most = 1
    for e in range(len(degrees)):
        most = max(most, degrees[e] + 1)
    basis, slope = np.empty(most), np.empty(most)
    for i in range(len(which)):
        e = which[i]
        degree, first = degrees[e], poles_from[e]
        if degree == LINEAR:
            for axis in range(3):
                found[0, i, axis] = poles[first, axis] + t[i] * poles[first + 1, axis]
                found[1, i, axis] = poles[first + 1, axis]
        elif degree == ROUND:
            cosine, sine = np.cos(t[i]), np.sin(t[i])
            for axis in range(3):
                major, minor = poles[first + 1, axis], poles[first + 2, axis]
                found[0, i, axis] = poles[first, axis] + cosine * major + sine * minor
                found[1, i, axis] = cosine * minor - sine * major
        elif degree > 0:
            own = knots[knots_from[e] : knots_from[e + 1]]
            start = first + evaluate_basis(own, degree, t[i], basis, slope)
            for axis in range(3):
                x, along = 0.0, 0.0
                for a in range(degree + 1):
                    x += basis[a] * poles[start + a, axis]
                    along += slope[a] * poles[start + a, axis]
                found[0, i, axis], found[1, i, axis] = x, along


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
