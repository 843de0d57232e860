"""Free-form carriers of OCCT faces: polynomial splines with the parameters of the kernel's surfaces, within 1e-10 of the size.

A polynomial B-spline is taken as it is. Every other surface is fitted by least squares on Gauss points of its own parameters, in
each parameter with a space of splines that is

- its own, where the surface is polynomial along the parameter: the lines of an extrusion, curves that are polynomial splines,
  rational splines whose weights do not change along it;
- of degree 9 with spans of 15 degrees along the angle of a revolution, which is exact to round-off and as smooth as the circle;
- of degree 9 otherwise, with spans that are bisected until lines of the surface are within the tolerance.

The breaks and their continuity are those of the kernel's surface, so that the fit is as smooth as the surface. The result reaches
beyond the face where the surface does, by a part of the face's range of parameters, but neither to a pole nor to a crease.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepTools import BRepTools
from OCP.Geom import (
    Geom_BezierCurve,
    Geom_BezierSurface,
    Geom_BSplineCurve,
    Geom_BSplineSurface,
    Geom_ConicalSurface,
    Geom_Curve,
    Geom_CylindricalSurface,
    Geom_ElementarySurface,
    Geom_Line,
    Geom_Plane,
    Geom_RectangularTrimmedSurface,
    Geom_SphericalSurface,
    Geom_Surface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
    Geom_ToroidalSurface,
    Geom_TrimmedCurve,
)
from OCP.GeomAbs import GeomAbs_C1, GeomAbs_C2, GeomAbs_C3, GeomAbs_CN
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.brep.foot_surface import MAX_DEGREE
from tpmscad.brep.free_form_surface import SEAM_ANGLE, FreeFormSurface, find_smooth_seams
from tpmscad.kernel.occt import convert
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.kernel.recognise.face_carriers import EXACT_REL_TOL
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.chart_fit import (
    FIT_LINES,
    Sampler,
    Space,
    find_space,
    fit_curve,
    fit_in_spaces,
    make_break_knots,
    measure_grid_error,
)
from tpmscad.splines.knots import restrict_surface

REACH = 0.5
"""Of the range of the face's parameters: how far the carrier goes on beyond the face on each side, on the kernel's surface."""

BEYOND_REL, BEYOND_SPANS = 0.01, 0.25
"""Of the size of the body, and of the end span: how far a rational spline goes on beyond its bounds, at most."""

ANGLE_SPAN = np.radians(15.0)
"""Span along the angle of a revolution: the error of degree 9 is 1e-17 of the radius."""

POLE_SPEED = 1e-3
"""Of the largest derivative along u on the face: where it is less, v is next to a pole; the same with u and v exchanged."""

TURN_SAMPLES = 65
"""Along each parameter: places at which the turn of normals is summed up."""

STRETCH_SAMPLES = 17
"""Lines beyond a side of the face on which poles are sought."""

SNAP_RTOL = 1e-9
"""Of a parameter's range: parameters that agree within it are one; the same of the size for poles of a pole of the surface."""

ROUND_BOTH_WAYS = (Geom_SphericalSurface, Geom_ToroidalSurface)

ANGULAR: tuple[tuple[type, ...], tuple[type, ...]] = (
    (Geom_SurfaceOfRevolution, Geom_CylindricalSurface, Geom_ConicalSurface, *ROUND_BOTH_WAYS),
    ROUND_BOTH_WAYS,
)
"""Kinds of surface whose first or second parameter is an angle."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvertedSurface:
    """The carrier of a face, and its greatest measured distance from the kernel's surface at equal parameters, in model units."""

    carrier: FreeFormSurface
    error: float


def convert_free_form(face: TopoDS_Face, size: float, reach: float = REACH) -> ConvertedSurface:
    """The free-form carrier of an OCCT face, with the kernel's parameters and S_u x S_v.

    Parameters
    ----------
    face : TopoDS_Face
        A face on an extrusion, a revolution, a Bezier, B-spline or offset surface, or a torus that intersects itself.
    size : float
        Size of the body in model units; the carrier is to be within 1e-10 of it.
    reach : float, optional
        Part of the face's range of parameters by which the carrier goes on beyond each side, where the surface does.

    Returns
    -------
    ConvertedSurface
        The carrier and its measured error, which exceeds the tolerance if `chart_fit.MAX_SPANS` were not enough.

    Raises
    ------
    UnsupportedFace
        If the surface is a plane or a quadric, but for a torus that intersects itself, or has a crease inside the face.
    """
    surface, face_box = _surface_of(face)
    if isinstance(surface, Geom_ElementarySurface) and not _intersects_itself(surface):
        raise UnsupportedFace("is on a plane or a quadric, which has a carrier of its own")
    box = _widen(surface, face_box, reach, BEYOND_REL * size)
    spline, error, sample = _convert_box(surface, box, EXACT_REL_TOL * size)
    creases = _list_creases(spline)
    inside = _list_inside(creases, face_box)
    for axis in (0, 1):
        if len(inside[axis]):
            raise UnsupportedFace(f"has a crease at {'uv'[axis]} = {inside[axis][0]:.6g}")
    spline = _join_poles(restrict_between(spline, creases, face_box.mean(axis=1)), size)
    closed = find_smooth_seams(spline)
    return ConvertedSurface(FreeFormSurface(spline, closed), max(error, measure_grid_error(spline, sample)))


