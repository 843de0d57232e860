"""Offset sheets: for each face, concave edge and concave corner of a body the points at the depth of the skin below it.

A sheet keeps the parameters of its face: X(u, v) = S(u, v) + skin * (inward normal). Planes and quadrics give exact sheets of
their own kind; splines are fitted. X is smooth where the face is, beyond its centres of curvature too, where it folds; what is
folded is not deep enough. The sheet of a concave edge is a tube round it between the inward normals of its faces: a cylinder or a
torus where the edge is a line or a circle at a constant angle, else a fitted canal surface. That of a corner is a part of a
sphere. Each sheet has a domain, the parameters of its face, beyond which its points have another nearest site.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    EdgeCurve,
    Plane,
    Quadric,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.loops import points_in_polygons
from tpmscad.errors import NoOffset
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment, line_segment
from tpmscad.splines.chart_fit import CHART_DEGREE, Space, find_space, fit_in_spaces, make_break_knots
from tpmscad.splines.knots import knots_within

SheetCarrier = Plane | Quadric | BSplineSurface

FIT_REL_TOL = 1e-10
"""In body sizes: tolerance of fitted sheets."""

WIDENING = 0.02
"""Of the range of a domain: how far a fitted sheet goes on beyond it, where its face does."""

CONSTANT_TOL = 1e-10
"""Radians by which the normals along an edge may turn if its tube is a cylinder or a torus."""

SAMPLES = 17
"""Points along an edge at which that is measured."""

DIRECTIONS = np.linspace(0.0, 1.0, 9)
"""Places across a fitted tube or a sphere at which a search of parameters starts."""


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A piece of an offset surface.

    The outward normal of the eroded body is `sense` times X_u x X_v. `segments` (n, 2, 2): the border of its domain in (u, v).
    `source`: the face of the body, or -1. `strips` (n, 2, 2) each: polygons by which the domain goes on beyond an open face.
    """

    carrier: SheetCarrier
    sense: int
    segments: Array
    source: int
    strips: tuple[Array, ...] = ()

    def box(self) -> Array:
        """Box (2, 2) of the domain: low and high (u, v)."""
        return bounding_box((self.segments, *self.strips))

    def contains(self, uv: Array) -> BoolArray:
        """Whether parameters (n, 2) lie in the domain, on the own side of a pole or apex: (n,)."""
        inside = np.zeros(len(uv), bool)
        for segments in (self.segments, *self.strips):
            inside |= points_in_polygons(segments[:, 0], segments[:, 1], uv)
        return inside & (ring_radius(self.carrier, uv[:, 1]) > 0)

    def parameters_near(self, point: Array) -> Array:
        """(u, v) of a point (3,) on the sheet, or of the nearest sample if it is fitted: (2,)."""
        box = self.box()
        if isinstance(self.carrier, BSplineSurface):
            u, v = (a.ravel() for a in np.meshgrid(*(np.linspace(side[0], side[1], 33) for side in box.T)))
            k = int(np.linalg.norm(self.carrier(u, v) - point, axis=1).argmin())
            return np.array([u[k], v[k]])
        uv = self.carrier.parameters(point[None])[0]
        for axis, period in enumerate(self.carrier.period):
            if period:
                uv[axis] -= period * np.round((uv[axis] - box[:, axis].mean()) / period)
        return np.asarray(uv)


def bounding_box(polygons: tuple[Array, ...]) -> Array:
    """Box (2, 2) of polygons, segments (n, 2, 2) each: low and high (u, v)."""
    return np.stack(
        [
            np.min([segments.min(axis=(0, 1)) for segments in polygons], axis=0),
            np.max([segments.max(axis=(0, 1)) for segments in polygons], axis=0),
        ]
    )


def ring_radius(carrier: SheetCarrier, v: Array) -> Array:
    """Signed radius of the circles v = const of a cone or torus, which vanishes at its apex; 1 on other carriers: (n,)."""
    if isinstance(carrier, ConicalSurface):
        return np.asarray(carrier.radius + v * np.sin(carrier.angle))
    if isinstance(carrier, ToroidalSurface):
        return np.asarray(carrier.major + carrier.minor * np.cos(v))
    return np.ones_like(v)