@dataclass(frozen=True, slots=True, eq=False)
class CreasedSurface:
    """A face's surface as a spline, the parameters u and v of its creases, and those of them that cross the face's box."""

    spline: BSplineSurface
    creases: tuple[Array, Array]
    inside: tuple[Array, Array]


def find_creases(face: TopoDS_Face, size: float, greatest_turn: float = math.inf) -> CreasedSurface | None:
    """The spline of a face and its creases, for a body of a size; None if none crosses the face's box and it is not closed.

    greatest_turn: radians; where normals turn by more along a parameter, lines that divide the turn equally count as creases.
    UnsupportedFace if no spline is within 1e-10 of the size.
    """
    surface, face_box = _surface_of(face)
    if isinstance(surface, Geom_ElementarySurface):
        return None
    is_closed = surface.IsUClosed() or surface.IsVClosed()  # there may be a crease at the seam
    if is_c1(face) and not is_closed and math.isinf(greatest_turn):
        return None
    spline, error, _ = _convert_box(surface, _widen(surface, face_box, REACH, BEYOND_REL * size), EXACT_REL_TOL * size)
    creases = _list_creases(spline)
    if math.isfinite(greatest_turn):
        along_u, along_v = (
            np.union1d(own, _divide_turn(spline, face_box, axis, greatest_turn)) for axis, own in enumerate(creases)
        )
        creases = along_u, along_v
    inside = _list_inside(creases, face_box)
    if not any(map(len, inside)) and not is_closed:
        return None
    if error > EXACT_REL_TOL * size:
        raise UnsupportedFace(f"is free-form, and its spline is {error:.2g} off")
    return CreasedSurface(spline, creases, (inside[0], inside[1]))


def is_c1(face: TopoDS_Face) -> bool:
    """Whether the derivatives of a face's surface are continuous within the box of the face."""
    adaptor = BRepAdaptor_Surface(face, True)
    return bool(adaptor.NbUIntervals(GeomAbs_C1) == adaptor.NbVIntervals(GeomAbs_C1) == 1)


def _surface_of(face: TopoDS_Face) -> tuple[Geom_Surface, Array]:
    """The surface of a face without its bounds, and the box (2, 2) of the face's parameters."""
    surface = BRep_Tool.Surface_s(face)
    while isinstance(surface, Geom_RectangularTrimmedSurface):
        surface = surface.BasisSurface()
    return surface, np.array(BRepTools.UVBounds_s(face)).reshape(2, 2)


def _intersects_itself(surface: Geom_Surface) -> bool:
    """Whether a surface is a torus whose tube reaches its axis: its faces end there in poles."""
    return isinstance(surface, Geom_ToroidalSurface) and surface.MajorRadius() <= surface.MinorRadius()


def convert_box(surface: Geom_Surface, box: Array, tol: float) -> tuple[BSplineSurface, float]:
    """Any OCCT surface over a box (2, 2) of its parameters as a polynomial spline, and its greatest measured error.

    The error, in model units, exceeds `tol` if `chart_fit.MAX_SPANS` were not enough.
    """
    return _convert_box(surface, box, tol)[:2]


def convert_curve(adaptor: BRepAdaptor_Curve, tol: float) -> BSplineCurve | None:
    """The curve of an edge as a polynomial spline with its parameter, as smooth as it is; None if it is not within `tol`."""

    def sample(t: Array) -> Array:
        return np.array([adaptor.Value(x).Coord() for x in t.tolist()])

    return fit_curve(sample, *_read_breaks(adaptor, None), tol)