def offset_face(
    carrier: BodyCarrier,
    sense: int,
    polygons: tuple[Array, ...],
    skin: float,
    size: float,
    source: int,
) -> Sheet | None:
    """The sheet of a face with the outward normal `sense` * S_u x S_v; None if its surface vanishes at this depth.

    polygons: the border of the domain, then the strips by which it goes on.
    """
    by, strips = -sense * skin, polygons[1:]
    if isinstance(carrier, FreeFormSurface):
        return Sheet(_fit_offset(carrier, by, polygons, FIT_REL_TOL * size), sense, polygons[0], source, strips)
    moved: SheetCarrier | None
    if isinstance(carrier, Plane):
        moved = replace(carrier, origin=carrier.origin + by * carrier.normal)
    elif isinstance(
        carrier, ConicalSurface
    ):  # with the parameters of the cone, so that the origin moves along the axis
        radius = carrier.radius + by * np.cos(carrier.angle)
        moved = replace(carrier, radius=radius, origin=carrier.origin - by * np.sin(carrier.angle) * carrier.axis)
    elif isinstance(carrier, ToroidalSurface):
        moved = replace(carrier, minor=carrier.minor + by) if carrier.minor + by > 0 else None
    else:
        moved = replace(carrier, radius=carrier.radius + by) if carrier.radius + by > 0 else None
    return None if moved is None else Sheet(moved, sense, polygons[0], source, strips)


def _fit_offset(carrier: FreeFormSurface, by: float, polygons: tuple[Array, ...], tol: float) -> BSplineSurface:
    """S + by * S_u x S_v / |S_u x S_v| on the box of a domain, in the same parameters.

    Where a strip goes on beyond the surface, the polynomials of the end spans do, by half a span at most.
    """
    spline = carrier.spline
    if find_point_sides(spline).any():
        raise NoOffset("a free-form face with a pole has no sheet: its normal is undefined there")
    low, high = bounding_box(polygons[:1])
    wide_low, wide_high = bounding_box(polygons)
    step = WIDENING * (high - low)
    ends = np.array(spline.domain)
    spans = np.array([np.diff(np.unique(knots))[[0, -1]] for knots in (spline.knots_u, spline.knots_v)])
    box = np.stack([np.maximum(low - step, ends[:, 0]), np.minimum(high + step, ends[:, 1])], axis=1)
    box[:, 0] = np.where(
        wide_low < low, np.maximum(np.minimum(box[:, 0], wide_low), ends[:, 0] - spans[:, 0] / 2), box[:, 0]
    )
    box[:, 1] = np.where(
        wide_high > high, np.minimum(np.maximum(box[:, 1], wide_high), ends[:, 1] + spans[:, 1] / 2), box[:, 1]
    )

    def sample(u: Array, v: Array) -> Array:
        normal = np.cross(spline.grid(u, v, 1, 0), spline.grid(u, v, 0, 1))
        return np.asarray(spline.grid(u, v) + by * normal / np.linalg.norm(normal, axis=2, keepdims=True))

    spaces, adaptive = [], []
    for axis, (knots, degree) in enumerate(((spline.knots_u, spline.degree_u), (spline.knots_v, spline.degree_v))):
        inner, count = knots_within(knots, *np.clip(box[axis], *ends[axis]))  # its ends are no breaks of what goes on
        breaks = np.concatenate([box[axis, :1], inner, box[axis, 1:]])
        smooth = degree - count
        own = make_break_knots(breaks, smooth, degree), degree
        if _is_exact(sample, axis, box, own, tol):
            spaces.append(own)
            adaptive.append(False)
        else:
            try:
                spaces.append(find_space(sample, axis, box, breaks, np.maximum(smooth - 1, 0), tol))
            except ValueError as error:  # a bend so near to the end of the face that no samples lie between
                raise NoOffset(f"the offset of a free-form face has no fit: {error}") from error
            adaptive.append(True)
    fitted, error = fit_in_spaces(sample, spaces, adaptive, tol)
    if error > 10 * tol:
        raise NoOffset(f"the offset of a free-form face is fitted to {error:.2g} only")
    return fitted