def _widen(surface: Geom_Surface, face_box: Array, reach: float, beyond: float) -> Array:
    """Box of parameters (2, 2) around that of the face, within the surface and one period of it, clear of poles.

    A rational spline goes on by up to the length `beyond`, since the end spans of its fit are too short to go on by themselves.
    """
    bounds = np.array(surface.Bounds()).reshape(2, 2)
    if isinstance(surface, Geom_BSplineSurface) and (surface.IsURational() or surface.IsVRational()):
        bounds = bounds + _end_span_steps(surface, face_box, beyond)
    periods = (
        surface.UPeriod() if surface.IsUPeriodic() else 0.0,
        surface.VPeriod() if surface.IsVPeriodic() else 0.0,
    )
    box = face_box.copy()
    for axis, period in enumerate(periods):
        low, high = face_box[axis]
        step = reach * (high - low)
        if period:
            if high - low + 2.0 * step >= period * (1.0 - SNAP_RTOL):
                low = max(low, high - period)
                box[axis] = low, low + period
                continue
            box[axis] = low - step, high + step
            continue
        box[axis] = max(low - step, bounds[axis, 0]), min(high + step, bounds[axis, 1])
        tiny = SNAP_RTOL * (high - low)
        for end in (0, 1):  # bounds that the face's box misses by the kernel's tolerance
            if abs(face_box[axis, end] - bounds[axis, end]) <= tiny:
                box[axis, end] = bounds[axis, end]
    for axis in (0, 1):
        for end in (0, 1):
            box[axis, end] = _stop_at_pole(surface, face_box, axis, float(face_box[axis, end]), float(box[axis, end]))
    return box


def _end_span_steps(surface: Geom_BSplineSurface, face_box: Array, beyond: float) -> Array:
    """Steps (2, 2) in parameters beyond the bounds of a spline: the length `beyond`, or `BEYOND_SPANS` of an end span.

    None where the spline is closed.
    """
    middle = face_box.mean(axis=1).tolist()
    result = np.zeros((2, 2))
    point, first, second = gp_Pnt(), gp_Vec(), gp_Vec()
    closed = surface.IsUClosed(), surface.IsVClosed()
    for axis, (count, knot) in enumerate(((surface.NbUKnots(), surface.UKnot), (surface.NbVKnots(), surface.VKnot))):
        if closed[axis]:
            continue
        for end, (a, b) in enumerate(((1, 2), (count, count - 1))):
            at = list(middle)
            at[axis] = knot(a)
            surface.D1(*at, point, first, second)
            speed = max((first if axis == 0 else second).Magnitude(), 1e-300)
            step = min(BEYOND_SPANS * abs(knot(b) - knot(a)), beyond / speed)
            result[axis, end] = step if end else -step
    return result


def _stop_at_pole(surface: Geom_Surface, face_box: Array, axis: int, start: float, stop: float) -> float:
    """Where the way from a side of the face to a wider one ends: half-way to a pole, if there is one."""
    if start == stop:
        return stop
    across = np.linspace(face_box[1 - axis, 0], face_box[1 - axis, 1], FIT_LINES + 2)[1:-1]
    point, first, second = gp_Pnt(), gp_Vec(), gp_Vec()

    def speed(t: float) -> float:
        """Greatest derivative along the other parameter."""
        found = 0.0
        for s in across.tolist():
            surface.D1(*((t, s) if axis == 0 else (s, t)), point, first, second)
            found = max(found, (second if axis == 0 else first).Magnitude())
        return found

    inside = max(speed(t) for t in np.linspace(face_box[axis, 0], face_box[axis, 1], FIT_LINES).tolist())
    ways = np.linspace(start, stop, STRETCH_SAMPLES).tolist()
    speeds = np.array([speed(t) for t in ways])
    # a pole between two lines: the derivative changes its direction there, and decreases before
    slow = np.flatnonzero(speeds <= POLE_SPEED * inside)
    turns = (
        np.flatnonzero((speeds[1:-1] < speeds[:-2]) & (speeds[1:-1] < speeds[2:]) & (speeds[1:-1] < 0.1 * inside)) + 1
    )
    found = np.sort(np.concatenate([slow, turns]))
    if not len(found):
        return stop
    return 0.5 * (start + ways[found[0]]) if found[0] > 0 else start