def _is_exact(sample: Callable[[Array, Array], Array], axis: int, box: Array, space: Space, tol: float) -> bool:
    """Whether the offset is linear along a parameter along which its surface is: the lines of an extrusion."""
    knots, degree = space
    if degree > 1 or len(knots) > 4:
        return False
    at, across = (np.linspace(box[k, 0], box[k, 1], n) for k, n in ((axis, 3), (1 - axis, 9)))
    lines = sample(at, across) if axis == 0 else sample(across, at).swapaxes(0, 1)
    return bool(np.abs(lines[1] - 0.5 * (lines[0] + lines[2])).max() <= 0.1 * tol)


@dataclass(frozen=True, slots=True, eq=False)
class TubeEnd:
    """One end of a tube: the vertex, the edge's direction away from it, the parameters (2, 2) at both sides of the tube.

    normals (2, 3): the directions of both sides, from the first of which the tube turns about `axis` (3,) by `angle`. `split`:
    the angle at which the second of three directions lies, that below an open face; else `angle`.
    """

    vertex: int
    leaving: Array
    normals: Array
    parameters: Array
    axis: Array
    angle: float
    split: float

    def place(self, angle: float) -> Array:
        """The parameters (2,) at an angle."""
        return np.asarray(self.parameters[0] + angle / self.angle * (self.parameters[1] - self.parameters[0]))

    def arc(self, center: Array, radius: float) -> Circle:
        """The border of the tube at this end, from angle 0 on."""
        return Circle(center, self.normals[0], self.axis, radius)


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """The sheet of a concave edge, the pcurves of its two sides (with the edge's parameter), and its two ends."""

    sheet: Sheet
    sides: tuple[BSplineCurve, BSplineCurve]
    ends: tuple[TubeEnd, TubeEnd]


def make_tube(
    curve: EdgeCurve,
    span: tuple[float, float],
    ends: tuple[int, int],
    inward: Callable[[Array], Array],
    skin: float,
    size: float,
) -> Tube:
    """The tube round a concave edge between two vertices.

    inward(t): unit vectors (m, n, 3) square to the edge, the inward normals of its faces, or a path of such directions, each less
    than half a turn from the last, from one side of the tube to the other.
    """
    low, high = span
    t = np.linspace(low, high, SAMPLES)
    normals, tangents = inward(t), curve(t, 1)
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    carrier, along, across, along_first = _make_tube_carrier(curve, span, normals, tangents, inward, skin, size)

    def corner(k: int, f: int) -> Array:
        return np.array([along[k], across[f]] if along_first else [across[f], along[k]])

    corners = np.array([[corner(k, f) for f in (0, 1)] for k in (0, 1)])  # (end, side, 2)
    path = corners[[0, 1, 1, 0, 0], [0, 0, 1, 1, 0]]
    middle = corners.mean(axis=(0, 1))
    u, v = middle
    normal = np.cross(carrier(u, v, 1, 0), carrier(u, v, 0, 1))
    foot = curve(0.5 * (low + high))
    sense = 1 if normal @ (foot - carrier(*middle)) > 0 else -1
    sides = [line_segment(corners[0, f], corners[1, f], span) for f in (0, 1)]
    turns, firsts = _turn(normals, tangents), _turn(normals[:2], tangents)
    made = [
        TubeEnd(
            vertex,
            way * tangents[at],
            normals[[0, -1], at],
            corners[at],
            np.sign(turns[at]) * tangents[at],
            float(abs(turns[at])),
            float(abs(firsts[at])),
        )
        for vertex, way, at in zip(ends, (1, -1), (0, -1), strict=True)
    ]
    return Tube(
        Sheet(carrier, sense, np.stack([path[:-1], path[1:]], axis=1), -1), (sides[0], sides[1]), (made[0], made[1])
    )