def _convert_box(surface: Geom_Surface, box: Array, tol: float) -> tuple[BSplineSurface, float, Sampler]:
    """The surface over the box as a polynomial spline, the greatest measured error, and what samples the kernel's surface."""
    adaptor = GeomAdaptor_Surface(surface, *box.ravel().tolist())

    def sample(u: Array, v: Array) -> Array:
        rows = v.tolist()
        found = [adaptor.Value(a, b).Coord() for a in u.tolist() for b in rows]
        return np.array(found).reshape(len(u), len(v), 3)

    if isinstance(surface, Geom_BSplineSurface) and convert.is_plain_spline(surface):
        degrees = surface.UDegree(), surface.VDegree()
        if max(degrees) <= MAX_DEGREE:
            whole = convert.surface_from_occt(surface)
            ends = np.array(whole.domain)
            box = np.where(np.abs(box - ends) > SNAP_RTOL * np.ptp(ends, axis=1, keepdims=True), box, ends)
            return _restrict(whole, box), 0.0, sample
    own = _own_degrees(surface)
    spaces: list[Space] = []
    for axis in (0, 1):
        breaks, continuity = _read_breaks(adaptor, axis)
        if own[axis] is not None:
            degree = int(own[axis] or 1)
            spaces.append((make_break_knots(breaks, continuity, degree), degree))
        elif isinstance(surface, ANGULAR[axis]):
            parts = int(np.ceil((box[axis, 1] - box[axis, 0]) / ANGLE_SPAN))
            ends = np.linspace(box[axis, 0], box[axis, 1], parts + 1)
            spaces.append((make_break_knots(ends, np.full(parts - 1, MAX_DEGREE - 1), MAX_DEGREE), MAX_DEGREE))
        else:
            spaces.append(find_space(sample, axis, box, breaks, continuity, tol))
    return *fit_in_spaces(sample, spaces, [degree is None for degree in own], tol), sample


def _restrict(spline: BSplineSurface, box: Array) -> BSplineSurface:
    """The surface on a box (2, 2) of its parameters."""
    (u0, u1), (v0, v1) = box.tolist()
    return restrict_surface(spline, (u0, u1), (v0, v1))


def _own_degrees(surface: Geom_Surface) -> tuple[int | None, int | None]:
    """Degrees along u and v where the surface is a polynomial spline along that parameter, else None."""
    if isinstance(surface, Geom_Plane):
        return 1, 1
    if isinstance(surface, Geom_CylindricalSurface | Geom_ConicalSurface):
        return None, 1
    if isinstance(surface, Geom_SurfaceOfLinearExtrusion):
        return _curve_degree(surface.BasisCurve()), 1
    if isinstance(surface, Geom_SurfaceOfRevolution):
        return None, _curve_degree(surface.BasisCurve())
    if isinstance(surface, Geom_BSplineSurface | Geom_BezierSurface):
        weights = np.array(
            [[surface.Weight(i, j) for j in range(1, surface.NbVPoles() + 1)] for i in range(1, surface.NbUPoles() + 1)]
        )
        limit = 1e-14 * weights.max()
        degrees = surface.UDegree(), surface.VDegree()
        plain = [np.ptp(weights, axis=axis).max() <= limit and degrees[axis] <= MAX_DEGREE for axis in (0, 1)]
        return (degrees[0] if plain[0] else None), (degrees[1] if plain[1] else None)
    return None, None


def _curve_degree(curve: Geom_Curve) -> int | None:
    """Degree of a curve that is a line or a polynomial spline, else None."""
    while isinstance(curve, Geom_TrimmedCurve):
        curve = curve.BasisCurve()
    if isinstance(curve, Geom_Line):
        return 1
    if isinstance(curve, Geom_BSplineCurve | Geom_BezierCurve) and not curve.IsRational():
        return int(curve.Degree()) if curve.Degree() <= MAX_DEGREE else None
    return None


def _read_breaks(adaptor: GeomAdaptor_Surface | BRepAdaptor_Curve, axis: int | None) -> tuple[Array, Array]:
    """Ends (n + 1,) of the intervals on which the surface is smooth along a parameter, and the continuity (n - 1,) between them.

    The continuity is 0 to 3: more is not told apart. For a curve `axis` is None.
    """

    def intervals(kind: Any) -> Array:
        if axis is None:
            values = convert.real_array(adaptor.NbIntervals(kind) + 1)
            adaptor.Intervals(values, kind)
            return np.array([values.Value(i) for i in range(1, values.Length() + 1)])
        count = adaptor.NbUIntervals(kind) if axis == 0 else adaptor.NbVIntervals(kind)
        values = convert.real_array(count + 1)
        (adaptor.UIntervals if axis == 0 else adaptor.VIntervals)(values, kind)
        return np.array([values.Value(i) for i in range(1, count + 2)])

    breaks = intervals(GeomAbs_CN)
    continuity = np.full(len(breaks) - 2, 3)
    tiny = SNAP_RTOL * (breaks[-1] - breaks[0])
    for order, kind in ((3, GeomAbs_C3), (2, GeomAbs_C2), (1, GeomAbs_C1)):
        broken = np.abs(breaks[1:-1, None] - intervals(kind)[None, 1:-1]).min(axis=1, initial=np.inf) <= tiny
        continuity[broken] = order - 1
    return breaks, continuity


def _list_creases(spline: BSplineSurface) -> tuple[Array, Array]:
    """The inner knots along u and along v at which the tangent plane turns."""
    found = []
    for axis, (knots, degree) in enumerate(((spline.knots_u, spline.degree_u), (spline.knots_v, spline.degree_v))):
        values, counts = np.unique(knots[degree + 1 : -degree - 1], return_counts=True)
        found.append(np.array([t for t in values[counts >= degree].tolist() if _has_crease(spline, axis, t)]))
    return found[0], found[1]


def _divide_turn(spline: BSplineSurface, face_box: Array, axis: int, greatest: float) -> Array:
    """The parameters that divide a face into strips in which normals turn by an angle at most along one parameter."""
    uv = [np.linspace(low, high, TURN_SAMPLES) for low, high in face_box.tolist()]
    normals = spline.normal(*(grid.ravel() for grid in np.meshgrid(*uv, indexing="ij"))).reshape(*map(len, uv), 3)
    normals = np.moveaxis(normals, axis, 0)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), np.finfo(float).tiny)
    steps = np.arccos(np.clip((normals[1:] * normals[:-1]).sum(axis=2), -1.0, 1.0)).max(axis=1)
    turn = np.append(0.0, np.cumsum(steps))
    count = math.ceil(turn[-1] / greatest)
    cuts = np.interp(turn[-1] * np.arange(1, count) / count, turn, uv[axis])
    # not beside a knot, for a span must have a length
    knots = (spline.knots_u, spline.knots_v)[axis]
    nearest = knots[np.abs(knots[:, None] - cuts).argmin(axis=0)]
    return np.where(np.abs(nearest - cuts) < 0.5 * np.ptp(face_box[axis]) / TURN_SAMPLES, nearest, cuts)


def _list_inside(creases: tuple[Array, Array], face_box: Array) -> list[Array]:
    """The parameters of creases within the box (2, 2) of a face."""
    tiny = SNAP_RTOL * np.ptp(face_box, axis=1)
    return [c[(c > low + d) & (c < high - d)] for c, (low, high), d in zip(creases, face_box, tiny, strict=True)]


def restrict_between(spline: BSplineSurface, creases: Sequence[Array], at: Array) -> BSplineSurface:
    """The surface around parameters (2,) without what lies beyond the creases next to them."""
    keep = np.array(spline.domain)
    for axis in (0, 1):
        ends = np.concatenate([[keep[axis, 0]], creases[axis], [keep[axis, 1]]])
        k = min(max(int(np.searchsorted(ends, at[axis])), 1), len(ends) - 1)
        keep[axis] = ends[k - 1], ends[k]
    return _restrict(spline, keep)


def _has_crease(spline: BSplineSurface, axis: int, t: float) -> bool:
    """Whether the normals on both sides of a knot line differ."""
    low, high = spline.domain[1 - axis]
    across = low + (high - low) * np.linspace(0.01, 0.99, STRETCH_SAMPLES)
    knots = np.unique(spline.knots_u if axis == 0 else spline.knots_v)
    k = int(np.searchsorted(knots, t))
    sides: list[Array] = []
    for start, end in ((knots[k - 1], t), (t, knots[k + 1])):
        span = ((start, end), (low, high)) if axis == 0 else ((low, high), (start, end))
        part = restrict_surface(spline, *span)
        at = np.full_like(across, t)
        sides.append(part.normal(*((at, across) if axis == 0 else (across, at))))
    lengths = np.linalg.norm(sides[0], axis=1) * np.linalg.norm(sides[1], axis=1)
    regular = lengths > 1e-12 * lengths.max()
    turned = np.linalg.norm(np.cross(sides[0], sides[1]), axis=1) > SEAM_ANGLE * lengths
    return bool(((turned | (np.einsum("nk,nk->n", sides[0], sides[1]) < 0)) & regular).any())


def _join_poles(spline: BSplineSurface, size: float) -> BSplineSurface:
    """The surface with the poles of a side that is a point made one, and those of a seam on both sides."""
    poles, tiny = spline.poles.copy(), SNAP_RTOL * size
    for row in (poles[0], poles[-1], poles[:, 0], poles[:, -1]):
        if np.ptp(row, axis=0).max() <= tiny:
            row[:] = row.mean(axis=0)
    for one, other in ((poles[0], poles[-1]), (poles[:, 0], poles[:, -1])):
        if np.abs(one - other).max() <= tiny:
            one[:] = other[:] = 0.5 * (one + other)
    return BSplineSurface(poles, spline.knots_u, spline.knots_v, spline.degree_u, spline.degree_v)