def _turn(normals: Array, tangents: Array) -> Array:
    """The angles (n,) about tangents (n, 3) from the first to the last of directions (m, n, 3)."""
    sine = np.einsum("mni,ni->mn", np.cross(normals[:-1], normals[1:]), tangents)
    return np.asarray(np.arctan2(sine, (normals[:-1] * normals[1:]).sum(axis=2)).sum(axis=0))


def _make_tube_carrier(
    curve: EdgeCurve,
    span: tuple[float, float],
    normals: Array,
    tangents: Array,
    inward: Callable[[Array], Array],
    skin: float,
    size: float,
) -> tuple[SheetCarrier, Array, Array, bool]:
    """A tube's carrier, its parameters (2,) at the ends and at the sides, and whether the first one runs along the edge."""
    if is_segment(curve) and np.ptp(normals, axis=1).max() <= CONSTANT_TOL:
        start, end = curve(np.array(span))
        tube = CylindricalSurface(start, normals[0, 0], tangents[0], skin)
        turn = float(_turn(normals[:, :1], tangents[:1])[0])
        return tube, np.array([0.0, np.linalg.norm(end - start)]), np.array([0.0, turn]), False
    if isinstance(curve, Circle):
        radial = curve(np.linspace(*span, SAMPLES)) - curve.origin
        radial = radial / np.linalg.norm(radial, axis=1, keepdims=True)
        angle = np.arctan2(normals @ curve.normal, (normals * radial).sum(axis=2))
        off = np.angle(np.exp(1j * (angle - angle[:, :1])))
        if np.ptp(off, axis=1).max() <= CONSTANT_TOL:
            torus = ToroidalSurface(curve.origin, curve.x_axis, curve.normal, curve.radius, skin)
            turn = np.angle(np.exp(1j * np.diff(angle[:, 0]))).sum()
            return torus, np.array(span), angle[0, 0] + np.array([0.0, turn]), True

    def sample(s: Array, w: Array) -> Array:
        own, along = inward(s), curve(s, 1)
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        angle = (w * _turn(own, along)[:, None])[..., None]
        between = np.cos(angle) * own[0][:, None] + np.sin(angle) * np.cross(along, own[0])[:, None]
        return np.asarray(curve(s)[:, None] + skin * between)

    box = np.array([span, (0.0, 1.0)])
    spaces, tol = [], FIT_REL_TOL * size
    for axis in (0, 1):
        breaks, smooth = box[axis], np.empty(0, int)
        if axis == 0 and isinstance(curve, BSplineCurve):
            inner, count = knots_within(curve.knots, *span)
            breaks = np.concatenate([box[0, :1], inner, box[0, 1:]])
            smooth = np.clip(curve.degree - count - 1, 0, CHART_DEGREE - 1)
        spaces.append(find_space(sample, axis, box, breaks, smooth, tol))
    fitted, error = fit_in_spaces(sample, spaces, [True, True], tol)
    if not error <= 10 * tol:
        raise NoOffset(f"the tube round a concave edge deviates by {error:.2g}, more than {10 * tol:.2g} is allowed")
    # across first: an end in a point, where the faces are tangent, lies across v, as poles do
    tube = BSplineSurface(
        fitted.poles.swapaxes(0, 1).copy(), fitted.knots_v, fitted.knots_u, fitted.degree_v, fitted.degree_u
    )
    return tube, np.array(span), np.array([0.0, 1.0]), False


def make_ball(center: Array, directions: Array, skin: float) -> SphericalSurface:
    """The sphere round a corner, with the poles of its parameters away from the directions (n, 3) of its sheet."""
    middle = directions.mean(axis=0)
    middle = middle / np.linalg.norm(middle)
    if (directions @ middle).min() < 0.1:
        raise NoOffset(f"the corner at {center.round(6)} is too sharp for a sphere")
    axis = np.cross(middle, np.eye(3)[np.abs(middle).argmin()])
    return SphericalSurface(center, middle, axis / np.linalg.norm(axis), skin)
